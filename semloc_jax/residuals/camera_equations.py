"""Normal equations of the alignment residual for cameras that may sit and see otherwise than assumed (room: residuals;
pure JAX).

In: views of many frames, one row for each picture. Out: for each row the quadratic model by the camera's own tangent,
its intrinsics and a shift of its pixels. From these few numbers follow the derivatives by vehicle pose and mount alike:
T_local_cam = T_local_base exp(xi) T_base_cam exp(e) moves in its own tangent by Ad(T_cam_base) xi + e.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.cameras import Camera
from semloc_jax.residuals.alignment import CameraViews, points_in_camera
from semloc_jax.residuals.robust import RobustLoss
from semloc_jax.residuals.texture import RampTexture, blend, fetch, locate


class RowEquations(eqx.Module):
    """Quadratic model of the summed robust cost of each picture, by (camera tangent, intrinsics, shift in u and v)."""

    hessian: Float[Array, "row d d"]
    gradient: Float[Array, "row d"]
    cost: Float[Array, " row"]
    """sum_i w_i rho(r_i)."""


def with_fields(camera: Camera, names: tuple[str, ...], change: Float[Array, " k"]) -> Camera:
    """The camera with `change` added to the named fields; further entries of `change` are not used."""
    if not names:
        return camera
    return eqx.tree_at(
        lambda c: [getattr(c, name) for name in names],
        camera,
        [getattr(camera, name) + change[k] for k, name in enumerate(names)],
    )


def camera_equations(
    rows: CameraViews, names: tuple[str, ...], num_intrinsics: int, texture: RampTexture, loss: RobustLoss
) -> RowEquations:
    """Gauss-Newton model of sum_i w_i rho(r_i) of each row.

    Args:
        rows: One row for each picture of one camera model; `T_cam_base` holds T_cam_local of the row.
        names: Fields of the camera model that are unknown, all differentiated automatically.
        num_intrinsics: Columns for them, at least as many as there are names; the others are zero.
        texture: One level of the cost maps, with a camera axis as long as all rows of all models.
        loss: Robust loss.
    """

    def one_row(row: CameraViews) -> tuple[Array, Array, Array]:
        r, J = _linearised(row, names, num_intrinsics, texture)
        root = jnp.sqrt(row.weight * loss.weight(r))
        J, r_weighted = J * root, r * root
        hessian = jnp.matmul(J, J.T, precision=jax.lax.Precision.HIGHEST)
        gradient = jnp.matmul(J, r_weighted, precision=jax.lax.Precision.HIGHEST)
        return hessian, gradient, jnp.sum(row.weight * loss.rho(r))

    return RowEquations(*jax.vmap(one_row)(rows))


def _linearised(
    row: CameraViews, names: tuple[str, ...], num_intrinsics: int, texture: RampTexture
) -> tuple[Float[Array, " p"], Float[Array, "d p"]]:
    """Ramp values of one picture and their derivatives by camera tangent, intrinsics and a shift of all pixels."""
    dtype = row.p_map.dtype
    x, y, z = points_in_camera(row.T_cam_base, jnp.eye(4, dtype=dtype), row.p_map)
    (u, v), pull = jax.vjp(lambda *p: row.camera.project_xyz(*p)[:2], x, y, z)
    texel = locate(texture, u, v)
    taps = fetch(texture, texture.image_index(row.index, row.channel), texel)
    r, by_u, by_v = blend(texture, taps, texel)
    ax, ay, az = pull((by_u, by_v))
    # Moving the camera by (v, omega) moves the point by -v - omega x p.
    columns = [-ax, -ay, -az, ay * z - az * y, az * x - ax * z, ax * y - ay * x]
    if names:

        def pixel(change: Array) -> tuple[Array, Array]:
            return with_fields(row.camera, names, change).project_xyz(x, y, z)[:2]

        _, push = jax.linearize(pixel, jnp.zeros(len(names), dtype))
        for unit in jnp.eye(len(names), dtype=dtype):
            du, dv = push(unit)
            columns.append(by_u * du + by_v * dv)
    columns += [jnp.zeros_like(r)] * (num_intrinsics - len(names))
    return r, jnp.stack([*columns, by_u, by_v])
