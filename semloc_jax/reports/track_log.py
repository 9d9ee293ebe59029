"""The table of a tracked drive, written while it is driven (room: reports).

In: TrackResult after TrackResult. Out: frames.csv, one line a frame, on disk before the next frame begins; and back.
"""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import Trajectory, pose_errors
from semloc_jax.evaluation.integrity import normalised_squares
from semloc_jax.localization.track_state import TrackResult, TrackStatus
from semloc_jax.reports.tables import ERRORS, MISLEADING, POSE, PROTECTION, SIGMAS
from semloc_jax.storage import reading, writing

FILE = "frames.csv"
QUALITY = ("cost", "coverage", "inlier_ratio", "chi2")
SENSORS = (
    *("odometer_scale", "gyro_bias_degps", "travel_deg", "gnss_offset_east_m", "gnss_offset_north_m"),
    "clock_offset_ms",
)
STAGES = ("predict", "align", "fuse", "acquire")
MOVED = ("moved_ahead_m", "moved_left_m", "moved_nats")
"""Where elements of one kind fit that are taken alone."""
NEES = "nees"
COLUMNS = (
    *("frame", "time_s", "variant", "status", "held", "reasons", *POSE, *SIGMAS, *PROTECTION, MISLEADING),
    *("accepted", "num_tracks", *QUALITY, *SENSORS, *(f"{stage}_ms" for stage in STAGES)),
    *("moved", *MOVED),
    *(f"error_{key}" for key in ERRORS),
    NEES,
)


REST = "more"
"""Key of the cells that a line has too many."""


