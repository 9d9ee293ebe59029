"""Which pixel of which camera shows each place of a view of the surroundings (room: perception; host).

In: cameras, their mounts, places, the own car. Out: lookup tables, how finely a camera shows each place, how much it
counts there.
"""

from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from scipy.special import ndtr

from semloc_jax.cameras import Camera, Rig

Car = tuple[float, float, float, float]
"""Rear, front, right and left end of a car in the base frame [m]."""
_RIM_M = 0.05
"""The body of a car is rounded: a camera at its rim looks past the outermost part."""


def own_car(rig: Rig) -> Car | None:
    """Rear, front, right and left end [m] of the car that carries the cameras; None where they do not surround it.

    Cameras of a surround view sit at the rim of the body: grille, tailgate, mirrors.
    """
    low, high = (edge(np.asarray(rig.T_base_cam)[:, :2, 3], axis=0) for edge in (np.min, np.max))
    if len(rig) < 3 or (high - low).min() < 1.0:
        return None
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def camera_table(
    camera: Camera,
    T_base_cam: np.ndarray,
    p_base: np.ndarray,
    own_car_m: Car | None = None,
    own_body: np.ndarray | None = None,
    least_detail: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Where a camera shows the places of a view.

    Args:
        camera: of the picture.
        T_base_cam: its pose in the base frame, float64[4 4].
        p_base: the place that each pixel of the view shows [m], float64[h w 3]; NaN for none.
        own_car_m: rear, front, right and left end of the own car [m], which is left blank and hides what is behind it.
        own_body: bool[h w], True where the picture shows the own car.
        least_detail: pixels of the picture that a pixel of the view needs in its worst direction to be shown.

    Returns:
        Pixels of the picture float32[h w 2], -1e4 where it does not show the place; pixels of the picture in a pixel of
        the view in the worst direction, float64[h w], 0 where it does not show the place.
    """
    is_place = np.isfinite(p_base).all(axis=-1)
    p_base = np.where(is_place[..., None], p_base, 0.0)
    uv, valid = (np.array(part) for part in camera.project((p_base - T_base_cam[:3, 3]) @ T_base_cam[:3, :3]))
    detail = _finest_detail(uv)
    seen = is_place & valid & np.asarray(camera.in_image(uv[..., 0], uv[..., 1])) & (detail > least_detail)
    if own_car_m is not None:
        seen &= ~_inside(p_base, own_car_m) & ~_behind_car(T_base_cam[:2, 3], p_base, own_car_m)
    if own_body is not None:
        seen &= ~_at(own_body, uv, seen)
    uv[~seen] = -1e4
    return uv.astype(np.float32), np.where(seen, detail, 0.0)


def _inside(p_base: np.ndarray, car_m: Car) -> np.ndarray:
    rear, front, right, left = car_m
    x, y = p_base[..., 0], p_base[..., 1]
    return (x > rear) & (x < front) & (y > right) & (y < left)


def _behind_car(camera_xy: np.ndarray, p_base: np.ndarray, car_m: Car) -> np.ndarray:
    """Whether the own car stands between a camera and a place: a camera at the rear sees nothing ahead of it."""
    rear, front, right, left = car_m
    enters, leaves = np.zeros(p_base.shape[:2]), np.ones(p_base.shape[:2])
    for axis, (low, high) in enumerate(((rear, front), (right, left))):
        step = p_base[..., axis] - camera_xy[axis]
        step = np.where(np.abs(step) < 1e-9, 1e-9, step)
        ends = [(edge - camera_xy[axis]) / step for edge in (low + _RIM_M, high - _RIM_M)]
        enters, leaves = np.maximum(enters, np.minimum(*ends)), np.minimum(leaves, np.maximum(*ends))
    return enters < leaves


def _at(body: np.ndarray, uv: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Whether the picture shows the own car where a pixel of the top view lies, or right beside it."""
    grown = cv2.dilate(body.astype(np.uint8), np.ones((5, 5), np.uint8))
    place = np.where(seen[..., None], uv, -10.0).astype(np.float32)
    return cv2.remap(grown, place, None, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0) > 0


def _finest_detail(uv: np.ndarray) -> np.ndarray:
    """Smaller singular value of the map from top-view pixels to image pixels: image pixels in the worst direction."""
    du, dv = np.gradient(uv, axis=1), np.gradient(uv, axis=0)
    square = np.sum(du * du + dv * dv, axis=-1)
    area = np.abs(du[..., 0] * dv[..., 1] - du[..., 1] * dv[..., 0])
    return np.sqrt(np.maximum(square - np.sqrt(np.maximum(square**2 - 4.0 * area**2, 0.0)), 0.0) / 2.0)


Blend = Literal["gaussian", "linear", "hard"]
"""How pictures meet at a seam: normal distribution over the signed distance to it, a ramp, or a cut."""

SEAM_SIGMA_M = 0.25
"""Standard deviation of the gaussian blend on the road; the ramp of the linear one is as steep in the middle."""


def seam_weights(
    seen: Bool[np.ndarray, "n h w"], best: Int[np.ndarray, "h w"], blend: Blend, sigma_px: float
) -> Float[np.ndarray, "n h w"]:
    """Weight of each camera, 0 where it sees nothing; they sum to one where any camera sees the road.

    The seam is where the best camera changes. Where a camera's own view ends inside that of another one, its weight
    falls to zero over two sigmas, so that this border does not show either.

    Args:
        seen: whether a camera sees a pixel.
        best: the camera that sees it best.
        blend: how pictures meet.
        sigma_px: standard deviation of the gaussian blend [px].
    """
    weights = np.zeros(seen.shape, np.float32)
    for camera, own in enumerate(seen):
        inside = own & (best == camera)
        if blend == "hard" or not inside.any():
            weights[camera] = inside
            continue
        signed = _distance(inside) - _distance(~inside)
        if blend == "gaussian":
            weight = ndtr(signed / sigma_px)
        else:
            weight = np.clip(0.5 + signed / (np.sqrt(2.0 * np.pi) * sigma_px), 0.0, 1.0)
        weights[camera] = weight * np.clip(_distance(own) / (2.0 * sigma_px), 0.0, 1.0)
    total = weights.sum(axis=0)
    # Far from its own seam a lone camera may have next to no weight: it still shows the pixel alone.
    lone = (total < 1e-6) & seen.any(axis=0)
    for camera in range(len(weights)):
        weights[camera][lone & (best == camera)] = 1.0
    return weights / np.maximum(np.where(lone, 1.0, total), 1e-6)


def strongest_two(weights: Float[np.ndarray, "n h w"]) -> tuple[Shaped[np.ndarray, "2 h w"], Float[np.ndarray, "h w"]]:
    """The two cameras that count most at each pixel, and the share of the second one, 0 ... 0.5.

    A third camera counts nowhere near a car: its weight goes to these two.
    """
    if len(weights) == 1:
        return np.zeros((2, *weights.shape[1:]), np.intp), np.zeros(weights.shape[1:], np.float32)
    pair = np.argsort(-weights, axis=0, kind="stable")[:2]
    first, second = np.take_along_axis(weights, pair, axis=0)
    return pair, (second / np.maximum(first + second, 1e-6)).astype(np.float32)


def _distance(inside: np.ndarray) -> np.ndarray:
    """Distance to the nearest pixel outside [px], measured to the border between the two."""
    if inside.all():
        return np.full(inside.shape, 1e6)
    return np.maximum(cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE) - 0.5, 0.0)
