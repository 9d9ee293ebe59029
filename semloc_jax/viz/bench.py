"""The benchmark as one picture: cost against hypotheses and points, memory, roofline (room: viz).

In: what `semloc bench --json` writes, as plain data. Out: a Figure.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from semloc_jax.errors import SemlocError
from semloc_jax.viz.style import INK, new_figure, plain_axes

OURS = ("#d81b60", "#8e24aa", "#3949ab")
PEERS = ("#00897b", "#7cb342", "#fb8c00", "#6d4c41", "#546e7a", "#00acc1", "#c0ca33", "#f06292", "#212121")
NUM_POINTS = 1000
_SMALL = {"textcoords": "offset points", "fontsize": 7.5, "color": INK}


def benchmark_figure(data: dict) -> Figure:
    """Four panels: CPU time of a solve by number of starts and of points, peak memory, and the roofline.

    Args:
        data: Content of the JSON file: `rows` and `roofline`.

    Raises:
        SemlocError: There are no rows.
    """
    rows = [row for row in data.get("rows", ()) if row["kind"] == "many" and row["median_ms"] is not None]
    if not rows:
        raise SemlocError("benchmark picture: no measurements of many starts; expected the JSON of `semloc bench`")
    figure = new_figure(12.0, 8.4)
    (starts, points), (memory, roof) = figure.subplots(2, 2)
    colours = _colours(rows)
    _curves(starts, [row for row in rows if row["points"] == NUM_POINTS], "starts", "median_ms", colours)
    _label(starts, "starts in one call", "CPU ms a solve", f"{NUM_POINTS} points")
    # The curve over points is measured with as many starts as every peer manages.
    by_points = [row for row in rows if row["starts"] == 64]
    _curves(points, by_points, "points", "median_ms", colours)
    _label(points, "points", "CPU ms a solve", "64 starts in one call")
    _curves(memory, [row for row in rows if row["points"] == NUM_POINTS], "starts", "peak_mib", colours)
    _label(memory, "starts in one call", "peak memory of the process [MiB]", "libraries and compiler included")
    _roofline(plain_axes(roof), data["roofline"], {row["text"]: colours[row["peer"]] for row in rows})
    handles, labels = starts.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8, frameon=False, labelcolor=INK)
    return figure


def roofline_figure(roofline: dict) -> Figure:
    """The roofline alone, every path with its name.

    Args:
        roofline: What `semloc_jax.bench.roofline.as_data` returns.
    """
    figure = new_figure(7.5, 5.0)
    names = [path["path"] for path in roofline["paths"]]
    colours = {name: (*OURS, *PEERS)[k % (len(OURS) + len(PEERS))] for k, name in enumerate(names)}
    _roofline(plain_axes(figure.subplots()), roofline, colours, named=True)
    return figure


def _colours(rows: list[dict]) -> dict[str, str]:
    names = list(dict.fromkeys(row["peer"] for row in rows))
    ours = [name for name in names if name.startswith("semloc")]
    others = [name for name in names if name not in ours]
    return dict(zip(ours, OURS, strict=False)) | {name: PEERS[k % len(PEERS)] for k, name in enumerate(others)}


def _curves(axes: Axes, rows: list[dict], by: str, value: str, colours: dict[str, str]) -> None:
    plain_axes(axes)
    for peer, colour in colours.items():
        mine = sorted((row[by], row[value], row["text"]) for row in rows if row["peer"] == peer)
        if mine:
            x, y, text = zip(*mine, strict=True)
            ours = peer.startswith("semloc")
            style = {"linewidth": 2.0 if ours else 1.1, "markersize": 4.5 if ours else 3.0, "zorder": 3 if ours else 2}
            axes.plot(x, y, "o-", color=colour, label=text[0], **style)
    _log_scales(axes)


def _log_scales(axes: Axes) -> None:
    """Both axes logarithmic, with numbers that are written out."""
    axes.set_xscale("log", base=4)
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.10g}"))
        axis.set_minor_formatter(NullFormatter())


def _label(axes: Axes, x: str, y: str, title: str) -> None:
    axes.set_xlabel(x, fontsize=9, color=INK)
    axes.set_ylabel(y, fontsize=9, color=INK)
    axes.set_title(title, fontsize=9, color=INK, loc="left")


def _roofline(axes: Axes, roofline: dict, colours: dict[str, str], named: bool = False) -> None:
    """Reached GFLOP/s of counted work over FLOP a byte, below the roofs of the core."""
    roofs = roofline["roofs"]
    intensity = np.geomspace(0.25, 256.0, 200)
    peak = roofs["matmul_gflops"]
    lines = ("cache_gbps", "-", "in cache", "right", 3), ("stream_gbps", "--", "from memory", "left", -9)
    for name, style, text, side, rise in lines:
        reach = np.minimum(peak, intensity * roofs[name])
        axes.plot(intensity, reach, style, color=INK, linewidth=1.2)
        place = 1.0, roofs[name]
        axes.annotate(f"{roofs[name]:.0f} GB/s {text}", place, xytext=(rise * -1, rise), **_SMALL, ha=side)
    axes.annotate(f"{peak:.0f} GFLOP/s", (60.0, peak), xytext=(0, 4), **_SMALL)
    here = roofline["flop_a_point"] / roofline["bytes_a_point"]
    texels = roofline["flop_a_point"] * roofs["gather_mps"] * 1e-3
    axes.plot([here * 0.5, here * 2], [texels] * 2, ":", color=INK, linewidth=1.2)
    axes.annotate("texel reads", (here * 2, texels), xytext=(5, 0), **_SMALL, va="center")
    axes.axvline(here, color=INK, alpha=0.25, linewidth=0.8)
    for path in roofline["paths"]:
        colour = colours.get(path["path"], INK)
        axes.scatter(here, path["gflops"], s=26, color=colour, zorder=4)
        us = path["evaluation_us"]
        label = f"{us:.3g} us" if us < 1000 else f"{us:.0f} us"
        label += f"  {path['path']}" if named else ""
        axes.annotate(label, (here, path["gflops"]), xytext=(7, 0), **_SMALL | {"color": colour}, va="center")
    _log_scales(axes)
    _label(axes, "FLOP a byte", "GFLOP/s of one core, least work counted", "roofline of an evaluation")
