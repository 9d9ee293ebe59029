"""What a calibration by targets leaves: residuals in every picture, surveyed corners from above (room: viz).

In: fits of the lenses and of the mounts. Out: a Figure.
"""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Wedge

from semloc_jax.calibration.lens_on_boards import LensFit
from semloc_jax.calibration.mounts_on_mats import MountFit
from semloc_jax.viz.bev import VEHICLE_M
from semloc_jax.viz.style import new_figure, plain_axes

_MAGNIFIED = 100.0
_COLOURS = ("#0d47a1", "#c62828", "#2e7d32", "#f57f17", "#6a1b9a", "#00838f")


def target_figure(names: tuple[str, ...], lenses: list[LensFit], mounts: MountFit | None) -> Figure:
    """For each camera the corners of all boards with their residuals, 100 times as long, and the parts of the picture
    that no board covers in red; below, surveyed corners of mats from above with their errors, 10 times as long."""
    figure = new_figure(4.2 * len(names), 3.7 if mounts is None else 9.2)
    rows = figure.subfigures(2, 1, height_ratios=(3.5, 5.5)) if mounts is not None else [figure]
    for axes, name, fit in zip(np.atleast_1d(rows[0].subplots(1, len(names))), names, lenses, strict=True):
        _draw_lens(axes, name, fit)
    if mounts is not None:
        _draw_mats(rows[1].subplots(), names, mounts)
    return figure


def _draw_lens(axes, name: str, fit: LensFit) -> None:
    width, height = fit.camera.resolution
    centre, ring_px = (float(fit.camera.cx), float(fit.camera.cy)), 0.5 * 0.9 * width / len(fit.covered)
    for ring, sectors in enumerate(fit.covered):
        for sector, covered in enumerate(sectors):
            if not covered:
                turn = 360.0 / len(sectors)
                part = Wedge(centre, (ring + 1) * ring_px, sector * turn, (sector + 1) * turn, width=ring_px)
                part.set(facecolor="#c62828", alpha=0.18, linewidth=0)
                axes.add_patch(part)
    axes.add_patch(Circle(centre, len(fit.covered) * ring_px, fill=False, edgecolor="#90a4ae", linewidth=0.6))
    uv, off = np.concatenate(fit.corners_px), np.concatenate(fit.residuals_px)
    axes.quiver(*uv.T, *(_MAGNIFIED * off.T), angles="xy", scale_units="xy", scale=1, width=0.003, color="#0d47a1")
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal", xticks=(), yticks=())
    axes.set_title(
        f"{name}: rms {fit.rms_px:.2f} px, {len(fit.used)} views to {fit.widest_deg:.0f} deg", fontsize=9, loc="left"
    )


def _draw_mats(axes, names: tuple[str, ...], fit: MountFit) -> None:
    plain_axes(axes)
    axes.fill(VEHICLE_M[:, 1], VEHICLE_M[:, 0], facecolor="#eceff1", edgecolor="#90a4ae")
    for index, name in enumerate(names):
        at = fit.camera == index
        size = 400.0 * fit.after_m[at]
        axes.scatter(
            fit.p_base[at, 1], fit.p_base[at, 0], s=10 + 20 * size, facecolor="none", edgecolor=_COLOURS[index % 6],
            linewidth=0.9, label=f"{name}: {1e3 * fit.after_m[at].mean():.1f} mm",
        )  # fmt: skip
    axes.invert_xaxis()
    axes.set_aspect("equal")
    axes.set_xlabel("y [m], left is left", fontsize=9)
    axes.set_ylabel("x [m], ahead is up", fontsize=9)
    axes.set_title("surveyed corners: the area of a circle grows with its error", fontsize=9, loc="left")
    for handle in axes.legend(fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1.02, 0.5)).legend_handles:
        handle.set_sizes([40.0])
