"""Trajectories: vehicle poses over time, their files and their time association (room: evaluation; host).

In: TUM, KITTI or npy files. Out: Trajectory, matched index pairs.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation, Slerp

from semloc_jax.errors import SemlocError
from semloc_jax.geometry.rigid import pose_from
from semloc_jax.storage import FARTHEST_M, npy_array, writing

_LARGEST_SKEW = 0.01
"""Of the products of the rows of a rotation matrix: files hold six digits; ours."""
_UPRIGHT = 0.97
"""Mean upward part of base z of anything that drives on roads; ours."""


@dataclass(frozen=True)
class Trajectory:
    """Vehicle poses in time order.

    Args:
        time_s: strictly increasing times [s].
        T_map_base: poses, `base` to `map` [m].
    """

    time_s: Float[np.ndarray, " n"]
    T_map_base: Float[np.ndarray, "n 4 4"]

    def __post_init__(self) -> None:
        if self.time_s.ndim != 1 or self.T_map_base.shape != (len(self.time_s), 4, 4):
            raise SemlocError(
                f"trajectory: got time_s {self.time_s.shape} and T_map_base {self.T_map_base.shape}; expected [n] and "
                "[n 4 4]; give one pose for each time"
            )
        if np.any(np.diff(self.time_s) <= 0.0):
            row = int(np.argmax(np.diff(self.time_s) <= 0.0)) + 1
            raise SemlocError(
                f"trajectory: time {self.time_s[row]:.9f} s of pose {row} is not after {self.time_s[row - 1]:.9f} s; "
                "expected strictly increasing times; sort the poses and drop duplicates"
            )

    def __len__(self) -> int:
        return len(self.time_s)

    def interpolate(self, time_s: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k 4 4"]:
        """Poses at `time_s` [s]: linear in position, spherical-linear in attitude.

        Raises:
            SemlocError: a time lies outside the trajectory.
        """
        outside = (time_s < self.time_s[0]) | (time_s > self.time_s[-1])
        if outside.any():
            raise SemlocError(
                f"trajectory: time {time_s[outside][0]:.3f} s lies outside {self.time_s[0]:.3f} .. "
                f"{self.time_s[-1]:.3f} s; ask for times inside the trajectory"
            )
        if len(self) == 1 or len(time_s) == 0:
            return np.repeat(self.T_map_base[:1], len(time_s), axis=0)
        # Only the poses around these times: a frame of a long drive asks for one.
        first = max(int(np.searchsorted(self.time_s, time_s.min(), side="right")) - 1, 0)
        last = min(max(int(np.searchsorted(self.time_s, time_s.max())), first + 1), len(self) - 1)
        near = slice(min(first, last - 1), last + 1)
        known_s, Ts = self.time_s[near], self.T_map_base[near]
        T = np.tile(np.eye(4), (len(time_s), 1, 1))
        T[:, :3, :3] = Slerp(known_s, Rotation.from_matrix(Ts[:, :3, :3]))(time_s).as_matrix()
        for axis in range(3):
            T[:, axis, 3] = np.interp(time_s, known_s, Ts[:, axis, 3])
        return T


def associate(
    time_a_s: Float[np.ndarray, " n"], time_b_s: Float[np.ndarray, " m"], max_difference_s: float = 0.02
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]]:
    """One-to-one pairs of nearest times, no farther apart than `max_difference_s`, as indices into a and b."""
    if len(time_a_s) == 0 or len(time_b_s) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    nearest_b = _nearest(time_a_s, time_b_s)
    nearest_a = _nearest(time_b_s, time_a_s)
    index_a = np.arange(len(time_a_s))
    mutual = nearest_a[nearest_b] == index_a
    close = np.abs(time_a_s - time_b_s[nearest_b]) <= max_difference_s
    keep = mutual & close
    return index_a[keep], nearest_b[keep]


def _nearest(query_s: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    right = np.clip(np.searchsorted(times_s, query_s), 1, max(len(times_s) - 1, 1))
    right = np.minimum(right, len(times_s) - 1)
    left = np.maximum(right - 1, 0)
    return np.where(query_s - times_s[left] <= times_s[right] - query_s, left, right)


def read_trajectory(path: str | Path) -> Trajectory:
    """Trajectory of a file, its type guessed from its columns.

    Text with 8 columns is TUM (t x y z qx qy qz qw), with 12 is KITTI (rows of a 3x4 pose; the time is the row number
    unless `times.txt` lies beside it); npy holds [n 8] TUM rows or [n 4 4] poses (time is the row number).

    Raises:
        SemlocError: the file is missing, is not numeric or has another number of columns.

    >>> truth = sj.read_trajectory(folder / "poses_body.tum")
    >>> truth.interpolate(truth.time_s[:1]).shape
    (1, 4, 4)
    """
    path = Path(path)
    if not path.is_file():
        raise SemlocError(f"trajectory {path}: no such file; expected a TUM, KITTI or npy file")
    if path.suffix == ".npy":
        rows = npy_array(path, f"trajectory {path}")
        if rows.dtype.kind not in "fiu" or not np.isfinite(rows).all():
            raise SemlocError(
                f"trajectory {path}: not readable as npy ({rows.dtype}); expected [n 8] or [n 4 4] numbers"
            )
        rows = rows.astype(np.float64)
        if rows.ndim == 3 and rows.shape[1:] == (4, 4):
            _require_rotations(rows, path)
            return Trajectory(np.arange(len(rows), dtype=np.float64), rows)
    else:
        rows = _read_rows(path)
    if rows.ndim == 2 and rows.shape[1] == 8:
        return _from_tum_rows(rows, path)
    if rows.ndim == 2 and rows.shape[1] == 12:
        return _from_kitti_rows(rows, path)
    raise SemlocError(
        f"trajectory {path}: got an array {rows.shape}; expected 8 columns (TUM), 12 columns (KITTI) or [n 4 4] (npy)"
    )


def write_tum(trajectory: Trajectory, path: str | Path, what: str = "base") -> None:
    """Write `t x y z qx qy qz qw` rows with 9 decimals of time and position.

    Args:
        trajectory: Poses T_map_what.
        path: The file.
        what: Whose poses they are, for the header.

    >>> sj.write_tum(drive.truth, tmp / "poses.tum")
    >>> len(sj.read_trajectory(tmp / "poses.tum")) == len(drive.truth)
    True
    """
    quaternion = Rotation.from_matrix(trajectory.T_map_base[:, :3, :3]).as_quat()
    rows = np.column_stack([trajectory.time_s, trajectory.T_map_base[:, :3, 3], quaternion])
    header = f"t[s] x y z[m] qx qy qz qw : {what} in map"
    with writing(path) as partial:
        np.savetxt(partial, rows, fmt=["%.9f"] * 4 + ["%.12f"] * 4, header=header)


def _read_rows(path: Path) -> np.ndarray:
    lines = [line.split("#", 1)[0].replace(",", " ").split() for line in path.read_text(errors="replace").splitlines()]
    lines = [line for line in lines if line]
    if not lines:
        raise SemlocError(f"trajectory {path}: holds no pose; expected one pose on each line")
    other = next((index for index, line in enumerate(lines) if len(line) != len(lines[0])), None)
    if other is not None:
        raise SemlocError(
            f"trajectory {path}: row 1 holds {len(lines[0])} cells and row {other + 1} {len(lines[other])}; expected "
            "rows of 8 (TUM) or 12 (KITTI) numbers"
        )
    try:
        rows = np.array(lines, dtype=np.float64)
        if not np.isfinite(rows).all():
            raise ValueError("a value is NaN or infinite")
        return rows
    except ValueError as error:
        raise SemlocError(
            f"trajectory {path}: not a table of numbers ({error}); expected rows of 8 (TUM) or 12 (KITTI) numbers"
        ) from error


def _from_tum_rows(rows: np.ndarray, path: Path) -> Trajectory:
    _require_near(rows[:, 1:4], path)
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(rows[:, 4:], axis=1)
    if np.any(np.abs(norm - 1.0) > 0.01):
        row = int(np.argmax(np.abs(norm - 1.0)))
        raise SemlocError(
            f"trajectory {path}: the quaternion of pose {row} has norm {norm[row]:.3f}; expected 1 in the order "
            "qx qy qz qw; check the columns"
        )
    if _upright(rows[:, 4:]) < _UPRIGHT <= _upright(rows[:, [5, 6, 7, 4]]):
        raise SemlocError(
            f"trajectory {path}: read as qx qy qz qw the vehicle leans, read as qw qx qy qz it stands on its wheels; "
            "expected qx qy qz qw; put qw last"
        )
    T = pose_from(Rotation.from_quat(rows[:, 4:]).as_matrix(), rows[:, 1:4])
    return Trajectory(rows[:, 0].copy(), T)


def _upright(quaternion_xyzw: np.ndarray) -> float:
    """Mean of the upward part of base z over poses: 1 on a plain, 0.98 on a slope of 11 degrees."""
    return float(np.mean(Rotation.from_quat(quaternion_xyzw).as_matrix()[:, 2, 2]))


def _require_near(t_m: np.ndarray, path: Path) -> None:
    far = np.abs(t_m).max(axis=1, initial=0.0)
    if far.max(initial=0.0) > FARTHEST_M:
        raise SemlocError(
            f"trajectory {path}: pose {int(np.argmax(far))} lies {far.max():.3g} m from the origin; expected a place "
            "on the earth; check the columns"
        )


def _require_rotations(T: np.ndarray, path: Path) -> None:
    _require_near(T[:, :3, 3], path)
    R = np.clip(T[:, :3, :3], -2.0, 2.0)
    off = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    off = np.where(np.linalg.det(R) > 0.0, off, 2.0)
    if off.max(initial=0.0) > _LARGEST_SKEW:
        raise SemlocError(
            f"trajectory {path}: the matrix of pose {int(np.argmax(off))} is no rotation; expected three rows of "
            "orthogonal unit vectors; check the columns"
        )


def _from_kitti_rows(rows: np.ndarray, path: Path) -> Trajectory:
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3, :] = rows.reshape(-1, 3, 4)
    _require_rotations(T, path)
    times = path.with_name("times.txt")
    time_s = _read_rows(times)[:, 0] if times.is_file() else np.arange(len(rows), dtype=np.float64)
    if len(time_s) != len(rows):
        raise SemlocError(
            f"trajectory {path}: {len(rows)} poses and {len(time_s)} times in times.txt; expected one each; repair one"
        )
    return Trajectory(time_s, T)
