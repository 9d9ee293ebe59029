"""Lines of sight of pixels, and how pixels grow beside them, for every camera model (room: perception; host).

In: a camera, pixels uv. Out: SightLines: unit rays in the camera frame, maps from a direction nearby to pixels; a
grid of them over an image.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.cameras import Camera
from semloc_jax.geometry import rigid

_STEP_PX = 0.25
_BLOCK = 64
"""Pixels are taken in so many at a time: otherwise a program would be compiled for each number of them."""
_FLAT = 1e-12
"""Where pixels span less of directions [rad^2] the model cannot be inverted."""


class SightLines(NamedTuple):
    """Rays of pixels.

    A direction q near a ray z is seen `pixels @ q / (z . q)` [px] beside the pixel, to first order: in the tangent
    plane of the ray, so that fisheyes work as pinhole cameras do.
    """

    ray_cam: Float[np.ndarray, "n 3"]
    pixels: Float[np.ndarray, "n 2 3"]
    valid: Bool[np.ndarray, " n"]

    def put(self, rows: Int[np.ndarray, " k"], others: "SightLines") -> "SightLines":
        """These with others in some rows."""
        parts = SightLines(*(part.copy() for part in self))
        for part, other in zip(parts, others, strict=True):
            part[rows] = other
        return parts


def sight_lines(camera: Camera, uv: Float[np.ndarray, "n 2"]) -> SightLines:
    """Rays of pixels, with derivatives by central differences of the back-projection, in float64.

    Args:
        camera: Any model.
        uv: Pixels; those that the camera cannot see have `valid` False and finite values.
    """
    padded = np.zeros((-(-max(len(uv), 1) // _BLOCK) * _BLOCK, 2))
    padded[: len(uv)] = uv
    with jax.enable_x64(True):
        found = _sight_lines(camera, padded)
    return SightLines(*(np.array(part)[: len(uv)] for part in found))


def no_sight_lines(num: int) -> SightLines:
    """So many that see nothing."""
    return SightLines(np.tile([0.0, 0.0, 1.0], (num, 1)), np.tile(np.eye(2, 3), (num, 1, 1)), np.zeros(num, bool))


@jax.jit
def _sight_lines(camera: Camera, uv: Float[Array, "n 2"]) -> tuple[Array, Array, Array]:
    # One program: operation by operation it took a third of the time of following corners.
    steps = _STEP_PX * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    rays, seen = camera.unproject((uv[None] + steps[:, None]).reshape(-1, 2))
    rays = rays.reshape(5, -1, 3)
    valid = seen.reshape(5, -1).all(axis=0) & jnp.isfinite(rays).all(axis=(0, 2))
    rays = jnp.where(valid[None, :, None], rays, jnp.array([0.0, 0.0, 1.0]))
    z = rays[0] / jnp.linalg.norm(rays[0], axis=1, keepdims=True)
    by_uv = jnp.stack([rays[1] - rays[2], rays[3] - rays[4]], axis=1) / (2 * _STEP_PX)
    by_uv = by_uv - jnp.sum(by_uv * z[:, None], axis=2, keepdims=True) * z[:, None]
    (uu, mixed), (_, vv) = jnp.moveaxis(by_uv @ by_uv.swapaxes(1, 2), 0, -1)
    area = uu * vv - mixed**2
    valid &= area > _FLAT**2
    adjugate = jnp.stack([jnp.stack([vv, -mixed], axis=-1), jnp.stack([-mixed, uu], axis=-1)], axis=1)
    pixels = adjugate @ by_uv / jnp.where(valid, area, 1.0)[:, None, None]
    return z, jnp.where(valid[:, None, None], pixels, jnp.eye(2, 3)), valid


class SightGrid(NamedTuple):
    """Lines of sight in the middles of square fields of an image, for what goes on smoothly over it."""

    camera: Camera
    field_px: int
    rows: int
    columns: int
    """The last row and column may reach over the border."""
    sight: SightLines
    """Row by row."""


def sight_grid(camera: Camera, field_px: int) -> SightGrid:
    """Fields of so many pixels on a side that cover an image."""
    width, height = (int(side) for side in camera.resolution)
    rows, columns = -(-height // field_px), -(-width // field_px)
    v, u = ((np.arange(n) + 0.5) * field_px - 0.5 for n in (rows, columns))
    middles = np.stack(np.meshgrid(u, v, indexing="xy"), axis=-1).reshape(-1, 2)
    return SightGrid(camera, field_px, rows, columns, sight_lines(camera, middles))


def tangents(ray: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2 3"]:
    """Two unit vectors across each unit ray and across each other."""
    # The axis that lies farthest from the ray keeps the product away from zero.
    axis = np.eye(3)[np.argmin(np.abs(ray), axis=1)]
    first = rigid.cross(axis, ray)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, rigid.cross(ray, first)], axis=1)
