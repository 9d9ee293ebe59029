"""Mounts, poses and odometer that fit what images show of the road (room: calibration; host).

In: Streaks, motion between frames, mounts to start from. Out: RoadFit, and what of it the drive could tell.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from semloc_jax.calibration.config import SelfCalibrationConfig
from semloc_jax.calibration.observability import AXES, REASONS, Observability, observe
from semloc_jax.calibration.road_graph import RoadEvidence, Spots, road_graph
from semloc_jax.calibration.road_lines import laid, match_lines
from semloc_jax.calibration.road_rows import Eye, end_rows, place_rows
from semloc_jax.calibration.road_streaks import Streak
from semloc_jax.calibration.self_calibration import mount_change
from semloc_jax.cameras import Rig
from semloc_jax.errors import SemlocError
from semloc_jax.fusion.prediction import MotionIncrement
from semloc_jax.geometry.rigid import planar_pose
from semloc_jax.solvers.dense import DenseEquations, marginal
from semloc_jax.solvers.front import solve
from semloc_jax.solvers.levenberg_marquardt import SolveConfig

_FEWEST_LINES = 4
_REASONS = REASONS | {
    "odometer_scale": "a smaller world in which the wheels turn slower looks the same: only the wheels and the "
    "measured heights and distances of the cameras tell the size",
    "gyro_bias": "the same lines must be seen again after longer: drive longer",
}
_SOLVE = SolveConfig(1e-3, 30, min_gain_nats=0.05)


@dataclass(frozen=True)
class RoadCalibrationConfig:
    """How mounts are found from the road. All values are ours.

    Args:
        gates_m: how far apart streaks of one line may lie, round by round: a degree at 4 m is 30 cm.
        num_polishes: times that pictures are laid onto each other at the end, where there are any.
        calibration: frames, priors and verdicts, as for a calibration by a map.
    """

    gates_m: tuple[float, ...] = (0.6, 0.3, 0.15, 0.15)
    num_polishes: int = 2
    calibration: SelfCalibrationConfig = field(default_factory=SelfCalibrationConfig)


@dataclass(frozen=True)
class RoadFit:
    """Mounts, poses and odometer as found so far.

    Attributes:
        T_base_cam: mounts.
        T_odom_base: poses of the frames.
        odometer: scale, gyroscope bias [rad/s], direction of travel [rad].
        equations: of the last solve, mounts first, then the odometer; None at the start.
        members: streaks of each line of the last solve.
        converged: whether the last solve ended by itself.
    """

    T_base_cam: Float[np.ndarray, "c 4 4"]
    T_odom_base: Float[np.ndarray, "n 4 4"]
    odometer: Float[np.ndarray, " 3"]
    equations: DenseEquations | None = None
    members: tuple[np.ndarray, ...] = ()
    converged: bool = False

    @property
    def T_odom_cam(self) -> Float[np.ndarray, "n c 4 4"]:
        """Every camera at every frame."""
        return self.T_odom_base[:, None] @ self.T_base_cam


def start_fit(rig: Rig, motion: Sequence[MotionIncrement]) -> RoadFit:
    """Mounts as they are said to be, poses by the wheels on a level road."""
    return RoadFit(np.asarray(rig.T_base_cam, np.float64), _chained(motion), np.array([1.0, 0.0, 0.0]))


def fit_to_lines(
    start: RoadFit,
    rig: Rig,
    motion: Sequence[MotionIncrement],
    streaks: Sequence[Streak],
    config: RoadCalibrationConfig | None = None,
) -> RoadFit:
    """Mounts, poses and odometer under which all sights of a painted line lie on one line, from wide gates to narrow.

    Args:
        start: mounts and poses to start from.
        rig: the cameras.
        motion: from each frame to the next.
        streaks: what they see.
        config: None for the defaults.

    Raises:
        SemlocError: too few lines that two images show.
    """
    config, fit = config or RoadCalibrationConfig(), start
    for gate_m in config.gates_m:
        fit = refitted(fit, start, rig, motion, streaks, gate_m, config.calibration)
    return fit


def _chained(motion: Sequence[MotionIncrement]) -> Float[np.ndarray, "n 4 4"]:
    """Poses of all frames on a level road, by the wheels."""
    T, poses = np.eye(4), [np.eye(4)]
    for step in motion:
        T = T @ step.T_from_to
        poses.append(planar_pose(T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])))
    return np.stack(poses)


def refitted(
    fit: RoadFit,
    start: RoadFit,
    rig: Rig,
    motion: Sequence[MotionIncrement],
    streaks: Sequence[Streak],
    gate_m: float,
    settings: SelfCalibrationConfig,
    spots: Spots | None = None,
) -> RoadFit:
    """Lines matched anew, and everything solved once more."""
    on_road = [laid(streak, fit.T_odom_cam[streak.frame, streak.camera]) for streak in streaks]
    lines = match_lines(streaks, on_road, gate_m) if len(streaks) > 1 else []
    if len(lines) < _FEWEST_LINES:
        raise SemlocError(
            f"calibration by the road: {len(lines)} painted lines that two images show, of {len(streaks)} seen; "
            f"expected at least {_FEWEST_LINES}; drive where slots or lanes are painted, or check masks and lenses"
        )
    eyes = [Eye(float(T[2, 3]), float(c.fx)) for c, T in zip(rig.cameras, fit.T_base_cam, strict=True)]
    places = place_rows(lines, streaks, on_road, eyes)
    ends, ends_m = end_rows(lines, streaks, on_road, eyes, gate_m)
    evidence = RoadEvidence(motion, start.T_base_cam, _sigma(settings), places, ends, ends_m, spots)
    with jax.enable_x64(True):
        graph, values = road_graph(evidence, fit.T_base_cam, fit.T_odom_base, fit.odometer, settings.priors)
        solution = solve(graph, values, _SOLVE)
        found = {name: np.asarray(value) for name, value in solution.value.items()}
        equations = jax.tree.map(np.asarray, solution.equations)
    members = tuple(line.streaks for line in lines)
    converged = bool(solution.converged)
    return RoadFit(found["mount"], found["pose"], found["odometer"][0], equations, members, converged)


def _sigma(settings: SelfCalibrationConfig) -> Float[np.ndarray, " 6"]:
    priors = settings.priors
    return np.array([priors.mount_m] * 3 + [np.deg2rad(priors.mount_deg)] * 3)


def observability(rig: Rig, fit: RoadFit, settings: SelfCalibrationConfig) -> Observability:
    """Sigmas and directions of mounts, along and about the axes of the vehicle, and of the odometer."""
    num = 6 * len(rig)
    kept = np.arange(num + 2)
    gone = np.arange(num + 2, len(fit.equations.gradient))
    with jax.enable_x64(True):
        information = np.asarray(marginal(jax.tree.map(jnp.asarray, fit.equations), gone, kept).information)
    prior = np.concatenate(
        [
            np.tile(_sigma(settings), len(rig)),
            [settings.priors.odometer_scale, np.deg2rad(settings.priors.gyro_bias_degps)],
        ]
    )
    turn, names, units, changes = np.eye(num + 2), [], [], []
    for c, name in enumerate(rig.names):
        R = fit.T_base_cam[c, :3, :3]
        turn[6 * c : 6 * c + 3, 6 * c : 6 * c + 3] = turn[6 * c + 3 : 6 * c + 6, 6 * c + 3 : 6 * c + 6] = R
        changes.append(mount_change(np.asarray(rig.T_base_cam[c], np.float64), fit.T_base_cam[c]))
        names += [f"{name} {axis}" for axis in AXES]
        units += ["m"] * 3 + ["deg"] * 3
    names += ["odometer_scale", "gyro_bias"]
    units += ["", "deg/s"]
    changes = np.concatenate([*changes, fit.odometer[:2] - [1.0, 0.0]])
    in_unit = np.where(["deg" in unit for unit in units], np.rad2deg(1.0), 1.0)
    free = np.flatnonzero(prior > 0)
    scaled = (prior[:, None] * (turn @ information @ turn.T) * prior)[np.ix_(free, free)]
    ratios = settings.observable_ratio, settings.held_ratio
    names, units = ([words[k] for k in free] for words in (names, units))
    return observe(scaled, names, units, (changes * in_unit)[free], (prior * in_unit)[free], *ratios, _REASONS)