class TrackLog:
    """Appends to frames.csv."""

    def __init__(self, folder: Path, drive: Drive, keep: int = 0):
        """Open the table.

        Args:
            drive: Gives the truth, where it has one.
            keep: Lines of an earlier run that stay; later ones are written anew.
        """
        path = folder / FILE
        kept = read_lines(path)[:keep] if keep and path.is_file() else []
        with writing(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows(kept)
        self.drive, self._file = drive, path.open("a", newline="", encoding="utf-8")
        self._writer = csv.DictWriter(self._file, COLUMNS)

    def append(self, frame: Frame, result: TrackResult) -> None:
        """Write the line of a frame."""
        self._writer.writerow(_line(frame, result, self._truth(frame)))
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _truth(self, frame: Frame) -> np.ndarray | None:
        truth = self.drive.truth
        if truth is None or not truth.time_s[0] <= frame.time_s <= truth.time_s[-1]:
            return None
        return self.drive.truth_at(frame)


def read_lines(path: Path) -> list[dict[str, str]]:
    """The lines of a table as text by column; a last one that a kill has cut is left out.

    Raises:
        SemlocError: no table with these columns.
    """
    with reading(f"table {path}"), path.open(newline="", encoding="utf-8") as file:
        lines = list(csv.DictReader(file, COLUMNS, restkey=REST))
        if not lines or list(lines[0].values()) != list(COLUMNS):
            raise ValueError(f"columns are not those of this version; expected {', '.join(COLUMNS[:3])} ...")
        is_whole = [line.get(REST) is None and None not in line.values() for line in lines[1:]]
        if not all(is_whole[:-1]):
            raise ValueError(f"line {is_whole.index(False) + 2} has not {len(COLUMNS)} cells")
        return [line for line, whole in zip(lines[1:], is_whole, strict=True) if whole]


def require_lines(folder: Path, frames: Sequence[Frame], where: str) -> None:
    """Check that the table of an unfinished run begins with these frames, in this order and without a hole.

    Raises:
        SemlocError: it does not.
    """
    path = folder / FILE
    lines = read_lines(path)[: len(frames)] if path.is_file() else []
    found = [(line["frame"], line["time_s"]) for line in lines]
    wanted = [(frame.id, f"{frame.time_s:.9f}") for frame in frames]
    if found != wanted:
        place = next((k for k, (a, b) in enumerate(zip(found, wanted, strict=False)) if a != b), len(found))
        raise SemlocError(
            f"{where}: line {place + 1} of {FILE} is not that of frame {' at '.join(wanted[place])} s; expected one "
            f"line for each of the {len(wanted)} frames that the state has seen; start again with another --out"
        )


@dataclass(frozen=True)
class TrackTable:
    """What frames.csv holds, as arrays; nan where a cell is empty."""

    frames: tuple[str, ...]
    variants: tuple[str, ...]
    status: tuple[TrackStatus, ...]
    reasons: tuple[str, ...]
    moved: tuple[str, ...]
    """lines or posts, where they fit elsewhere."""
    columns: dict[str, np.ndarray]

    @classmethod
    def read(cls, folder: Path) -> "TrackTable":
        """The table of a run.

        Raises:
            SemlocError: it is not what `TrackLog` writes.
        """
        path = folder / FILE
        lines = read_lines(path)
        text = ("frame", "variant", "status", "held", "reasons", "moved")
        numeric = [name for name in COLUMNS if name not in text]
        with reading(f"table {path}"):
            numbers = {name: np.array([float(line[name] or "nan") for line in lines]) for name in numeric}
            if any(np.isinf(values).any() for values in numbers.values()):
                raise ValueError("a number that is not finite")
            return cls(
                tuple(line["frame"] for line in lines),
                tuple(line["variant"] for line in lines),
                tuple(TrackStatus[line["status"]] for line in lines),
                tuple(line["reasons"] for line in lines),
                tuple(line["moved"] for line in lines),
                numbers,
            )

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def has_pose(self) -> np.ndarray:
        """Which frames have a pose."""
        return np.isfinite(self.columns["x_m"])

    @property
    def is_tracking(self) -> np.ndarray:
        """Which frames are called TRACKING."""
        return np.array([status == TrackStatus.TRACKING for status in self.status], dtype=bool)

    def trajectory(self, rows: np.ndarray | None = None) -> Trajectory:
        """Poses of the given rows (bool), of all that have one where nothing is given."""
        rows = self.has_pose if rows is None else rows & self.has_pose
        pose = np.column_stack([self.columns[key][rows] for key in POSE]).reshape(-1, len(POSE))
        T = np.tile(np.eye(4), (len(pose), 1, 1))
        if len(pose):
            T[:, :3, :3] = Rotation.from_quat(pose[:, 3:]).as_matrix()
            T[:, :3, 3] = pose[:, :3]
        return Trajectory(self.columns["time_s"][rows], T)

    def errors(self, rows: np.ndarray) -> dict[str, np.ndarray]:
        """Signed errors of the rows."""
        return {key: self.columns[f"error_{key}"][rows] for key in ERRORS}


def _line(frame: Frame, result: TrackResult, T_truth: np.ndarray | None) -> dict[str, Any]:
    line: dict[str, Any] = {
        "frame": frame.id,
        "time_s": f"{frame.time_s:.9f}",
        "variant": frame.variant,
        "status": result.status.name,
        "held": " ".join(result.held),
        "reasons": "; ".join(result.reasons),
        "accepted": int(result.accepted),
        "num_tracks": result.num_tracks,
    }
    line |= _numbers(QUALITY, [getattr(result, key) for key in QUALITY])
    if result.moved.kind:
        line |= {"moved": result.moved.kind} | _numbers(MOVED, result.moved[1:])
    line |= {f"{name}_ms": f"{ms:.3f}" for name, ms in result.times_ms.items()}
    fused = result.fused
    if fused is None:
        return line
    T, sigma = fused.T_map_base, np.sqrt(np.maximum(np.diagonal(fused.covariance), 0.0))
    quaternion = Rotation.from_matrix(T[:3, :3]).as_quat()
    line |= {key: f"{value:.9f}" for key, value in zip(POSE, [*T[:3, 3], *quaternion], strict=True)}
    line |= _numbers(SIGMAS, [sigma[1], sigma[0], np.degrees(sigma[5])]) | _numbers(PROTECTION, result.protection)
    line |= _numbers([MISLEADING], [result.misleading])
    offset = fused.gnss_offset_m
    angles = np.degrees([fused.gyro_bias_radps, fused.travel_rad])
    sensors = [fused.odometer_scale, *angles, *offset, 1e3 * result.clock_offset_s]
    line |= _numbers(SENSORS, sensors)
    if T_truth is not None:
        errors = pose_errors(T, T_truth)
        line |= _numbers([f"error_{key}" for key in ERRORS], [float(errors[key]) for key in ERRORS])
        line[NEES] = f"{_nees(errors, fused.covariance):.6g}"
    return line


def _nees(errors: dict[str, Any], covariance: np.ndarray) -> float:
    """Squared normalised error of longitudinal, lateral and heading together: 3 on average where sigmas are right."""
    x = np.array([errors["longitudinal_m"], errors["lateral_m"], np.radians(errors["heading_deg"])])
    plane = covariance[np.ix_([0, 1, 5], [0, 1, 5])]
    return float(normalised_squares(x[None], plane[None])[0])


def _numbers(names: Sequence[str], values: Sequence[float]) -> dict[str, str]:
    pairs = zip(names, values, strict=True)
    return {name: f"{float(value):.6g}" if np.isfinite(value) else "" for name, value in pairs}
