"""Corners to follow, spread over an image, and which of them move as the standing world does (room: perception; host).

In: a grey image, where nothing may be taken, corners that are followed already; lines of sight before and now, the
rotation between. Out: corners uv [n 2] [px]; bool of every point. The rotation comes from a gyroscope, so two points
give the direction of motion, and a few dozen pairs are enough to find one without outliers.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

_HALF = 2
"""Corners are looked for in the image of half size: four times cheaper, and small noise is gone."""
_BLOCK_PX = 3
_LEAST_SHARE = 0.003
"""A corner is at least so strong, as a share of a strong one (the 99th percentile of the buckets); our choice."""
_LEAST_STRENGTH = 2e-5
"""And so strong at all: a corner of noise of one grey level is weaker; our choice."""


def new_corners(
    grey: UInt8[np.ndarray, "h w"],
    usable: Bool[np.ndarray, "h w"] | None,
    taken_uv: Float[np.ndarray, "n 2"],
    num_wanted: int,
    bucket_px: int,
    border_px: int,
) -> Float[np.ndarray, "m 2"]:
    """At most `num_wanted` corners, the strongest of every bucket without a corner, strong buckets first.

    Args:
        grey: The image.
        usable: False where no corner may be; None for nowhere.
        taken_uv: Corners that are there already [px].
        num_wanted: Most of them.
        bucket_px: Side of a bucket.
        border_px: Distance from the border of the image.
    """
    if num_wanted <= 0:
        return np.zeros((0, 2))
    small = cv2.resize(grey, None, fx=1 / _HALF, fy=1 / _HALF, interpolation=cv2.INTER_AREA)
    strength = cv2.cornerMinEigenVal(small, _BLOCK_PX)
    free = _free(small.shape, usable, taken_uv, bucket_px, border_px)
    uv, best = _best_of_buckets(np.where(free, strength, 0.0), max(bucket_px // _HALF, 2))
    strong = best[best > 0.0]
    least = max(_LEAST_STRENGTH, _LEAST_SHARE * float(np.percentile(strong, 99))) if len(strong) else np.inf
    order = np.argsort(-best, kind="stable")
    order = order[best[order] >= least][:num_wanted]
    # The centre of a pixel of half size lies between four pixels.
    return _HALF * (_refined(strength, uv[order]) + 0.5) - 0.5


def _free(
    shape: tuple[int, int], usable: np.ndarray | None, taken_uv: np.ndarray, bucket_px: int, border_px: int
) -> Bool[np.ndarray, "h w"]:
    """Where a corner may be, in the image of half size."""
    free = np.ones(shape, np.uint8)
    if usable is not None:
        # A corner on the edge of a car moves with the car.
        near = cv2.erode(usable.astype(np.uint8), np.ones((7, 7), np.uint8), borderValue=1)
        free = cv2.resize(near, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST)
    for u, v in np.round((taken_uv + 0.5) / _HALF - 0.5).astype(int).tolist():
        cv2.circle(free, (u, v), max(bucket_px // (2 * _HALF), 1), 0, -1)
    edge = max(border_px // _HALF, 1)
    free[:edge], free[-edge:], free[:, :edge], free[:, -edge:] = 0, 0, 0, 0
    return free.astype(bool)


def _best_of_buckets(strength: np.ndarray, side: int) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Place and strength of the strongest pixel of every bucket."""
    height, width = strength.shape
    rows, columns = -(-height // side), -(-width // side)
    padded = np.zeros((rows * side, columns * side), strength.dtype)
    padded[:height, :width] = strength
    buckets = padded.reshape(rows, side, columns, side).swapaxes(1, 2).reshape(rows, columns, -1)
    place = buckets.argmax(axis=2)
    v = np.arange(rows)[:, None] * side + place // side
    u = np.arange(columns)[None, :] * side + place % side
    return np.stack([u, v], axis=-1).reshape(-1, 2).astype(float), buckets.max(axis=2).ravel()


def _refined(strength: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """The top of a parabola through the strengths beside each pixel."""
    if not len(uv):
        return uv
    u, v = uv.astype(int).T
    here = strength[v, u].astype(float)
    moved = []
    for before, after in ((strength[v, u - 1], strength[v, u + 1]), (strength[v - 1, u], strength[v + 1, u])):
        bend = before.astype(float) + after - 2.0 * here
        shift = 0.5 * (before.astype(float) - after) / np.where(np.abs(bend) < 1e-12, 1.0, bend)
        moved.append(np.where(np.abs(bend) < 1e-12, 0.0, np.clip(shift, -0.5, 0.5)))
    return uv + np.stack(moved, axis=1)


_NUM_PAIRS = 96
_LEAST_ANGLE_RAD = 0.02
_LEAST_POINTS = 8
"""Fewer points say nothing about each other."""


def moves_with_the_world(
    ray_before: Float[np.ndarray, "n 3"],
    ray_now: Float[np.ndarray, "n 3"],
    px_per_rad: Float[np.ndarray, " n"],
    R_now_before: Float[np.ndarray, "3 3"],
    gate_px: float,
    seed: int,
) -> Bool[np.ndarray, " n"]:
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
        return np.ones(num, bool)
    turned = ray_before @ R_now_before.T
    normal = np.cross(turned, ray_now)
    flow_px = np.linalg.norm(normal, axis=1) * px_per_rad
    moving = np.flatnonzero(flow_px > gate_px)
    if len(moving) < _LEAST_POINTS:
        # Nothing moves but by rotation: what does, is no part of the world.
        return flow_px <= 2.0 * gate_px if len(moving) < num // 2 else np.ones(num, bool)
    rng = np.random.default_rng(seed)
    first = rng.integers(len(moving), size=_NUM_PAIRS)
    second = (first + rng.integers(1, len(moving), size=_NUM_PAIRS)) % len(moving)
    crossed = np.cross(_unit(normal[moving[first]]), _unit(normal[moving[second]]))
    # Two planes that are nearly the same have no direction in common.
    crossed = crossed[np.linalg.norm(crossed, axis=1) > _LEAST_ANGLE_RAD]
    if not len(crossed):
        return np.ones(num, bool)
    is_inside = _distance_px(_unit(crossed), turned, normal, px_per_rad, flow_px) <= gate_px
    best = is_inside[np.argmax(is_inside.sum(axis=1))]
    # The direction across which all agreeing normals lie: the smallest singular vector, each point in pixels.
    used = best & (flow_px > gate_px)
    if used.sum() < 3:
        return best
    rows = normal[used] * px_per_rad[used, None]
    direction = np.linalg.svd(rows, full_matrices=False)[2][-1:]
    refined = (_distance_px(direction, turned, normal, px_per_rad, flow_px) <= gate_px)[0]
    return refined if refined.sum() >= best.sum() else best


def _distance_px(
    direction: np.ndarray, turned: np.ndarray, normal: np.ndarray, px_per_rad: np.ndarray, flow_px: np.ndarray
) -> Float[np.ndarray, "k n"]:
    """Distance of every point from the plane of its old line of sight and each direction."""
    lift = np.linalg.norm(np.cross(direction[:, None], turned[None]), axis=2)
    off = np.abs(direction @ normal.T) / np.maximum(lift, 1e-9) * px_per_rad
    # Near the direction itself the plane is not defined: there the flow is the distance.
    return np.minimum(off, flow_px)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12)
