"""Tables of a run: one line for each frame, one for each mode (room: reports; host).

In: localization results, truth. Out: trajectory.tum, frames.csv, hypotheses.csv.
"""

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.evaluation import Trajectory, pose_errors, write_tum
from semloc_jax.storage import writing
from semloc_jax.structs import SolveStatus

SIGMAS = ("sigma_lateral_m", "sigma_longitudinal_m", "sigma_heading_deg")
PROTECTION = ("protection_lateral_m", "protection_longitudinal_m", "protection_heading_deg")
MISLEADING = "misleading"
"""Probability that an error is beyond its alert limit."""
EVIDENCE = ("nats", "nats_per_piece", "explained", "left_over", "border_offset_px", "log_prior", "kinds_chi2")
POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
OBJECT_POSE = ("x_m", "y_m", "yaw_rad", "x_odom_m", "y_odom_m", "yaw_odom_rad")
"""Of a slot or an obstacle: in the vehicle, then in the frame of the odometry."""
ERRORS = ("lateral_m", "longitudinal_m", "heading_deg")


def localized_trajectory(results: Sequence[LocalizationResult]) -> Trajectory:
    """Poses of the frames that were localized, in time order."""
    found = sorted((r for r in results if r.localized), key=lambda r: r.frame.time_s)
    time_s = np.array([r.frame.time_s for r in found], dtype=np.float64)
    return Trajectory(time_s, np.array([r.T_map_base for r in found], dtype=np.float64).reshape(-1, 4, 4))


def write_tables(results: Sequence[LocalizationResult], truth: Mapping[str, np.ndarray], folder: Path) -> None:
    """Write trajectory.tum (localized frames), frames.csv (every frame) and hypotheses.csv (every mode).

    Args:
        results: One for each frame.
        truth: True T_map_base by frame id; may be empty.
    """
    write_tum(localized_trajectory(results), folder / "trajectory.tum")
    error_columns = [f"error_{key}" for key in ERRORS] if truth else []
    columns = [
        "frame",
        "time_s",
        "localized",
        "status",
        "held",
        "reasons",
        *POSE,
        "cost",
        "coverage",
        *SIGMAS,
        *PROTECTION,
        MISLEADING,
        "time_ms",
    ]
    write_csv(folder / "frames.csv", [*columns, *error_columns], (_frame_row(r, truth) for r in results))
    columns = ["frame", "rank", "weight", *POSE, "cost", "coverage", *SIGMAS, *EVIDENCE]
    write_csv(folder / "hypotheses.csv", columns, (row for r in results for row in _mode_rows(r)))


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a table."""
    with writing(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(rows)


def _frame_row(result: LocalizationResult, truth: Mapping[str, np.ndarray]) -> list[Any]:
    best = result.modes[0] if result.modes else None
    quality = [_number(getattr(best, key, np.nan)) for key in ("cost", "coverage", *SIGMAS)]
    row = [
        result.frame.id,
        f"{result.frame.time_s:.9f}",
        int(result.localized),
        SolveStatus(result.status).name,
        " ".join(result.held),
        "; ".join(result.reasons),
        *_pose_cells(result.T_map_base),
        *quality,
        *(_number(value) for value in (*result.protection, result.misleading)),
        _number(1e3 * sum(result.times.values())),
    ]
    if not truth:
        return row
    if result.frame.id not in truth or not np.isfinite(result.T_map_base).all():
        return row + [""] * len(ERRORS)
    errors = pose_errors(result.T_map_base, truth[result.frame.id])
    return row + [_number(errors[key]) for key in ERRORS]


def _mode_rows(result: LocalizationResult) -> Iterable[list[Any]]:
    for rank, mode in enumerate(result.modes):
        quality = [_number(getattr(mode, key)) for key in ("cost", "coverage", *SIGMAS)]
        evidence = [_number(getattr(mode.evidence, key, np.nan)) for key in EVIDENCE]
        yield [result.frame.id, rank, _number(mode.weight), *_pose_cells(mode.T_map_base), *quality, *evidence]


def _pose_cells(T_map_base: np.ndarray) -> list[str]:
    if not np.isfinite(T_map_base).all():
        return [""] * len(POSE)
    quaternion = Rotation.from_matrix(T_map_base[:3, :3]).as_quat()
    return [f"{value:.6f}" for value in T_map_base[:3, 3]] + [f"{value:.9f}" for value in quaternion]


def _number(value: Any) -> str:
    return f"{float(value):.6g}" if np.isfinite(value) else ""
