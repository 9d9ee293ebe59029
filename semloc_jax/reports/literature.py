"""A map of the literature beside ours: what `semloc map --baseline` adds (room: reports; host).

In: a drive, its masks, the folder of our map of it. Out: a folder with way, loops, points, metrics; a table of both.
The table also has what bounds both: the way without any loop, and the graph with the true motion of every pair that
the baseline looked at.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from semloc_jax.alignment.class_icp import ClassPoints
from semloc_jax.datasets import Drive
from semloc_jax.evaluation import Metric, Trajectory, aligned, evaluate, read_metrics, write_metrics, write_tum
from semloc_jax.geometry import rigid
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.chain import Chain, drive_chain
from semloc_jax.mapping.chain_graph import Loops
from semloc_jax.mapping.found_loops import FoundLoop, write_loops
from semloc_jax.mapping.gauge import Gauge, gauge_of
from semloc_jax.mapping.literature.avp import avp_map
from semloc_jax.mapping.literature.point_loops import LiteratureMap
from semloc_jax.mapping.literature.road_slam import road_slam_map
from semloc_jax.reports.map_judgement import loop_metrics, true_poses
from semloc_jax.reports.tables import write_csv
from semloc_jax.structs import ElementClass
from semloc_jax.viz import points_from_above, save

Told = Callable[[Iterable, str], Iterable]
Baseline = Callable[[Drive, MaskSource, Chain, Gauge, Told], LiteratureMap]


def _avp(drive: Drive, masks: MaskSource, chain: Chain, gauge: Gauge, told: Told) -> LiteratureMap:
    return avp_map(drive, masks, chain, gauge, told=told)


def _road_slam(drive: Drive, masks: MaskSource, chain: Chain, gauge: Gauge, told: Told) -> LiteratureMap:
    return road_slam_map(drive, masks, chain, gauge, told=told)


BASELINES: Mapping[str, Baseline] = {"avp": _avp, "road-slam": _road_slam}
"""By the word of the option."""
_REACH_M = 15.0
"""A pair that was looked at and is farther apart in truth is no loop that anybody could close."""
_TRUE_SIGMA = np.repeat([0.01, 0.001], 3)
"""Of the true motions, as good as exact [m, rad]."""
_ROWS = (
    ("horizontal.rmse", "trajectory, RMSE [m]", 1.0),
    ("horizontal.max", "trajectory, largest error [m]", 1.0),
    ("heading.max", "heading, largest error [deg]", 1.0),
    ("loops.searched", "revisits looked at", 0.0),
    ("loops.accepted", "loops accepted", 0.0),
    ("loops.false", "of them false", 0.0),
    ("loops.error.max", "worst loop accepted [m]", 1.0),
)
"""Key, words, and whether it has decimals."""


def report_baseline(name: str, drive: Drive, masks: MaskSource, start: str | None, ours: Path) -> str:
    """Make the map of a baseline in `ours`/baseline_NAME and tell it beside the map that is in `ours`.

    Args:
        name: of `BASELINES`.
        drive: the drive.
        masks: what its cameras see.
        start: what fixes the frame of the map, as for ours.
        ours: folder of our map of the same drive, with its metrics.json.

    Returns:
        A table: one row for each number, a column for each way of making the map.

    Raises:
        SemlocError: the baseline lacks what it needs of the drive, its masks or this installation.
    """
    folder = ours / f"baseline_{name}"
    folder.mkdir(exist_ok=True)
    chain = drive_chain(drive)
    gauge = gauge_of(drive, chain, start)
    made = BASELINES[name](drive, masks, chain, gauge, lambda items, what: tqdm(items, desc=what, disable=None))
    trajectory = Trajectory(chain.times_s, made.Ts_map_base)
    write_tum(trajectory, folder / "trajectory.tum")
    write_loops(folder / "loops.csv", made.loops, chain.times_s)
    _write_points(made.points, folder / "points.csv")
    ends = [(made.Ts_map_base[loop.a], made.Ts_map_base[loop.b]) for loop in made.loops if loop.is_accepted]
    save(points_from_above(made.points.xy, made.points.label, made.Ts_map_base, ends, drive.name), folder / "map.png")
    truth = true_poses(drive, chain.times_s)
    metrics = [*way_metrics(drive, trajectory), *loop_metrics(made.loops, truth)]
    write_metrics(metrics, folder / "metrics.json")
    without = Trajectory(chain.times_s, gauge.solve(chain).Ts_map_base)
    columns = {"no loops": way_metrics(drive, without), name: metrics}
    if truth is not None:
        loops = true_loops(made.loops, truth)
        known = Trajectory(chain.times_s, gauge.solve(chain, loops).Ts_map_base)
        columns["true loops"] = way_metrics(drive, known)
    columns["ours"] = read_metrics(ours / "metrics.json")
    return side_by_side(columns)


def way_metrics(drive: Drive, trajectory: Trajectory) -> list[Metric]:
    """Errors of a way after one motion in the plane; none where the drive has no truth."""
    if drive.truth is None:
        return []
    return evaluate(aligned(trajectory, drive.truth, "se2")[0], drive.truth)


def true_loops(found: Sequence[FoundLoop], Ts_true: Float[np.ndarray, "n 4 4"]) -> Loops:
    """The true motion of every pair that was looked at and is near in truth: what the best matcher would give."""
    pairs = sorted({(loop.a, loop.b) for loop in found})
    motions = [rigid.inverse(Ts_true[a]) @ Ts_true[b] for a, b in pairs]
    near = [k for k, T in enumerate(motions) if np.hypot(T[0, 3], T[1, 3]) <= _REACH_M]
    return Loops(
        np.array([pairs[k][0] for k in near], int),
        np.array([pairs[k][1] for k in near], int),
        np.array([motions[k] for k in near]).reshape(-1, 4, 4),
        np.tile(np.diag(_TRUE_SIGMA**2), (len(near), 1, 1)),
    )


def side_by_side(columns: Mapping[str, Sequence[Metric]]) -> str:
    """A table of the same numbers of several maps; '-' where one has none."""
    values = {name: {metric.key: metric.value for metric in metrics} for name, metrics in columns.items()}
    lines = ["".join([" " * 32, *(f"{name:>12}" for name in columns)])]
    for key, words, decimals in _ROWS:
        cells: list[Any] = [values[name].get(key) for name in columns]
        if any(cell is not None for cell in cells):
            shown = ["-" if cell is None else f"{cell:.3f}" if decimals else f"{cell:.0f}" for cell in cells]
            lines.append("".join([f"{words:<32}", *(f"{text:>12}" for text in shown)]))
    return "\n".join(lines)


def _write_points(points: ClassPoints, path: Path) -> None:
    names = {int(label): label.name.lower() for label in ElementClass}
    rows = ((names[int(k)], f"{x:.3f}", f"{y:.3f}") for (x, y), k in zip(points.xy, points.label, strict=True))
    write_csv(path, ("class", "x_m", "y_m"), rows)
