"""Where a camera sees points, and how far they move in the image (room: residuals; pure JAX).

In: points in a camera frame. Out: Projected: pixels, validity, derivative of the pixel by the point.
No derivatives of its own: it serves what is decided about samples before a pose is solved.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from semloc_jax.cameras import Camera
from semloc_jax.residuals import native_kernels
from semloc_jax.residuals.robust import LOSSES


class Projected(NamedTuple):
    """Points as one camera sees them."""

    u: Float[Array, " p"]
    v: Float[Array, " p"]
    valid: Bool[Array, " p"]
    """Whether the camera can see in that direction; the image is not looked at."""
    du: Float[Array, "3 p"]
    """Derivative of u by the point in the camera frame [px / m]."""
    dv: Float[Array, "3 p"]

    def moved_px(self, direction_cam: Float[Array, "*p 3"]) -> tuple[Float[Array, " p"], Float[Array, " p"]]:
        """Pixels that each point moves in u and v for one metre along a direction of the camera frame."""
        x, y, z = direction_cam[..., 0], direction_cam[..., 1], direction_cam[..., 2]
        return tuple(slope[0] * x + slope[1] * y + slope[2] * z for slope in (self.du, self.dv))


def projected(camera: Camera, p_cam: Float[Array, "3 p"], path: native_kernels.Path = "auto") -> Projected:
    """Points as a camera sees them; `path` as for `residuals.normal_equations`.

    XLA computes the lens again for each of the numbers that use it, and compiles it as often; a kernel does it once.
    """
    if native_kernels.use(path, camera, LOSSES["tukey"], p_cam.dtype) == "analytic":
        rows = native_kernels.project(camera, p_cam)
        return Projected(rows[0], rows[1], rows[2] > 0, rows[3:6], rows[6:9])
    (u, v, valid), push = jax.linearize(camera.project_xyz, *p_cam)
    axes = [push(*(jnp.full_like(u, k == axis) for k in range(3)))[:2] for axis in range(3)]
    du, dv = (jnp.stack(column) for column in zip(*axes, strict=True))
    return Projected(u, v, valid, du, dv)
