"""Where a vehicle is if calibration or map is wrong, and how probable that is (room: alignment; host).

In: one frame solved with another lens or without one kind of elements. Out: FaultMode; the covariance with the faults
that the frame speaks for.
What is wrong hides in a pose: a longer lens is paid with a place farther on, posts that were set up anew take the pose
with them. The pose without the fault and the one with it may both be right, and their odds are those of Bayes: how
often such a thing is wrong, times how much better the frame fits with it, times the share of all it could have been.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

PLANE = (0, 1, 5)
"""Forward, left and heading among the coordinates of a tangent."""
_MOST_NATS = 60.0
"""More than this is certain."""
_FARTHEST = 2.0
"""Steps: a parabola through three lenses tells no more of others."""
_LEAST_BEND = 1e-3
"""Of the cost over lenses [nats for each squared step]: a frame may say nothing of them."""


@dataclass(frozen=True)
class FaultConfig:
    """How often something is wrong before a frame says more, and how far. All values are ours."""

    moved_share: float = 3e-3
    """Places around which all elements of one kind stand elsewhere than the map says."""
    held_share: ClassVar[float] = 0.7
    """Sigmas of more than this share of the prior's are the prior's own: a map that without one kind holds no pose
    says nothing of that kind, and no bound knows of it."""
    lens_share: float = 0.01
    """Calibrations whose focal lengths are off, and those whose distortion has the wrong sign."""
    lens_sigma: float = 0.02
    """By how much they are off then, as a share."""
    excluded_nats: ClassVar[float] = 3.0
    """A lens that the evidence of the masks makes so much less probable is none, whatever the cost of its pose."""
    mount_sigma_deg: float = 0.15
    """How far cameras may be turned in their mounts, in each direction: one frame cannot tell it from the heading."""


class FaultMode(NamedTuple):
    """The pose under one fault.

    Attributes:
        odds: of the fault against the sound pose.
        prior: the same before the frame.
        moved: where the vehicle is then: forward [m], left [m], heading [rad] from the pose that is told.
        covariance: of that.
        cause: in words.
    """

    odds: float
    prior: float
    moved: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    cause: str


def lens_mode(
    gain: tuple[float, float],
    moved: Float[np.ndarray, "2 3"],
    covariance: Float[np.ndarray, "3 3"],
    step: float,
    cause: str,
    config: FaultConfig,
) -> FaultMode:
    """What a lens that may be longer or shorter makes of the pose, marginalised over how much.

    Args:
        gain: By how much the frame fits better with a lens one step longer, and one step shorter [nats].
        moved: How far its pose moves then.
        covariance: Of the pose.
        step: The step, as a share of the focal length.
        cause: In words.
        config: How often lenses are wrong, and by how much.
    """
    longer, shorter = np.clip(np.nan_to_num(gain, nan=-_MOST_NATS), -_MOST_NATS, _MOST_NATS)
    slope, bend = 0.5 * (longer - shorter), max(-(longer + shorter), _LEAST_BEND)
    known = (step / config.lens_sigma) ** 2
    mean, variance = slope / (bend + known), 1.0 / (bend + known)
    odds = config.lens_share * np.sqrt(known * variance) * np.exp(min(0.5 * slope * mean, _MOST_NATS))
    way = 0.5 * np.nan_to_num(moved[0] - moved[1])
    off = float(np.clip(mean, -_FARTHEST, _FARTHEST)) * way
    return FaultMode(float(odds), config.lens_share, off, covariance + variance * np.outer(way, way), cause)


def sign_mode(
    gain: float, moved: Float[np.ndarray, "3"], covariance: Float[np.ndarray, "3 3"], cause: str, config: FaultConfig
) -> FaultMode:
    """What a lens with the other sign of distortion makes of the pose; arguments as `lens_mode`."""
    odds = config.lens_share * np.exp(np.clip(np.nan_to_num(gain, nan=-_MOST_NATS), -_MOST_NATS, _MOST_NATS))
    return FaultMode(float(odds), config.lens_share, np.nan_to_num(moved), covariance, cause)


def places_without(
    gain: Float[np.ndarray, " n"],
    moved: Float[np.ndarray, "n 3"],
    covariance: Float[np.ndarray, "n 3 3"],
    prior_sigma: Float[np.ndarray, "3"],
    step_m: float,
    cause: str,
    config: FaultConfig,
) -> list[FaultMode]:
    """The poses that the map has without one kind of its elements, which may stand anywhere along the road.

    Args:
        gain: By how much the rest of the map fits better at each place than at the pose that is told [nats].
        moved: The places, each solved from a start of its own; those that are no number say nothing.
        covariance: Of each.
        prior_sigma: That held the solves: forward, left [m], heading [rad].
        step_m: Way between the starts.
        cause: In words.
        config: How often elements are moved.
    """
    found, reach_m = [], step_m * len(gain)
    sigmas = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 1e-12))
    left = np.isfinite(gain) & np.isfinite(moved).all(axis=1) & (sigmas < config.held_share * prior_sigma).all(axis=1)
    for k in np.argsort(-np.where(left, gain, -np.inf)):
        if not left[k]:
            continue
        # Starts that end at one place are one.
        left &= (np.abs(moved - moved[k]) > 2.0 * sigmas[k]).any(axis=1) & (np.arange(len(gain)) != k)
        width_m = min(reach_m, np.sqrt(2.0 * np.pi) * sigmas[k, 0])
        odds = config.moved_share * width_m / reach_m * np.exp(min(gain[k], _MOST_NATS))
        found.append(FaultMode(float(odds), config.moved_share, moved[k], covariance[k], cause))
    return found


def probabilities(faults: Sequence[FaultMode]) -> Float[np.ndarray, " n"]:
    """Of each fault, one of them or none being there."""
    odds = np.array([fault.odds for fault in faults])
    return odds / (1.0 + odds.sum())


def joined(covariance: Float[np.ndarray, "3 3"], faults: Sequence[FaultMode]) -> Float[np.ndarray, "3 3"]:
    """The covariance about the pose that is told, with the faults that the frame makes more probable than they were.

    Args:
        covariance: Of the sound pose: forward [m], left [m], heading [rad].
        faults: What may be wrong.
    """
    shares = probabilities(faults)
    spoken_for = [(p, f) for p, f in zip(shares, faults, strict=True) if f.odds > f.prior]
    total = sum(p for p, _ in spoken_for)
    return (1.0 - total) * covariance + sum(p * (np.outer(f.moved, f.moved) + f.covariance) for p, f in spoken_for)
