"""How the road goes by under a camera, and where its corners will be seen next (room: perception; host).

In: corners of the road in two images, the plane under the vehicle. Out: how the camera moved; where corners are to be
looked for, how their patches are stretched there, the image before as it would be seen now.
Six metres ahead of a car the road moves by tens of pixels from image to image and grows by half: followed from where
it was, hardly a corner there is found again, and what is found are others. Corners of the road say themselves how fast
it goes by; the next image is compared with what they foretell.
"""

from typing import NamedTuple

import cv2
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, UInt8

from semloc_jax.cameras import Camera
from semloc_jax.perception.sight_lines import SightGrid, SightLines

_LEAST_LIFT_M = 0.3
"""A camera nearer to the origin of the base is given against an inertial sensor: nothing says where the road is."""
_LEAST_FALL = 0.04
"""Sine of the angle below the horizon of what is taken to lie in the plane: 30 m ahead of a car."""
_AGREE_PX = 3.0
"""Corners that tell the same motion differ by less."""
_LEAST_CORNERS = 8
"""So many, and at least half of all, have to tell the same."""
_LEAST_DEPTH_M = 0.5
_SIZES = 0.3, 3.0
"""How much a patch may shrink or grow from one image to the next."""


class RoadAhead(NamedTuple):
    """Corners of one image as they will be in the next."""

    uv: Float[np.ndarray, "s 2"]
    affine: Float[np.ndarray, "s 2 2"]
    """From the pixels around a corner to those around it then."""
    known: Bool[np.ndarray, " s"]
    """Whether it can be told."""
    in_view: Bool[np.ndarray, " s"]
    """Whether they will be before the camera, and no other size; others are left where they are."""


def moved_over_road(
    ray_before: Float[np.ndarray, "n 3"],
    now: SightLines,
    T_base_cam: Float[np.ndarray, "4 4"],
    R_now_before: Float[np.ndarray, "3 3"],
    direction: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "3"] | None:
    """How far a camera went from one image to the next, in its axes as they are now [m]; None where that is not clear.

    Args:
        ray_before: Lines of sight of corners on the road.
        now: Those of the same corners in the next image.
        T_base_cam: The camera over the plane z = 0 of the base.
        R_now_before: Rotation of the camera between.
        direction: Unit vector of its motion now, forwards or backwards.
    """
    points, is_low = _on_plane(ray_before, T_base_cam)
    on = np.flatnonzero(is_low)
    if len(on) < _LEAST_CORNERS:
        return None
    turned = points[on] @ R_now_before.T
    # Of (turned - way direction) nothing is seen beside the ray: the way of each corner, and pixels a metre of it.
    off, by_way = (now.pixels[on] @ turned[..., None])[..., 0], now.pixels[on] @ direction
    square = np.maximum((by_way**2).sum(axis=1), 1e-12)
    way_m = (off * by_way).sum(axis=1) / square
    depth_m = np.maximum((turned * now.ray_cam[on]).sum(axis=1), _LEAST_DEPTH_M)
    px_per_m = np.sqrt(square) / depth_m
    agree = np.abs(way_m[:, None] - way_m) * px_per_m < _AGREE_PX
    best = agree[np.argmax(agree.sum(axis=1))]
    if best.sum() < max(_LEAST_CORNERS, len(on) / 2):
        return None
    return float(np.average(way_m[best], weights=px_per_m[best] ** 2)) * direction


def road_ahead(
    camera: Camera,
    uv: Float[np.ndarray, "s 2"],
    sight: SightLines,
    T_base_cam: Float[np.ndarray, "4 4"],
    R_now_before: Float[np.ndarray, "3 3"],
    moved_m: Float[np.ndarray, "3"],
) -> RoadAhead:
    """Corners as they will be, were all of them on the road.

    Args:
        camera: Its model.
        uv: Corners.
        sight: Their lines of sight.
        T_base_cam: The camera over the plane z = 0 of the base.
        R_now_before: Rotation of the camera to the next image.
        moved_m: How it moves, in its axes then.
    """
    pixels = sight.pixels
    beside = np.swapaxes(pixels, 1, 2) @ np.linalg.inv(pixels @ np.swapaxes(pixels, 1, 2))
    rays = np.stack([sight.ray_cam, sight.ray_cam + beside[..., 0], sight.ray_cam + beside[..., 1]])
    points, is_low = _on_plane(rays.reshape(-1, 3), T_base_cam)
    at, seen = _projected(camera, points @ R_now_before.T - moved_m)
    here, right, below = at.reshape(3, -1, 2)
    affine = np.stack([right - here, below - here], axis=-1)
    size = np.sqrt(np.abs(np.linalg.det(affine)))
    known = is_low.reshape(3, -1).all(axis=0) & sight.valid
    in_view = known & seen.reshape(3, -1).all(axis=0) & (size > _SIZES[0]) & (size < _SIZES[1])
    affine = np.where(in_view[:, None, None], affine, np.eye(2)).astype(np.float32)
    return RoadAhead(np.where(in_view[:, None], here, uv), affine, known, in_view)


def road_as_seen_now(
    before: UInt8[np.ndarray, "h w"],
    grid: SightGrid,
    T_base_cam: Float[np.ndarray, "4 4"],
    R_now_before: Float[np.ndarray, "3 3"],
    moved_m: Float[np.ndarray, "3"],
    first_row: int = 0,
) -> UInt8[np.ndarray, "n w"]:
    """The image before as its camera would see it from where it is now, were all of it road; below a row of fields."""
    points, _ = _on_plane(grid.sight.ray_cam, T_base_cam)
    at, _ = _projected(grid.camera, (points + moved_m) @ R_now_before)
    fields = at.reshape(grid.rows, grid.columns, 2)[first_row:].astype(np.float32)
    height, width = before.shape[0] - first_row * grid.field_px, before.shape[1]
    size = grid.columns * grid.field_px, len(fields) * grid.field_px
    smooth = cv2.resize(fields, size, interpolation=cv2.INTER_LINEAR)[:height, :width]
    return cv2.remap(before, smooth, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _on_plane(
    ray_cam: Float[np.ndarray, "n 3"], T_base_cam: Float[np.ndarray, "4 4"]
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Where rays meet the road, in the camera, and which of them do; the others are as far away as any may be."""
    fall, lift_m = -(ray_cam @ T_base_cam[2, :3]), float(T_base_cam[2, 3])
    is_low = (fall > _LEAST_FALL) & (lift_m > _LEAST_LIFT_M)
    return ray_cam * (max(lift_m, _LEAST_LIFT_M) / np.maximum(fall, _LEAST_FALL))[:, None], is_low


def _projected(
    camera: Camera, points_cam: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    with jax.enable_x64(True):
        uv, seen = (np.array(part) for part in _project(camera, points_cam))
    return uv, seen & np.isfinite(uv).all(axis=1)


@jax.jit
def _project(camera: Camera, points_cam: Float[Array, "n 3"]) -> tuple[Array, Array]:
    # Operation by operation it takes as long as all else here.
    return tuple(camera.project(points_cam)[:2])
