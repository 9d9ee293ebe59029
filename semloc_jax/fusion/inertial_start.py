"""Gravity, velocity, biases and scale from the first seconds of a drive, moving or standing (room: fusion; host).

In: the first InertialMoments. Out: InertialStart: a solved window of all of them, or the reason why there is none.
One solve from a wrong speed stays there, so a vehicle that moves tries a grid of them. A first solve hardly tells which
of them is right, and lets go of landmarks that were right: the better half goes on with all landmarks, and half of
those again. The lowest cost wins, if no other speed explains the images and the inertial sensor as well. Wheels give
the speed at once.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.fusion.inertial_moment import InertialMoment, InertialWindowConfig, first_sigma
from semloc_jax.fusion.inertial_prior import first_prior
from semloc_jax.fusion.inertial_samples import Steps, rotation_between
from semloc_jax.fusion.inertial_states import AT, unknowns_of
from semloc_jax.fusion.inertial_window import InertialEstimate, InertialWindow
from semloc_jax.solvers.graph import Values
from semloc_jax.structs import InertialNoise

_NUM_SOLVES = 4
"""Each goes on from the one before, without the landmarks that did not fit."""


@dataclass(frozen=True)
class InertialStartConfig:
    """When a start is believed. All values are ours."""

    duration_s: float = 3.0
    """A shorter time does not tell speed from tilt."""
    tilt_sigma_deg: float = 5.0
    """Of the mean force as the vertical of a vehicle that moves."""
    standing_tilt_sigma_deg: float = 1.0
    gyro_bias_sigma_radps: float = 0.01
    accel_bias_sigma_mps2: float = 0.1
    scale_sigma: float = 0.03
    """Of the odometer."""
    slowest_mps: float = 1.0
    fastest_mps: float = 36.0
    speed_ratio: float = 1.25
    """Of neighbouring speeds of the grid."""
    rounds: tuple[int, ...] = (8, 4, 2)
    """Speeds that go on, each time with all landmarks again."""
    least_gap_nats: float = 4.0
    """The next other speed costs so much more."""
    other_speed: float = 0.08
    """Speeds that differ by this share are other ones."""
    most_speed_sigma: float = 0.1
    """Standard deviation of the speed, as a share of it, of a start that is believed."""
    least_landmarks: int = 20


class InertialStart(NamedTuple):
    """What the first seconds gave."""

    window: InertialWindow | None
    """All times of the start, solved; None where there is no start."""
    estimate: InertialEstimate | None
    reason: str
    """Why there is none; empty where there is one."""


def started(
    moments: list[InertialMoment],
    config: InertialWindowConfig,
    rules: InertialStartConfig,
    noise: InertialNoise | None = None,
) -> InertialStart:
    """A window of the first times, the frame at the first of them: z up, x ahead.

    Args:
        moments: At least as many as the window has states, the first without inertial steps.
        config: Beliefs of the window.
        rules: When a start is believed.
        noise: Of the inertial sensor; None: that of a production car.
    """
    standing = [moment.is_standing for moment in moments]
    is_standing = all(standing[: max(len(moments) // 4, 2)])
    wheels = all(moment.speed_mps is not None for moment in moments)
    if is_standing or wheels:
        speeds = np.array([moment.speed_mps or 0.0 for moment in moments])
        window = _window(moments, speeds, is_standing, config, rules, noise)
        return _judged(window, _finished(window), rules)
    guesses = [_window(moments, np.full(len(moments), speed), False, config, rules, noise) for speed in _speeds(rules)]
    num_seen = len(guesses[0].pool.chosen(config.num_landmarks, config.min_views))
    if num_seen < rules.least_landmarks:  # no solve finds more
        return InertialStart(None, None, _few_corners(num_seen, rules))
    tried = sorted((_Tried.of(window) for window in guesses), key=lambda one: one.nats)
    for num in rules.rounds:
        tried[:num] = [_Tried.of(_with_all_landmarks(one.window)) for one in tried[:num]]
        tried.sort(key=lambda one: one.nats)
    best = tried[0]
    return _judged(best.window, best.estimate, rules, _next_nats(tried, best, rules) - best.nats)


class _Tried(NamedTuple):
    """One speed of the grid, solved."""

    window: InertialWindow
    estimate: InertialEstimate
    nats: float
    """Cost, with that of the landmarks which were let go: a wrong speed must not win by what it does not explain."""

    @classmethod
    def of(cls, window: InertialWindow) -> "_Tried":
        estimate, rules = _finished(window), window.config
        each = 0.5 * rules.cauchy_sigmas**2 * np.log1p((rules.refuse_sigmas / rules.cauchy_sigmas) ** 2)
        return cls(window, estimate, estimate.cost + len(window.pool.refused) * float(each))

    @property
    def speed_mps(self) -> float:
        return float(np.linalg.norm(self.estimate.state.velocity_map))


def _speeds(rules: InertialStartConfig) -> Float[np.ndarray, " n"]:
    num = int(np.ceil(np.log(rules.fastest_mps / rules.slowest_mps) / np.log(rules.speed_ratio))) + 1
    return rules.slowest_mps * rules.speed_ratio ** np.arange(num)


def _with_all_landmarks(window: InertialWindow) -> InertialWindow:
    return InertialWindow.of(window.moments, window.values, window.prior, window.config, window.noise)


def _next_nats(tried: list[_Tried], best: _Tried, rules: InertialStartConfig) -> float:
    """Cost of the cheapest that ended at another speed than the best."""
    limit_mps = rules.other_speed * best.speed_mps
    others = [one.nats for one in tried if abs(one.speed_mps - best.speed_mps) > limit_mps]
    return min(others, default=np.inf)


def _judged(
    window: InertialWindow, estimate: InertialEstimate, rules: InertialStartConfig, gap: float = np.inf
) -> InertialStart:
    """The start, or why it is not believed."""
    speed = float(np.linalg.norm(estimate.state.velocity_map))
    sigma = float(np.sqrt(np.trace(estimate.covariance[AT["velocity"], AT["velocity"]])))
    if estimate.num_landmarks < rules.least_landmarks and not window.moments[-1].is_standing:
        reason = _few_corners(estimate.num_landmarks, rules)
    elif not gap >= rules.least_gap_nats:
        reason = (
            f"another speed than {speed:.1f} m/s explains images and inertial sensor as well (by {gap:.1f} nats); "
            "wait for a turn or a change of speed, or give wheels (--motion both)"
        )
    elif sigma > rules.most_speed_sigma * max(speed, 1.0):
        reason = (
            f"the speed is {speed:.1f} m/s with a standard deviation of {sigma:.1f} m/s: an even motion does not show "
            "the scale; wait for a turn or a change of speed, or give wheels (--motion both)"
        )
    else:
        return InertialStart(window, estimate, "")
    return InertialStart(None, None, reason)


def _few_corners(num: int, rules: InertialStartConfig) -> str:
    return (
        f"only {num} corners are followed over two images; expected {rules.least_landmarks}; are the images dark, or "
        "the mask too large?"
    )


def _finished(window: InertialWindow) -> InertialEstimate:
    """Solved to the end: what does not fit is let go between."""
    for _ in range(_NUM_SOLVES):
        estimate = window.solve()
    return estimate


def _window(
    moments: list[InertialMoment],
    speeds: np.ndarray,
    is_standing: bool,
    config: InertialWindowConfig,
    rules: InertialStartConfig,
    noise: InertialNoise | None,
) -> InertialWindow:
    """A window at a first guess: attitude by gyroscope and mean force, positions by speeds along the heading."""
    quiet = [m.steps for m in moments[1:] if m.steps is not None and m.is_standing] if is_standing else []
    bias = np.zeros(6)
    if quiet:
        step_s = np.concatenate([steps.step_s for steps in quiet])
        bias[:3] = np.average(np.concatenate([steps.gyro_radps for steps in quiet]), axis=0, weights=step_s)
    rotations = [np.eye(3)]
    for moment in moments[1:]:
        rotations.append(rotations[-1] @ rotation_between(moment.steps, bias[:3]))
    up = _mean_force([m.steps for m in moments[1:]], rotations, len(quiet) if quiet else None)
    R_map_first = _upright(up)
    Ts = np.tile(np.eye(4), (len(moments), 1, 1))
    Ts[:, :3, :3] = R_map_first @ np.stack(rotations)
    velocity = Ts[:, :3, 0] * speeds[:, None]
    dt = np.array([moment.steps.step_s.sum() for moment in moments[1:]])
    Ts[1:, :3, 3] = np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * dt[:, None], axis=0)
    num = len(moments)
    values: Values = {
        "pose": Ts,
        "height": np.zeros((num, 1)),
        "bend": np.zeros((num, 1)),
        "velocity": velocity,
        "bias": np.tile(bias, (num, 1)),
        "scale": np.ones((num, 1)),
        "mount": np.zeros((num, 3)),
        "delay": np.zeros((num, 1)),
    }
    tilt = np.deg2rad(rules.standing_tilt_sigma_deg if is_standing else rules.tilt_sigma_deg)
    of_bias = np.repeat([rules.gyro_bias_sigma_radps, rules.accel_bias_sigma_mps2], 3)
    pose = np.array([1e-4, 1e-4, 1e-4, tilt, tilt, 1e-5])
    sigma = first_sigma(config, pose, rules.fastest_mps, of_bias, rules.scale_sigma)
    prior = first_prior(values, sigma, Ts[0, :3, :3])
    # The first guess of a bias is data of this start: the belief is around zero.
    at = unknowns_of(np.zeros(1, int), num)[AT["bias"]]
    prior.gradient[at] = bias / of_bias**2
    return InertialWindow.of(moments, values, prior, config, noise)


def _mean_force(steps: list[Steps], rotations: list[np.ndarray], num: int | None) -> Float[np.ndarray, "3"]:
    """Mean specific force in the axes of the first base, of the first `num` intervals."""
    total = np.zeros(3)
    for one, R in zip(steps[:num], rotations[:num] if num else rotations, strict=False):
        total += R @ (one.accel_mps2 * one.step_s[:, None]).sum(axis=0)
    return total


def _upright(up_base: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """R_map_base with the vertical given in the base, and base x ahead in the map."""
    z = up_base / np.linalg.norm(up_base)
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])
