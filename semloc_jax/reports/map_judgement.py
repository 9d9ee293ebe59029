"""A map made from a drive, judged: its loops, its base map, its way and its elements (room: reports; host).

In: a MadeMap and the way that it was drawn along, the drive with its truth and its map. Out: metrics, a picture.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from semloc_jax.datasets import Drive
from semloc_jax.evaluation import (
    MapComparison,
    Metric,
    Trajectory,
    aligned,
    compare_maps,
    evaluate,
    surveyed_distances,
    surveyed_metrics,
)
from semloc_jax.geometry import rigid
from semloc_jax.mapping.base_map import Change
from semloc_jax.mapping.found_loops import FoundLoop
from semloc_jax.mapping.mapper import MadeMap
from semloc_jax.maps import read_map
from semloc_jax.storage import json_document
from semloc_jax.viz import maps_over_each_other, save

NUM_SEEN = 5
"""An element of the reference counts where it was looked at in so many frames."""
_FALSE_LOOP_M, _FALSE_LOOP_DEG = 0.5, 2.0
"""A loop that is off by more leads to another place."""


def base_metrics(places: Sequence[FoundLoop], changes: Sequence[Change]) -> list[Metric]:
    """How often the drive was found in the base map, and what it changed there."""
    counts = {
        "base.searched": len(places),
        "base.found": sum(place.is_accepted for place in places),
        "base.removed": sum(change.change == "removed" for change in changes),
        "base.moved": sum(change.change == "moved" for change in changes),
        "base.added": sum(change.change == "added" for change in changes),
    }
    units = ("places", "places", "elements", "elements", "elements")
    return [Metric(key, float(n), unit, "report") for (key, n), unit in zip(counts.items(), units, strict=True)]


def true_poses(drive: Drive, times_s: np.ndarray) -> np.ndarray | None:
    """True poses of all frames; None where the reference does not span them."""
    truth = drive.truth
    if truth is None or truth.time_s[0] > times_s[0] or truth.time_s[-1] < times_s[-1]:
        return None
    return truth.interpolate(times_s)


def loop_metrics(loops: Sequence[FoundLoop], Ts_true: np.ndarray | None) -> list[Metric]:
    """How many revisits were searched and accepted and, where the truth of every frame is known, which were false."""
    accepted = [loop for loop in loops if loop.is_accepted]
    metrics = [
        Metric("loops.searched", float(len(loops)), "loops", "report"),
        Metric("loops.accepted", float(len(accepted)), "loops", "report"),
    ]
    if Ts_true is None or not accepted:
        return metrics
    off = np.array(
        [rigid.log(rigid.inverse(rigid.inverse(Ts_true[loop.a]) @ Ts_true[loop.b]) @ loop.T_a_b) for loop in accepted]
    )
    off_m, off_deg = np.hypot(off[:, 0], off[:, 1]), np.degrees(np.abs(off[:, 5]))
    false = float(np.sum((off_m > _FALSE_LOOP_M) | (off_deg > _FALSE_LOOP_DEG)))
    return [
        *metrics,
        Metric("loops.false", false, "loops"),
        Metric("loops.error.median", float(np.median(off_m)), "m"),
        Metric("loops.error.max", float(off_m.max()), "m"),
    ]


def judged(
    drive: Drive, made: MadeMap, trajectory: Trajectory, folder: Path
) -> tuple[list[Metric], MapComparison | None]:
    """The map and the trajectory against those of the drive, where it has them, after one motion in the plane each."""
    metrics: list[Metric] = []
    guess = np.eye(4)
    if drive.truth is not None:
        moved, guess = aligned(trajectory, drive.truth, "se2")
        metrics = evaluate(moved, drive.truth)
    if drive.map_path is None or drive.truth is None:
        return metrics, None
    reference = read_map(drive.map_path)

    def seen(xy_reference: np.ndarray) -> np.ndarray:
        back = np.linalg.inv(comparison_motion)
        return made.seen(xy_reference @ back[:2, :2].T + back[:2, 3], NUM_SEEN)

    ours = made.belief_map.map.elements
    comparison_motion = compare_maps(ours, reference.elements, "se2", T_reference_made=guess).T_reference_made
    comparison = compare_maps(ours, reference.elements, "none", seen=seen, T_reference_made=comparison_motion)
    moved = [e.with_points(e.points @ comparison_motion[:3, :3].T + comparison_motion[:3, 3]) for e in ours]
    extent = np.stack([e.points.mean(axis=0)[:2] for e in moved])
    low, high = extent.min(axis=0) - 20.0, extent.max(axis=0) + 20.0
    near = [e for e in reference.elements if not e.is_logical and _within(e.points[:, :2], low, high)]
    save(maps_over_each_other([e for e in moved if not e.is_logical], near, drive.name), folder / "against_truth.png")
    return [*metrics, *comparison.metrics(), *_surveyed(drive, made, comparison_motion)], comparison


def _surveyed(drive: Drive, made: MadeMap, T_reference_made: np.ndarray) -> list[Metric]:
    """The distances that were surveyed in the place of the drive, where it tells some."""
    path = drive.path / "meta.json"
    rows = json_document(path.read_bytes(), f"drive file {path}").get("surveyed") if path.is_file() else None
    if not rows:
        return []
    return surveyed_metrics(made.belief_map.map.elements, surveyed_distances(rows, str(path)), T_reference_made)


def _within(xy: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
    return bool(((xy >= low) & (xy <= high)).all(axis=1).any())
