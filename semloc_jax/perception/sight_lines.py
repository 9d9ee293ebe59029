"""Lines of sight of pixels, and how pixels grow beside them, for every camera model (room: perception; host).

In: a camera, pixels uv. Out: SightLines: unit rays in the camera frame, maps from a direction nearby to pixels.
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.cameras import Camera

_STEP_PX = 0.25


class SightLines(NamedTuple):
    """Rays of pixels.

    A direction q near a ray z is seen `pixels @ q / (z . q)` [px] beside the pixel, to first order: in the tangent
    plane of the ray, so that fisheyes work as pinhole cameras do.
    """

    ray_cam: Float[np.ndarray, "n 3"]
    pixels: Float[np.ndarray, "n 2 3"]
    valid: Bool[np.ndarray, " n"]


def sight_lines(camera: Camera, uv: Float[np.ndarray, "n 2"]) -> SightLines:
    """Rays of pixels, with derivatives by central differences of the back-projection, in float64.

    Args:
        camera: Any model.
        uv: Pixels; those that the camera cannot see have `valid` False and finite values.
    """
    steps = _STEP_PX * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    with jax.enable_x64(True):
        rays, seen = camera.unproject((uv[None] + steps[:, None]).reshape(-1, 2).astype(np.float64))
    rays = np.asarray(rays, np.float64).reshape(5, -1, 3)
    valid = np.asarray(seen).reshape(5, -1).all(axis=0) & np.isfinite(rays).all(axis=(0, 2))
    rays = np.where(valid[None, :, None], rays, [0.0, 0.0, 1.0])
    z = rays[0] / np.linalg.norm(rays[0], axis=1, keepdims=True)
    by_uv = np.stack([rays[1] - rays[2], rays[3] - rays[4]], axis=-1) / (2 * _STEP_PX)
    across = tangents(z)
    slope = across @ by_uv
    slope[~valid] = np.eye(2)
    flat = np.abs(np.linalg.det(slope)) < 1e-12
    slope[flat] = np.eye(2)
    return SightLines(z, np.linalg.solve(slope, across), valid & ~flat)


def tangents(ray: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2 3"]:
    """Two unit vectors across each unit ray and across each other."""
    # The axis that lies farthest from the ray keeps the product away from zero.
    axis = np.eye(3)[np.argmin(np.abs(ray), axis=1)]
    first = np.cross(axis, ray)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(ray, first)], axis=1)
