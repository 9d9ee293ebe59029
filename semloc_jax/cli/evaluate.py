"""`semloc evaluate`: a trajectory or a map against a reference, with an optional gate (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from semloc_jax.cli.main import LOST, OK

if TYPE_CHECKING:
    from semloc_jax.evaluation import Metric


@dataclass(frozen=True)
class Options:
    """Errors of a trajectory in the vehicle frame of its reference, or of a map, unaligned unless --align asks.

    Trajectories are TUM, KITTI or npy files. Two maps (.gpkg, .geojson, .osm, .xodr, .smap) are compared class by
    class: precision, recall and F1 within 0.10 m across and 0.25 m along, what moved, what is missing, what was added.
    With --baseline the exit code is 3 when a metric got worse than it allows.
    """

    estimate: tyro.conf.Positional[Path]
    """Estimated trajectory, or made map."""
    reference: tyro.conf.Positional[Path]
    """True trajectory, or reference map."""
    max_difference_s: float = 0.02
    """Poses belong together when their times differ by no more than this."""
    align: Literal["none", "se2", "se3"] = "none"
    """Take one rigid motion out first, in the plane or in space: for trajectories in a frame of their own. Maps are
    moved in the plane, by at most about two metres."""
    baseline: Path | None = None
    """A metrics.json to compare with."""
    out: Path | None = None
    """Write metrics.json (and errors.png, of maps maps.png) into this folder."""


def run(options: Options) -> int:
    """Print the metrics, write them where asked, compare them with the baseline."""
    from semloc_jax import evaluation
    from semloc_jax.errors import UsageError
    from semloc_jax.maps.io.formats import MAP_SUFFIXES

    suffixes = (*MAP_SUFFIXES, ".json", ".xml")  # a trajectory may be a .txt, as an Apollo map is
    are_maps = [path.suffix.lower() in suffixes for path in (options.estimate, options.reference)]
    if any(are_maps) and not all(are_maps):
        raise UsageError("a map and a trajectory cannot be compared; give two trajectories, or two maps")
    metrics = _maps(options) if all(are_maps) else _trajectories(options)
    if options.baseline is None:
        return OK
    verdicts = evaluation.compare(metrics, evaluation.read_metrics(options.baseline))
    print(evaluation.format_verdicts(verdicts))
    return OK if evaluation.is_passed(verdicts) else LOST


def _trajectories(options: Options) -> "list[Metric]":
    import numpy as np

    from semloc_jax import evaluation

    estimate = evaluation.read_trajectory(options.estimate)
    reference = evaluation.read_trajectory(options.reference)
    if options.align != "none":
        estimate, motion = evaluation.aligned(estimate, reference, options.align, options.max_difference_s)
        turn_deg = np.rad2deg(np.arccos(np.clip(0.5 * np.trace(motion[:3, :3]) - 0.5, -1.0, 1.0)))
        print(f"aligned ({options.align}): turned by {turn_deg:.4f} deg, moved by {np.round(motion[:3, 3], 4)} m")
    metrics = evaluation.evaluate(estimate, reference, options.max_difference_s)
    print(evaluation.format_metrics(metrics))
    if options.out is not None:
        from semloc_jax.viz import save, trajectory

        options.out.mkdir(parents=True, exist_ok=True)
        evaluation.write_metrics(metrics, options.out / "metrics.json")
        save(trajectory.errors_over_time(estimate, reference, options.max_difference_s), options.out / "errors.png")
    return metrics


def _maps(options: Options) -> "list[Metric]":
    import numpy as np

    from semloc_jax import evaluation
    from semloc_jax.errors import UsageError
    from semloc_jax.maps import read_map

    if options.align == "se3":
        raise UsageError("--align se3: maps are compared from above; expected none or se2")
    made, reference = read_map(options.estimate), read_map(options.reference)
    comparison = evaluation.compare_maps(made.elements, reference.elements, options.align)
    motion = comparison.T_reference_made
    if options.align == "se2":
        turn_deg = np.rad2deg(np.arctan2(motion[1, 0], motion[0, 0]))
        print(f"aligned (se2): turned by {turn_deg:.4f} deg, moved by {np.round(motion[:2, 3], 4)} m")
    print(comparison.to_text())
    metrics = comparison.metrics()
    if options.out is not None:
        from semloc_jax.viz import maps_over_each_other, save

        options.out.mkdir(parents=True, exist_ok=True)
        evaluation.write_metrics(metrics, options.out / "metrics.json")
        moved = [e.with_points(e.points @ motion[:3, :3].T + motion[:3, 3]) for e in made.elements if not e.is_logical]
        shown = [element for element in reference.elements if not element.is_logical]
        save(maps_over_each_other(moved, shown, f"{made.name} over {reference.name}"), options.out / "maps.png")
    return metrics
