"""Localizability of a road in colours (room: viz).

In: map elements, a Survey. Out: a Figure: the map once for each direction, places coloured by expected sigma.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from semloc_jax.analysis.placement import PlacementReport
from semloc_jax.analysis.survey import Survey
from semloc_jax.maps.elements import MapElement
from semloc_jax.viz.bev import draw_map
from semloc_jax.viz.style import LIGHT, new_figure, plain_axes


def survey_view(elements: Sequence[MapElement], survey: Survey, title: str = "") -> Figure:
    """Four views of the map: expected longitudinal, lateral and heading sigma, and the share of the best second pose.

    Places of weak stretches have a red rim.

    Args:
        elements: What is drawn below the places.
        survey: Of its ways.
        title: Text above the views.
    """
    xy = np.concatenate([report.way.Ts_map_base[:, :2, 3] for report in survey.ways])
    sigma = np.concatenate([report.sigma for report in survey.ways]) * [100.0, 100.0, 1.0]
    second = 100.0 * np.concatenate([report.ambiguity for report in survey.ways])
    limits = np.array(list(survey.limits.values())) * [100.0, 100.0, 1.0, 100.0]
    names = ("longitudinal sigma [cm]", "lateral sigma [cm]", "heading sigma [deg]", "fits elsewhere [%]")
    low, high = xy.min(axis=0) - 15.0, xy.max(axis=0) + 15.0
    wide_m, tall_m = high - low
    rows, columns = (4, 1) if wide_m > 2.0 * tall_m else (1, 4) if tall_m > 1.5 * wide_m else (2, 2)
    width = {1: 11.0, 2: 12.0, 4: 14.0}[columns]
    shape = float(np.clip(tall_m / wide_m, 0.12, 2.6))
    figure = new_figure(width, rows * (0.9 + width / columns * 0.72 * shape), dark=True)
    for axes, name, values, limit in zip(
        figure.subplots(rows, columns).flat, names, [*sigma.T, second], limits, strict=True
    ):
        plain_axes(axes, dark=True)
        draw_map(axes, elements, 0.4)
        if name.endswith("[%]"):
            norm = Normalize(0.0, 100.0)
        else:
            norm = LogNorm(max(values.min(), 1e-3), max(values.max(), 1.01 * values.min()))
        rims = np.where(values > limit, "#ff1744", "none")
        points = axes.scatter(
            *xy.T, c=values, cmap="plasma", norm=norm, s=26, edgecolors=rims, linewidths=1.3, zorder=6
        )
        bar = figure.colorbar(points, ax=axes, pad=0.01, aspect=30 if columns == 4 else 14, shrink=0.8)
        if isinstance(norm, LogNorm):
            bar.ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            bar.ax.yaxis.set_minor_formatter(NullFormatter())
        bar.ax.yaxis.set_major_formatter("{x:g}")
        bar.ax.tick_params(labelsize=8, colors=LIGHT, which="both")
        bar.outline.set_visible(False)
        axes.set_aspect("equal")
        axes.set_xlim(low[0], high[0])
        axes.set_ylim(low[1], high[1])
        axes.set_title(f"{name}; red rim: above {limit:g}", fontsize=9, color=LIGHT)
    figure.supxlabel("x east [m]", fontsize=9, color=LIGHT)
    figure.supylabel("y north [m]", fontsize=9, color=LIGHT)
    figure.suptitle(title, fontsize=10, color=LIGHT)
    return figure


def prediction_view(predicted: np.ndarray, measured: np.ndarray, kinds: Sequence[str]) -> Figure:
    """Measured errors over expected sigmas, one panel for each direction, both axes logarithmic.

    Args:
        predicted: Longitudinal [m], lateral [m], heading [deg] sigma, `[n 3]`.
        measured: Root mean square errors, likewise.
        kinds: Drive of each place, for the legend.
    """
    figure = new_figure(12.0, 4.2)
    names = ("longitudinal [cm]", "lateral [cm]", "heading [deg]")
    kinds = np.asarray(kinds)
    for k, (axes, name) in enumerate(zip(figure.subplots(1, 3), names, strict=True)):
        plain_axes(axes)
        scale = 1.0 if k == 2 else 100.0
        for kind in dict.fromkeys(kinds.tolist()):
            chosen = kinds == kind
            axes.scatter(scale * predicted[chosen, k], scale * measured[chosen, k], s=14, alpha=0.8, label=kind)
        ends = scale * np.array([f([f(predicted[:, k]), f(measured[:, k])]) for f in (np.min, np.max)])
        axes.plot(ends, ends, color="#9aa3ad", linewidth=0.8)
        r = np.corrcoef(np.log(predicted[:, k]), np.log(measured[:, k]))[0, 1]
        axes.set(xscale="log", yscale="log", xlabel=f"expected sigma, {name}")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(NullFormatter())
        axes.set_title(f"{name}: r = {r:.2f}", fontsize=10)
        if k == 0:
            axes.set_ylabel("RMS error over seeds of mask noise")
            axes.legend(fontsize=7, frameon=False)
    return figure


def placement_view(report: PlacementReport, camera: str) -> Figure:
    """Expected sigma of each place as the camera is mounted and as it would be placed, one panel for each direction."""
    figure = new_figure(11.0, 3.6)
    names, scales, units = ("longitudinal", "lateral", "heading"), (100.0, 100.0, 1.0), ("cm", "cm", "deg")
    places = np.arange(1, len(report.sigma_before) + 1)
    for k, axes in enumerate(figure.subplots(1, 3)):
        plain_axes(axes)
        before, after = scales[k] * report.sigma_before[:, k], scales[k] * report.sigma_after[:, k]
        axes.vlines(places, before, after, color="#cfd8dc", linewidth=1.4, zorder=1)
        axes.plot(places, before, "o", color="#9aa3ad", markersize=5, label="as mounted")
        axes.plot(places, after, "o", color="#1565c0", markersize=5, label="placed")
        axes.set_ylim(0.0, 1.12 * max(before.max(), after.max()))
        axes.set_xlabel("place along the way")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_title(f"{names[k]} sigma [{units[k]}]: {report.gain[k]:.2f} times smaller", fontsize=10)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False, fontsize=9)
    p = report.placement
    changes = f"{p.down_deg:+.1f}° down, {p.rise_m:+.2f} m higher, focal length x {p.zoom:.2f}"
    figure.suptitle(f"camera {camera}: {changes}", fontsize=11)
    return figure
