"""Fused normal equations of the alignment residual (room: residuals; pure JAX).

In: pose, views, texture, loss. Out: gradient and Gauss-Newton Hessian in the right tangent of T_local_base, and cost.
Residual i depends on point i only, so one reverse pass with the gradient of the texture gives the derivative by the
point for any camera model; the pose enters by the cross product. Nothing of size n x 6 x 6 is ever stored.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from semloc_jax.cameras import Camera
from semloc_jax.geometry import lie
from semloc_jax.residuals import native_kernels
from semloc_jax.residuals.alignment import CameraViews, points_in_camera
from semloc_jax.residuals.chart import Chart
from semloc_jax.residuals.fusion_barrier import Walls, stored
from semloc_jax.residuals.robust import RobustLoss
from semloc_jax.residuals.texture import RampTexture, blend, fetch, locate


class NormalEquations(NamedTuple):
    """Quadratic model of the summed robust cost around a pose."""

    hessian: Float[Array, "6 6"]
    gradient: Float[Array, "6"]
    cost: Float[Array, ""]
    """sum_i w_i rho(r_i)."""


def normal_equations(
    T_local_base: Float[Array, "4 4"],
    views: tuple[CameraViews, ...],
    texture: RampTexture,
    loss: RobustLoss,
    path: native_kernels.Path = "auto",
) -> NormalEquations:
    """Gradient and Gauss-Newton Hessian of sum_i w_i rho(r_i) by the right tangent xi of T_local_base exp(xi).

    Args:
        T_local_base: Vehicle pose relative to the local origin.
        views: Views of all cameras.
        texture: One level of the cost maps.
        loss: Robust loss.
        path: How it is computed; all paths give the same numbers.

    Raises:
        SemlocError: the path is not possible here.
    """
    return chart_equations(Chart.at(T_local_base), views, texture, loss, path)


def chart_equations(
    chart: Chart,
    views: tuple[CameraViews, ...],
    texture: RampTexture,
    loss: RobustLoss,
    path: native_kernels.Path = "auto",
    skip: Bool[Array, ""] | bool = False,
) -> NormalEquations:
    """`normal_equations` by the coordinates y of a chart.

    Args:
        chart: Where the pose is, and its coordinates.
        views, texture, loss, path: as `normal_equations`.
        skip: True where the result is not needed: the kernels then compute nothing.
    """
    dtype = chart.y.dtype
    total = NormalEquations(jnp.zeros((6, 6), dtype), jnp.zeros(6, dtype), jnp.zeros((), dtype))
    for view in views:
        chosen = native_kernels.use(path, view.camera, loss, dtype)
        one = partial(_PATHS[chosen], chart, texture=texture, loss=loss, skip=jnp.asarray(skip))
        parts = jax.vmap(one)(view)
        total = jax.tree.map(lambda whole, part: whole + jnp.sum(part, axis=0), total, NormalEquations(*parts))
    return total


def _analytic(chart: Chart, view: CameraViews, *, texture: RampTexture, skip: Array, **_: object) -> tuple:
    points = view.p_map, view.channel, view.weight
    return native_kernels.normal_equations(chart, skip, view.camera, view.T_cam_base, points, texture, view.index)


def _autodiff(chart: Chart, view: CameraViews, *, texture: RampTexture, **_: object) -> tuple:
    # What comes out of one loop is computed once: two real arrays travel as one complex array.
    p_cam = points_in_camera(view.T_cam_base, chart.pose(), view.p_map)
    (u, v), pull = jax.vjp(partial(_pixel, view.camera), *p_cam)
    value, slope = native_kernels.lookup(jax.lax.complex(u, v), view.channel, texture, view.index)
    ax, ay, az = pull((slope.real, slope.imag))
    points = view.p_map, view.channel, view.weight
    return native_kernels.accumulate(chart, view.T_cam_base, points, jax.lax.complex(ax, ay), az, value)


def _xla(chart: Chart, view: CameraViews, *, texture: RampTexture, loss: RobustLoss, **_: object) -> tuple:
    matrix, cost = _one_camera(chart.pose(), view, texture, loss)
    J = chart.jacobian()
    hessian = jnp.einsum("ki,kl,lj->ij", J, matrix[:6, :6], J, precision=jax.lax.Precision.HIGHEST)
    return hessian, jnp.einsum("ki,k->i", J, matrix[:6, 6], precision=jax.lax.Precision.HIGHEST), cost


_PATHS = {"analytic": _analytic, "autodiff": _autodiff, "xla": _xla}


def _one_camera(T_local_base: Array, view: CameraViews, texture: RampTexture, loss: RobustLoss) -> tuple[Array, Array]:
    """Augmented matrix [[H g] [g' .]] in the vehicle's tangent, and cost, of one camera."""
    # What several consumers need is stored: each would compute it again.
    walls = Walls.of(texture)
    x, y, z = stored(walls.odd, *points_in_camera(view.T_cam_base, T_local_base, view.p_map))
    (uv,) = stored(walls.even, jax.lax.complex(*_pixel(view.camera, x, y, z)))
    texel = locate(texture, uv.real, uv.imag)
    (taps,) = stored(walls.odd, fetch(texture, texture.image_index(view.index, view.channel), texel))
    value, du, dv = blend(texture, taps, texel)
    root = jnp.sqrt(view.weight * loss.weight(value))
    value, slope_uv = stored(walls.even, value, jax.lax.complex(root * du, root * dv))

    _, pull = jax.vjp(partial(_pixel, view.camera), x, y, z)
    ax, ay, az = pull((slope_uv.real, slope_uv.imag))
    root = jnp.sqrt(view.weight * loss.weight(value))
    # Moving the camera by xi moves the point by -v - omega x p, hence the residual by -a.v + (a x p).omega.
    (linear,) = stored(walls.odd, _rows(-ax, -ay, -az, root * value))
    nx, ny, nz, _ = linear
    angular = _rows(nz * y - ny * z, nx * z - nz * x, ny * x - nx * y)
    cross = _products(linear, angular)
    matrix = jnp.block([[_products(linear, linear), cross], [cross.T, _products(angular, angular)]])
    tangent = jnp.pad(lie.adjoint(view.T_cam_base), ((0, 0), (0, 1)))
    carry = jnp.concatenate([tangent[:3], jnp.eye(7, dtype=x.dtype)[6:], tangent[3:]])  # rows: v, residual, omega
    carried = jnp.einsum("ik,ij,jl->kl", carry, matrix, carry, precision=jax.lax.Precision.HIGHEST)
    return carried, _total(view.weight * loss.rho(value))


def _pixel(camera: Camera, x: Array, y: Array, z: Array) -> tuple[Array, Array]:
    return camera.project_xyz(x, y, z)[:2]


def _rows(*rows: Array) -> Float[Array, "row p"]:
    # Row by row in place: a stack is fused into scalar code with a branch for every element.
    stack = jnp.zeros((len(rows), rows[0].shape[-1]), rows[0].dtype)
    for k, row in enumerate(rows):
        stack = stack.at[k].set(row)
    return stack


def _products(a: Float[Array, "m p"], b: Float[Array, "n p"]) -> Float[Array, "m n"]:
    """a b' as sums of products: a matrix product of this shape (few rows, many columns) is three times slower."""
    i, j = np.indices((a.shape[0], b.shape[0])).reshape(2, -1)
    return _total(a[i] * b[j]).reshape(a.shape[0], b.shape[0])


def _total(values: Float[Array, "*n p"]) -> Float[Array, "*n"]:
    """Sum over points: a product with ones sums with vector instructions, a plain sum keeps the order and is scalar."""
    return jnp.dot(values, jnp.ones(values.shape[-1:], values.dtype), precision=jax.lax.Precision.HIGHEST)
