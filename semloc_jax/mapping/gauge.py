"""Where the map that a drive makes lies: what fixes the frame that odometry leaves open (room: mapping; host).

In: the chain of a drive, satellite fixes or a start. Out: Gauge, which solves the way of the drive in that frame.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.datasets import Drive
from semloc_jax.datasets.sensors import GnssTrack
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import Trajectory, read_trajectory
from semloc_jax.geometry import rigid
from semloc_jax.mapping.chain import Chain
from semloc_jax.mapping.chain_graph import NO_LOOPS, ChainSolution, Loops, MapPlaces, Start, solve_chain

GNSS, TRUTH, IDENTITY = "gnss", "truth", "identity"
_START_SIGMA = np.repeat([1e-3, 1e-4], 3)
"""The first pose is what the frame of the map is made of [m, rad]."""
_FARTHEST_S = 0.5


class Gauge(NamedTuple):
    """What fixes the frame of a map."""

    name: str
    """gnss, truth, identity, or the file of the start."""
    gnss: GnssTrack | None
    start: Start | None

    def solve(self, chain: Chain, loops: Loops = NO_LOOPS, places: MapPlaces | None = None) -> ChainSolution:
        """The most likely way of the drive with what was found on it, and where it was found in a map."""
        return solve_chain(chain, loops, self.gnss, self.start, places=places)

    def guessed(self, sigma_xy_m: float, sigma_heading_rad: float) -> "Gauge":
        """The same where the first pose is a guess about a map that is there: it is known no better than told."""
        if self.start is None:
            return self
        sigma = np.array([sigma_xy_m, sigma_xy_m, sigma_xy_m, 0.02, 0.02, sigma_heading_rad])
        return self._replace(start=self.start._replace(covariance=np.diag(sigma**2)))


def gauge_of(drive: Drive, chain: Chain, start: str | None) -> Gauge:
    """What fixes the frame of the map of a drive.

    Args:
        drive: with its fixes and, for `truth`, its reference.
        chain: its way by its own sensors.
        start: `gnss`, `truth`, `identity` or a trajectory file with the first pose; None takes `gnss` where the drive
            has fixes, else `identity`.

    Raises:
        SemlocError: there are no fixes, no reference, or no pose at the start.
    """
    start = start or (GNSS if drive.gnss is not None else IDENTITY)
    if start == GNSS:
        if drive.gnss is None:
            raise SemlocError(f"drive {drive.name}: has no satellite fixes; give --start TRAJECTORY.tum, or identity")
        return Gauge(start, drive.gnss, None)
    T_odom_first = _planar(chain.Ts_odom_base[0])
    if start == IDENTITY:
        T_map_odom = rigid.inverse(T_odom_first)
    else:
        first = drive.truth_at(drive.frames[0]) if start == TRUTH else _first_pose(start, float(chain.times_s[0]))
        T_map_odom = _planar(first) @ rigid.inverse(T_odom_first)
    return Gauge(start, None, Start(T_map_odom @ chain.Ts_odom_base[0], np.diag(_START_SIGMA**2)))


def _planar(T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Position and heading of a pose, level: map and odometry have z up."""
    return rigid.planar_pose(float(T[0, 3]), float(T[1, 3]), float(np.arctan2(T[1, 0], T[0, 0])), float(T[2, 3]))


def _first_pose(name: str, time_s: float) -> Float[np.ndarray, "4 4"]:
    trajectory: Trajectory = read_trajectory(Path(name))
    gap_s = np.abs(trajectory.time_s - time_s)
    if gap_s.min() > _FARTHEST_S:
        raise SemlocError(
            f"--start {name}: its poses are {gap_s.min():.1f} s away from the first frame at {time_s:.3f} s; expected "
            f"one within {_FARTHEST_S} s on the clock of the drive"
        )
    return trajectory.T_map_base[int(gap_s.argmin())]
