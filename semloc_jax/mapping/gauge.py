"""Where the map that a drive makes lies: what fixes the frame that odometry leaves open (room: mapping; host).

In: the poses of a drive in its odometry frame, satellite fixes or a start. Out: T_map_odom.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from semloc_jax.datasets import Drive
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import Trajectory, read_trajectory
from semloc_jax.geometry.rigid import planar_pose
from semloc_jax.geometry.umeyama import umeyama

GNSS, TRUTH, IDENTITY = "gnss", "truth", "identity"
_KERNEL_M = 2.0
_NUM_FITS = 10
_SHORTEST_M = 10.0
"""Over a shorter way metre-level fixes say nothing about the heading."""


def map_from_odom(
    drive: Drive, times_s: Float[np.ndarray, " n"], Ts_odom_base: Float[np.ndarray, "n 4 4"], start: str | None
) -> tuple[Float[np.ndarray, "4 4"], str]:
    """The frame of the map as seen from that of the odometry, and the word for what gave it.

    Args:
        drive: with its fixes and, for `truth`, its reference.
        times_s: times of the poses.
        Ts_odom_base: poses of the frames, z up.
        start: `gnss`, `truth`, `identity` or a trajectory file with the first pose; None takes `gnss` where the drive
            has fixes, else `identity`.

    Raises:
        SemlocError: there are no fixes, no reference or no pose at the start.
    """
    start = start or (GNSS if drive.gnss is not None else IDENTITY)
    if start == IDENTITY:
        return planar_inverse(Ts_odom_base[0]), IDENTITY
    if start == GNSS:
        return _onto_fixes(drive, times_s, Ts_odom_base), GNSS
    if start == TRUTH:
        T_map_base = drive.truth_at(drive.frames[0])
    else:
        T_map_base = _first_pose(read_trajectory(Path(start)), float(times_s[0]), start)
    return _planar(T_map_base) @ planar_inverse(Ts_odom_base[0]), start


def planar_inverse(T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """The inverse of the position and heading of a pose."""
    return np.linalg.inv(_planar(T))


def _planar(T: np.ndarray) -> np.ndarray:
    """Position and heading of a pose, level: both frames have z up."""
    return planar_pose(float(T[0, 3]), float(T[1, 3]), float(np.arctan2(T[1, 0], T[0, 0])), float(T[2, 3]))


def _first_pose(trajectory: Trajectory, time_s: float, name: str) -> np.ndarray:
    gap_s = np.abs(trajectory.time_s - time_s)
    if gap_s.min() > 0.5:
        raise SemlocError(
            f"--start {name}: its poses are {gap_s.min():.1f} s away from the first frame at {time_s:.3f} s; expected "
            "one within 0.5 s on the clock of the drive"
        )
    return trajectory.T_map_base[int(gap_s.argmin())]


def _onto_fixes(drive: Drive, times_s: np.ndarray, Ts_odom_base: np.ndarray) -> np.ndarray:
    """The motion in the plane that brings the way closest to the fixes: an offset of all fixes stays in the map."""
    if drive.gnss is None:
        raise SemlocError(f"drive {drive.name}: has no satellite fixes; give --start TRAJECTORY.tum, or identity")
    gnss = drive.gnss
    inside = (gnss.time_s >= times_s[0]) & (gnss.time_s <= times_s[-1])
    poses = Trajectory(times_s, Ts_odom_base).interpolate(gnss.time_s[inside])
    p_odom = poses[:, :3, :3] @ np.array(gnss.antenna_base) + poses[:, :3, 3]
    p_map = gnss.p_enu[inside]
    if len(p_odom) < 3 or np.ptp(p_odom[:, :2], axis=0).max() < _SHORTEST_M:
        raise SemlocError(
            f"drive {drive.name}: {len(p_odom)} fixes over {np.ptp(p_odom[:, :2], axis=0).max(initial=0.0):.1f} m do "
            f"not tell the heading; expected at least 3 over {_SHORTEST_M:.0f} m; give --start TRAJECTORY.tum, or "
            "identity"
        )
    weight = np.ones(len(p_odom))
    for _ in range(_NUM_FITS):
        found = umeyama(p_map[:, :2], p_odom[:, :2], weight)
        off_m = np.linalg.norm(found.apply(p_odom[:, :2]) - p_map[:, :2], axis=1)
        weight = 1.0 / (1.0 + (off_m / _KERNEL_M) ** 2) ** 2
    turn = float(np.arctan2(found.R_a_b[1, 0], found.R_a_b[0, 0]))
    height_m = float(np.median(p_map[:, 2] - p_odom[:, 2]))
    return planar_pose(float(found.t_a_b[0]), float(found.t_a_b[1]), turn, height_m)
