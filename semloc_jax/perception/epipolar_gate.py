"""Which points move as the standing world does when a camera turns and goes somewhere (room: perception; host).

In: lines of sight before and now, the rotation between. Out: bool of every point, the direction of the motion. The
rotation comes from a gyroscope, so two points give the direction, and a few dozen pairs are enough to find one without
outliers.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.geometry import rigid

_NUM_PAIRS = 96
_LEAST_ANGLE_RAD = 0.02
_LEAST_POINTS = 8
"""Fewer points say nothing about each other."""


class Agreeing(NamedTuple):
    """Points that agree on one motion."""

    kept: Bool[np.ndarray, " n"]
    direction: Float[np.ndarray, "3"] | None
    """In the camera as it is now, forwards or backwards; None where the points do not tell."""


def moves_with_the_world(
    ray_before: Float[np.ndarray, "n 3"],
    ray_now: Float[np.ndarray, "n 3"],
    px_per_rad: Float[np.ndarray, " n"],
    R_now_before: Float[np.ndarray, "3 3"],
    gate_px: float,
    seed: int,
) -> Agreeing:
    """Points within the gate of the epipolar plane of the direction that most points agree on.

    Args:
        ray_before: Unit lines of sight in the camera frame.
        ray_now: The same points, later.
        px_per_rad: Pixels a radian at each point.
        R_now_before: Rotation of the camera between.
        gate_px: Largest distance from the plane.
        seed: Of the pairs.
    """
    num = len(ray_before)
    if num < _LEAST_POINTS:
        return Agreeing(np.ones(num, bool), None)
    turned = ray_before @ R_now_before.T
    normal = rigid.cross(turned, ray_now)
    flow_px = np.linalg.norm(normal, axis=1) * px_per_rad
    moving = np.flatnonzero(flow_px > gate_px)
    if len(moving) < _LEAST_POINTS:
        # Nothing moves but by rotation: what does, is no part of the world.
        return Agreeing(flow_px <= 2.0 * gate_px if len(moving) < num // 2 else np.ones(num, bool), None)
    rng = np.random.default_rng(seed)
    first = rng.integers(len(moving), size=_NUM_PAIRS)
    second = (first + rng.integers(1, len(moving), size=_NUM_PAIRS)) % len(moving)
    crossed = rigid.cross(_unit(normal[moving[first]]), _unit(normal[moving[second]]))
    # Two planes that are nearly the same have no direction in common.
    crossed = crossed[np.linalg.norm(crossed, axis=1) > _LEAST_ANGLE_RAD]
    if not len(crossed):
        return Agreeing(np.ones(num, bool), None)
    is_inside = _distance_px(_unit(crossed), turned, normal, px_per_rad, flow_px) <= gate_px
    best = is_inside[np.argmax(is_inside.sum(axis=1))]
    # The direction across which all agreeing normals lie: the smallest singular vector, each point in pixels.
    used = best & (flow_px > gate_px)
    if used.sum() < 3:
        return Agreeing(best, None)
    rows = normal[used] * px_per_rad[used, None]
    direction = np.linalg.svd(rows, full_matrices=False)[2][-1:]
    refined = (_distance_px(direction, turned, normal, px_per_rad, flow_px) <= gate_px)[0]
    return Agreeing(refined if refined.sum() >= best.sum() else best, direction[0])


def _distance_px(
    direction: np.ndarray, turned: np.ndarray, normal: np.ndarray, px_per_rad: np.ndarray, flow_px: np.ndarray
) -> Float[np.ndarray, "k n"]:
    """Distance of every point from the plane of its old line of sight and each direction."""
    # Unit vectors: the sine by the cosine costs one product of matrices.
    lift = np.sqrt(np.maximum(1.0 - (direction @ turned.T) ** 2, 0.0))
    off = np.abs(direction @ normal.T) / np.maximum(lift, 1e-9) * px_per_rad
    # Near the direction itself the plane is not defined: there the flow is the distance.
    return np.minimum(off, flow_px)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12)
