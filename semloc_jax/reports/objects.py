"""What the reports of slots and of obstacles have in common (room: reports; host).

In: tracks of things around a vehicle, the lines of the table of their sights. Out: cells of a table, a belief, two
tables, metrics.json and the text for people.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from semloc_jax.evaluation import Metric, format_metrics, write_metrics
from semloc_jax.mapping.object_tracks import ObjectTrack, wrapped
from semloc_jax.maps import Belief
from semloc_jax.reports.tables import OBJECT_POSE, write_csv

SIGMAS = ("sigma_x_m", "sigma_y_m", "sigma_yaw_rad", "existence")
"""Of every thing; the first two along x and y of the vehicle."""


class Tables(NamedTuple):
    """How the tables of one sort of thing are called."""

    things: str
    """Plural; the name of the files, too."""
    kind: str
    """Column that says what a thing is."""
    size: tuple[str, ...]
    """Columns between pose and sigmas."""


def placed(track: ObjectTrack, yaw_rad: float, T_odom_base: np.ndarray) -> tuple[list[str], tuple[float, float]]:
    """Cells of the pose of a thing in base and in odom, and its sigmas along x and y of the base frame [m]."""
    R = T_odom_base[:2, :2]
    x, y = R.T @ (track.pose[:2] - T_odom_base[:2, 3])
    yaw = wrapped(yaw_rad - float(np.arctan2(R[1, 0], R[0, 0])))
    C = R.T @ track.covariance[:2, :2] @ R
    cells = [f"{value:.4f}" for value in (x, y, yaw, *track.pose[:2], wrapped(yaw_rad))]
    return cells, (float(np.sqrt(C[0, 0])), float(np.sqrt(C[1, 1])))


def belief_of(track: ObjectTrack, drive: str) -> Belief:
    """What is believed of a thing that a drive has followed."""
    sigma_m = float(np.sqrt(0.5 * np.trace(track.covariance[:2, :2])))
    return Belief(
        sigma_m, sigma_m, track.existence_logit, track.num_seen, track.num_missed, last_seen_s=track.last_s,
        provenance=drive,
    )  # fmt: skip


def write_objects(
    folder: Path,
    tables: Tables,
    sights: Sequence[tuple],
    final: Sequence[ObjectTrack],
    row_of: Callable[[ObjectTrack], tuple],
    num_frames: int,
    errors: Sequence[Metric],
    notes: Sequence[str],
) -> str:
    """Write the table of all sights, that of all things and metrics.json; the text for people.

    Args:
        tables: What the things are called.
        sights: Lines of the first table; the last cell says whether the track was confirmed.
        final: What was found in the end.
        row_of: The line of one of them, as those of `sights`.
        num_frames: That were looked at.
        errors: Against the truth, where there is one.
        notes: What else to tell.
    """
    columns = (tables.kind, *OBJECT_POSE, *tables.size, *SIGMAS)
    write_csv(folder / f"{tables.things}.csv", ("t", "track", *columns, "confirmed"), sights)
    counted = [(*row_of(track)[:-1], track.num_seen, track.num_missed) for track in final]
    last = ("t_last", "track", *columns, "num_seen", "num_missed")
    write_csv(folder / f"{tables.things}_final.csv", last, counted)
    metrics = [
        Metric("frames", float(num_frames), "frames", "report"),
        Metric(f"{tables.things}.sights", float(len(sights)), "sights", "report"),
        Metric(f"{tables.things}.final", float(len(final)), tables.things, "report"),
        *errors,
    ]
    write_metrics(metrics, folder / "metrics.json")
    said = f"{num_frames} frames: {len(sights)} sights of {tables.things}, {len(final)} {tables.things} confirmed"
    return "\n".join([said, format_metrics(metrics), *notes, f"results: {folder}"])
