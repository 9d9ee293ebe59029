"""Fused normal equations of the alignment residual (room: residuals; pure JAX).

In: pose, views, texture, kernel. Out: gradient and Gauss-Newton Hessian in the right tangent of T_map_base, and cost.
Residual i depends on point i only, so one reverse pass with the gradient of the texture gives the derivative by the
point for any camera model; the pose enters by the cross product. Nothing of size n x 6 x 6 is ever stored.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from semloc_jax.geometry import lie
from semloc_jax.residuals.alignment import CameraViews, points_in_camera
from semloc_jax.residuals.fusion_barrier import behind_barrier
from semloc_jax.residuals.robust import Kernel
from semloc_jax.residuals.texture import RampTexture, Texel, blend, fetch, locate

_I, _J = np.triu_indices(7)
_FULL = np.zeros((7, 7), np.int32)
_FULL[_I, _J] = _FULL[_J, _I] = np.arange(28)


class NormalEquations(NamedTuple):
    """Quadratic model of the summed robust cost around a pose."""

    hessian: Float[Array, "6 6"]
    gradient: Float[Array, "6"]
    cost: Float[Array, ""]
    """sum_i w_i rho(r_i)."""


def normal_equations(
    T_map_base: Float[Array, "4 4"],
    views: tuple[CameraViews, ...],
    texture: RampTexture,
    kernel: Kernel,
    always: Bool[Array, "2"],
) -> NormalEquations:
    """Gradient and Gauss-Newton Hessian of sum_i w_i rho(r_i) by the right tangent xi of T_map_base exp(xi).

    Args:
        T_map_base: Vehicle pose relative to the local origin.
        views: Views of all cameras.
        texture: One level of the cost maps.
        kernel: Robust kernel.
        always: True twice, as an argument of the compiled function (see `behind_barrier`): one wall for each predicate,
            since XLA merges nested conditionals on the same one.
    """
    augmented, cost = jnp.zeros((7, 7), T_map_base.dtype), jnp.zeros((), T_map_base.dtype)
    for view in views:
        matrices, costs = jax.vmap(lambda v: _one_camera(T_map_base, v, texture, kernel, always))(view)
        augmented, cost = augmented + jnp.sum(matrices, axis=0), cost + jnp.sum(costs)
    return NormalEquations(augmented[:6, :6], augmented[:6, 6], cost)


def _one_camera(
    T_map_base: Array, view: CameraViews, texture: RampTexture, kernel: Kernel, always: Array
) -> tuple[Array, Array]:
    """Augmented matrix [[H g] [g' .]] in the vehicle's tangent, and cost, of one camera."""

    def points() -> tuple[Array, Array, Array]:
        return points_in_camera(view.T_cam_base, T_map_base, view.p_map)

    def after_fetch(taps: Array) -> tuple[Array, Array]:
        pixel, pull = jax.vjp(lambda *p: view.camera.project_xyz(*p)[:2], *points())
        value, du, dv = blend(texture, taps, locate(texture, *pixel))
        slope = pull((du, dv))
        root = jnp.sqrt(view.weight * kernel.weight(value))
        parts = (root * slope[0], root * slope[1], root * slope[2], root * value)
        return behind_barrier(always[1], after_slopes, *parts, view.weight * kernel.rho(value))

    def after_slopes(ax: Array, ay: Array, az: Array, r: Array, rho: Array) -> tuple[Array, Array]:
        x, y, z = points()
        # Moving the camera by xi moves the point by -v - omega x p, hence the residual by -a.v + (a x p).omega.
        rows = jnp.zeros((7, x.shape[-1]), x.dtype)
        for k, row in enumerate((-ax, -ay, -az, ay * z - az * y, az * x - ax * z, ax * y - ay * x, r)):
            rows = rows.at[k].set(row)
        ones = jnp.ones_like(x)
        # A product with ones sums with vector instructions; a plain sum must keep the order and is scalar.
        sums = jnp.dot(rows[_I] * rows[_J], ones, precision=jax.lax.Precision.HIGHEST)
        return sums, jnp.dot(rho, ones, precision=jax.lax.Precision.HIGHEST)

    texel: Texel = locate(texture, *view.camera.project_xyz(*points())[:2])
    taps = fetch(texture, texture.image_index(view.index, view.channel), texel)
    sums, cost = behind_barrier(always[0], after_fetch, taps)
    carry = jnp.eye(7, dtype=sums.dtype).at[:6, :6].set(lie.adjoint(view.T_cam_base))
    return carry.T @ sums[_FULL] @ carry, cost
