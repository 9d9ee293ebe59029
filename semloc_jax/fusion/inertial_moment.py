"""What sensors say of one image time, and what is believed of them (room: fusion; host).

In: InertialMoments of a window. Out: its StateFactors, without the inertial steps put together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.fusion.inertial_graph import SLOW, StateFactors
from semloc_jax.fusion.inertial_samples import Steps
from semloc_jax.fusion.inertial_states import SIZES
from semloc_jax.fusion.landmark_pool import RoadBeliefs
from semloc_jax.perception.tracks import Tracks
from semloc_jax.residuals.preintegration import Preintegrated
from semloc_jax.structs import InertialNoise

_LEAST_SIGMA = 1e-6
"""Of what is believed to be known: the window holds it."""
_LEAST_WAY_M = 1e-3


@dataclass(frozen=True)
class InertialWindowConfig:
    """Beliefs about sensors and vehicle, and how the window is kept. All values are ours, of a production car."""

    num_states: int = 12
    num_landmarks: int = 256
    """Landmarks of one solve, those with most views."""
    min_views: int = 2
    """A corner of the road near a vehicle is seen no more often; what its two views say with the plane is its speed."""
    sigma_px: float = 0.1
    """Of a corner where it is found: whatever it is, this is what is followed."""
    step_px: float = 0.4
    """Of what a corner slips from one image to the next, before the window has seen how much it is."""
    step_memory: int = 10
    """Images over which that is measured."""
    step_limits_px: tuple[float, float] = (0.1, 1.5)
    cauchy_sigmas: float = 2.0
    refuse_sigmas: float = 5.0
    """A landmark that is farther off in some view is let go."""
    side_sigma_mps: float = 0.05
    """Velocity of the rear axle to the side; 0: not a vehicle on wheels."""
    up_sigma_mps: float = 0.3
    """Velocity of the rear axle up and down, by suspension and load."""
    speed_sigma_mps: float = 0.05
    """Of a wheel speed besides its scale."""
    scale_walk: float = 1e-4
    """Change of the odometer scale [per root of s]."""
    road: RoadBeliefs = field(default_factory=RoadBeliefs)
    height_sigma_m: float = 0.01
    """Of the height of the cameras over the road: tyres, load, calibration."""
    height_walk: float = 1e-3
    """Change of that height [m per root of s]."""
    mount_sigma_deg: float = 0.0
    """Of the axes of the inertial sensor against those of the vehicle; 0: they are as calibrated."""
    mount_walk: float = 2e-5
    """Change of that turn [rad per root of s]."""
    delay_sigma_s: float = 0.0
    """Of the clock of the inertial sensor less that of the cameras; 0: they are one."""
    delay_walk: float = 2e-5
    """Change of that difference [s per root of s]."""
    max_steps: int = 8
    least_step_sigmas: float = 0.3
    """A solve ends when a step moves the states by less, all together: the next images move them by more."""


class InertialMoment(NamedTuple):
    """What sensors say of one image time."""

    time_s: float
    tracks: Tracks
    T_base_cam: Float[np.ndarray, "c 4 4"]
    steps: Steps | None
    """Inertial steps since the time before; None for the first."""
    speed_mps: float | None = None
    """Of the wheels."""
    is_standing: bool = False
    delay_s: float = 0.0
    """How far the clock of the inertial sensor was taken to be ahead when `steps` were read from its log."""
    T_measured: Float[np.ndarray, "4 4"] | None = None
    """Pose in a map by an alignment, its own prior taken out."""
    information: Float[np.ndarray, "6 6"] | None = None
    """Of that pose in its right tangent; undetermined directions are zero."""


def first_sigma(
    config: InertialWindowConfig,
    pose: Float[np.ndarray, "6"],
    velocity_mps: float,
    bias: Float[np.ndarray, "6"],
    scale: float,
) -> Float[np.ndarray, "22"]:
    """Standard deviations of a first state, in the order of `inertial_states`.

    Args:
        config: Of height, mount and clock.
        pose: Of position [m] and rotation about the axes of the map [rad].
        velocity_mps: Of each part of the velocity.
        bias: Of gyroscope [rad/s] and accelerometer [m/s^2].
        scale: Of the odometer.
    """
    mount, delay_s = np.deg2rad(config.mount_sigma_deg), config.delay_sigma_s
    own = [config.height_sigma_m], [config.road.bend_per_m], [velocity_mps] * 3, bias, [scale], [mount] * 3, [delay_s]
    return np.maximum(np.concatenate([pose, *own]), _LEAST_SIGMA)


def state_factors(
    moments: Sequence[InertialMoment],
    config: InertialWindowConfig,
    way_m: Float[np.ndarray, " e"],
    noise: InertialNoise,
    intervals: tuple[Preintegrated, Float[np.ndarray, "e 9 9"]],
) -> StateFactors:
    """What the moments say of their states beside the landmarks.

    Args:
        moments: Of all states.
        config: Beliefs.
        way_m: From each state to the next.
        noise: Of the inertial sensor.
        intervals: Its steps from each state to the next, put together, and the roots of their information.
    """
    num = len(moments)
    step_s = np.array([moment.steps.step_s.sum() for moment in moments[1:]])
    has_speed = np.array([moment.speed_mps is not None for moment in moments])
    standing = np.array([moment.is_standing for moment in moments])
    sides = np.array([config.side_sigma_mps, config.up_sigma_mps])
    rolling = np.tile(1.0 / sides if config.side_sigma_mps > 0 else np.zeros(2), (num, 1))
    # However slowly a vehicle goes on, the road under it is another one then.
    kept = np.exp(-np.maximum(way_m, _LEAST_WAY_M) / config.road.bend_length_m)
    changes = _changes(config, noise) * np.sqrt(step_s)[:, None]
    share, bend = np.ones_like(changes), sum(SIZES[name] for name in SLOW[: SLOW.index("bend")])
    share[:, bend] = kept
    changes[:, bend] = max(config.road.bend_per_m, _LEAST_SIGMA) * np.sqrt(1.0 - kept**2)
    both = standing[1:] & standing[:-1]
    still = np.diag(1.0 / np.array([1e-3, 1e-3, 1e-3, 1e-4, 1e-4, 1e-4]))
    return StateFactors(
        steps=intervals[0],
        inertial=intervals[1],
        delay_s=np.array([moment.delay_s for moment in moments[1:]]),
        kept=share,
        walk=1.0 / changes,
        rolling=rolling,
        speed_mps=np.array([moment.speed_mps or 0.0 for moment in moments]),
        wheels=np.where(has_speed, 1.0 / config.speed_sigma_mps, 0.0)[:, None],
        standing=np.where(standing[:, None], np.full(3, 1.0 / 0.005), 0.0),
        still=np.where(both[:, None, None], still, 0.0),
        T_measured=np.stack([np.eye(4) if m.T_measured is None else m.T_measured for m in moments]),
        measured=np.stack([_root(m.information) for m in moments]),
    )


def _changes(config: InertialWindowConfig, noise: InertialNoise) -> Float[np.ndarray, " k"]:
    """Of what changes slowly, in the order of `SLOW`: standard deviation of its walk in a second."""
    walk = {
        "height": [config.height_walk],
        "bend": [1.0],  # it fades with the way, not with time
        "bias": noise.bias_walk,
        "scale": [config.scale_walk],
        "mount": [config.mount_walk] * 3,
        "delay": [config.delay_walk],
    }
    return np.concatenate([walk[name] for name in SLOW])


def _root(information: np.ndarray | None) -> np.ndarray:
    """Rows R with R^T R = information, which may leave directions free."""
    if information is None:
        return np.zeros((6, 6))
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    return np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
