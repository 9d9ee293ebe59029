"""How large the errors of measured poses are, and over what way they stay the same, told by the drive itself (room:
localization; host).

In: measured poses, the motion between them. Out: NoiseScale, the covariance that a measured pose enters a fusion with.
Measured poses are compared along the driven path: with the one before and with one some frames back. Errors that are
independent differ as much from frame to frame as over many frames (their variogram is flat); errors that stay the same
for a while differ less between neighbours. The first says how large errors are, the second over what way they hold.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.fusion.measurements import FusedPose, PoseMeasurement
from semloc_jax.fusion.prediction import MotionIncrement
from semloc_jax.geometry import rigid
from semloc_jax.residuals.noise import POSE_FREEDOM, POSE_SHARE

DIRECTIONS = [0, 1, 5]
"""Forward, left and heading in a tangent."""
LAG = 8
"""Frames between the poses from which the size of the errors is learned; our choice."""


@dataclass(frozen=True)
class NoiseConfig:
    """How the errors of measured poses are learned. All values are ours."""

    share: float = POSE_SHARE
    """Variance of a measured pose over that of the noise model, before the drive says more."""
    believed_frames: float = POSE_FREEDOM
    """What the noise model is worth, in frames."""
    memory_frames: float = 40.0
    min_factor: float = 0.15
    max_factor: float = 20.0
    most: float = 9.0
    """A squared normalised difference counts as no more than this: outliers are not noise."""
    correlation_m: float = 1.0
    """Way over which the errors of measured poses are the same where contours are near, before the drive says more."""
    min_correlation_m: float = 0.3
    max_correlation_m: float = 8.0
    min_way_m: float = 0.1
    """A vehicle that hardly moves in what it sees says nothing of a way."""
    near_m: float = 10.0
    """Where contours are farther away than this, see `contour_distance_m`, errors hold over a longer way: measured are
    0.9 m at 8 m, 3 m at 17 m, 10 to 25 m at 32 m."""
    standing_m: float = 0.03
    """Frames nearer to each other than this are as one."""
    scale_sigma: float = 0.004
    """Error that remains in a learned odometer scale."""
    gyro_bias_sigma_degps: float = 0.02


BELIEFS = NoiseConfig()
"""The default values; no drive needed others."""


class Passed(NamedTuple):
    """The last measured poses, newest last; those not there yet have the time -inf."""

    time_s: Float[np.ndarray, " n"]
    T_measured: Float[np.ndarray, "n 4 4"]
    variance: Float[np.ndarray, "n 3"]
    """Of the noise model: forward, left, heading."""
    T_fused: Float[np.ndarray, "n 4 4"]
    heading_variance: Float[np.ndarray, " n"]
    """Of the fused pose [rad^2]."""
    T_path: Float[np.ndarray, "n 4 4"]
    """Dead reckoning from anywhere."""
    path_variance: Float[np.ndarray, "n 3"]
    """Of dead reckoning, summed up: forward, left, heading."""


class NoiseScale(NamedTuple):
    """What the drive says of the errors of measured poses; sums that forget."""

    near: Float[np.ndarray, "3"]
    """Squared differences of neighbouring poses over what was expected: forward, left, heading."""
    far: Float[np.ndarray, "3"]
    """The same of poses some frames apart."""
    num_frames: Float[np.ndarray, ""]
    way_m: Float[np.ndarray, ""]
    """Way between neighbours."""
    passed: Passed


def unknown_noise() -> NoiseScale:
    """What is known before driving."""
    zero, poses = np.float64(0.0), np.tile(np.eye(4), (LAG, 1, 1))
    return NoiseScale(
        np.zeros(3), np.zeros(3), zero, zero,
        Passed(
            np.full(LAG, -np.inf), poses, np.ones((LAG, 3)), poses.copy(), np.zeros(LAG), poses.copy(),
            np.zeros((LAG, 3)),
        ),
    )  # fmt: skip


def without_poses(noise: NoiseScale) -> NoiseScale:
    """The same where the vehicle was found anew: the poses before belong to another path."""
    return noise._replace(passed=noise.passed._replace(time_s=np.full(LAG, -np.inf)))


def factors(noise: NoiseScale, config: NoiseConfig) -> Float[np.ndarray, "3"]:
    """Factors on the variance of the noise model, forward, left and heading: 1 before the drive says more."""
    found = (noise.far + config.believed_frames) / (noise.num_frames + config.believed_frames)
    return np.clip(found, config.min_factor, config.max_factor)


def correlation_m(noise: NoiseScale, config: NoiseConfig) -> Float[np.ndarray, "3"]:
    """Way over which the errors forward, left and of heading are the same [m]."""
    if noise.num_frames == 0.0:
        return np.full(3, config.correlation_m)
    step_m = float(noise.way_m / noise.num_frames)
    believed = config.believed_frames
    differing = 1.0 - np.exp(-step_m / config.correlation_m)
    # Neighbours with correlation rho differ by 1 - rho of what independent poses differ by.
    rho = 1.0 - (noise.near + believed * differing) / (noise.far + believed)
    length_m = -step_m / np.log(np.clip(rho, 1e-3, 0.999))
    return np.clip(length_m, config.min_correlation_m, config.max_correlation_m)


def freedom(noise: NoiseScale, config: NoiseConfig) -> Float[np.ndarray, "3"]:
    """Degrees of freedom that `factors` stand on, forward, left and heading: what the noise model is worth, and the
    frames since. Squares of errors with correlation rho between neighbours are worth (1 - rho^2) / (1 + rho^2) of
    independent ones."""
    if noise.num_frames == 0.0:
        return np.full(3, config.believed_frames)
    rho = np.exp(-float(noise.way_m / noise.num_frames) / correlation_m(noise, config))
    return config.believed_frames + float(noise.num_frames) * (1.0 - rho**2) / (1.0 + rho**2)


def of_one_pose(
    covariance: Float[np.ndarray, "6 6"], noise: NoiseScale, config: NoiseConfig
) -> Float[np.ndarray, "6 6"]:
    """Covariance of one measured pose alone.

    Args:
        covariance: As the noise model has it.
        noise: What the drive says.
        config: Beliefs.
    """
    return config.share * _scaled(covariance, factors(noise, config))


def of_a_series(
    covariance: Float[np.ndarray, "6 6"], way_m: float, noise: NoiseScale, config: NoiseConfig
) -> Float[np.ndarray, "6 6"]:
    """Covariance by which a filter may take a measured pose for independent of the one `way_m` before.

    The mean of many errors with correlation exp(-way / length) between neighbours has (1 + rho) / (1 - rho) times the
    variance that independent ones would have. A vehicle that stands learns next to nothing, and one that looks at
    contours far ahead little.

    Args:
        covariance: Of the measured pose alone, see `of_one_pose`.
        way_m: Way since the pose before [m].
        noise: What the drive says.
        config: Beliefs.
    """
    seen_m = max(way_in_view_m(covariance, way_m, config), config.standing_m)
    rho = np.exp(-seen_m / correlation_m(noise, config))
    return _scaled(covariance, (1.0 + rho) / (1.0 - rho))


def contour_distance_m(covariance: Float[np.ndarray, "6 6"]) -> float:
    """How far ahead the contours are that hold a measured pose [m]: where its errors across and in heading cancel."""
    return max(-float(covariance[1, 5] / covariance[5, 5]), 0.0)


def way_in_view_m(covariance: Float[np.ndarray, "6 6"], way_m: float, config: NoiseConfig) -> float:
    """The way that moves contours as far through the image as `way_m` does where they are near.

    A point of the road moves by the square of its distance less, and as long as a contour stays where it is in the
    image, so do the errors of its mask.
    """
    distance_m = max(contour_distance_m(covariance), config.near_m)
    return way_m * (config.near_m / distance_m) ** 2


def _scaled(covariance: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """A covariance whose variances forward, left and of heading are multiplied; the others by the mean factor."""
    sigma = np.full(6, np.sqrt(np.mean(factor)))
    sigma[DIRECTIONS] = np.sqrt(factor)
    return covariance * np.outer(sigma, sigma)


def learned(
    noise: NoiseScale,
    measurement: PoseMeasurement,
    fused: FusedPose,
    step: MotionIncrement,
    way_m: float,
    config: NoiseConfig,
) -> NoiseScale:
    """What is known after one more frame whose pose was taken.

    Args:
        noise: Before.
        measurement: The pose, with the covariance that the noise model gives it.
        fused: The pose of the fusion after it.
        step: Motion since the last pose that was taken.
        way_m: Way since the frame before [m].
        config: Beliefs.
    """
    passed, way_m = noise.passed, way_in_view_m(measurement.covariance, way_m, config)
    newest = Passed(
        np.float64(measurement.time_s),
        measurement.T_map_base,
        config.share * np.diagonal(measurement.covariance)[DIRECTIONS],
        fused.T_map_base,
        fused.covariance[5, 5],
        rigid.normalised(passed.T_path[-1] @ step.T_from_to),
        passed.path_variance[-1] + np.diagonal(step.covariance)[DIRECTIONS],
    )
    there = np.flatnonzero(np.isfinite(passed.time_s))
    if len(there) and way_m >= config.min_way_m:
        oldest, last = (Passed(*(column[k] for column in passed)) for k in (there[0], -1))
        keep = np.exp(-1.0 / config.memory_frames)
        noise = noise._replace(
            near=keep * noise.near + _squares(last, newest, config),
            far=keep * noise.far + _squares(oldest, newest, config),
            num_frames=keep * noise.num_frames + 1.0,
            way_m=keep * noise.way_m + way_m,
        )
    rows = [np.append(old[1:], [new], axis=0) for old, new in zip(passed, newest, strict=True)]
    return noise._replace(passed=Passed(*rows))


def last_taken_s(noise: NoiseScale) -> float:
    """Time of the last pose that was taken [s]; -inf where there is none."""
    return float(noise.passed.time_s[-1])


def _squares(then: Passed, now: Passed, config: NoiseConfig) -> np.ndarray:
    """Squared differences of the errors of two measured poses, over what the noise model and the path between expect.

    Both are seen from one path: that of the motion, laid through the fused pose at the earlier one.
    """
    step = rigid.inverse(then.T_path) @ now.T_path
    late = rigid.log(rigid.inverse(then.T_fused @ step) @ now.T_measured)
    early = rigid.log(rigid.inverse(then.T_fused) @ then.T_measured)
    way_m, turned = step[0, 3], np.deg2rad(config.gyro_bias_sigma_degps) * (now.time_s - then.time_s)
    spread = now.path_variance - then.path_variance
    # The path is as wrong to the side as its heading is.
    across = way_m**2 * (then.heading_variance + spread[2] / 3.0 + turned**2 / 4.0)
    spread = spread + np.array([(config.scale_sigma * way_m) ** 2, across, turned**2])
    square = (late - early)[DIRECTIONS] ** 2 / (now.variance + then.variance + spread)
    return np.minimum(square, config.most)
