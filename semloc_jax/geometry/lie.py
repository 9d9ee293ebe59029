"""Rigid motions as 4x4 matrices: the one door to jaxlie (room: geometry; pure JAX).

In: T_a_b [4 4] (maps b to a), tangents xi = (v, omega) with the translation first, right perturbation T @ exp(xi).
Out: the same, in the float type of the input. All functions take leading batch axes and have finite gradients at zero.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

_HIGHEST = jax.lax.Precision.HIGHEST
_TAYLOR_BELOW_RAD2 = 1e-3
_SERIES_BELOW_RAD2 = 0.25
_BERNOULLI = (1 / 12, -1 / 720, 1 / 30240, -1 / 1209600, 1 / 47900160, -691 / 1307674368000)
"""B_2n / (2n)! for n = 1, 2 ..."""
_ARCSINE, _ARCSINE_BELOW = (1.0, 1 / 6, 3 / 40, 5 / 112), 1e-4
"""asin(x) / x by powers of x^2, and up to which x^2."""
# What is put together from numbers is a product with a constant: one loop, where XLA would join a row at a time.
_CROSS = np.array(
    [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]]
)
"""[i j k]: how often omega_k stands in place i j of its cross product matrix."""


def _outer_of_quaternion() -> np.ndarray:
    """[m n i j]: how often R_ij stands in place m n of 4 q q' - 1, q = (w, x, y, z)."""
    outer = np.zeros((4, 4, 3, 3))
    for k in range(3):
        outer[0, 0, k, k] = 1
        outer[k + 1, k + 1] = np.diag(np.where(np.arange(3) == k, 1, -1))
    i, j, k = np.nonzero(_CROSS)
    outer[0, k + 1, i, j] = outer[k + 1, 0, i, j] = _CROSS[i, j, k]
    outer[i + 1, j + 1, i, j] = outer[i + 1, j + 1, j, i] = 1
    return outer


_OUTER = _outer_of_quaternion()


def exp(xi: Float[ArrayLike, "*b 6"]) -> Float[Array, "*b 4 4"]:
    """Rigid motion of a tangent (v, omega) [m, rad]."""
    xi = _floating(xi)
    # Not jaxlie's: in float32 its translation is off by half the rotation angle (4 mm a metre) below 0.004 rad.
    J_l, omega = so3_left_jacobian(xi[..., 3:]), xi[..., 3:]
    R = jnp.eye(3, dtype=xi.dtype) + jnp.matmul(skew(omega), J_l, precision=_HIGHEST)
    return _from_rotation_translation(R, _rotate(J_l, xi[..., :3]))


def log(T: Float[ArrayLike, "*b 4 4"]) -> Float[Array, "*b 6"]:
    """Tangent (v, omega) [m, rad] of a rigid motion; the inverse of `exp` for rotations below 180 deg."""
    T = _floating(T)
    omega = so3_log(T[..., :3, :3])
    s = -jnp.sum(omega * omega, axis=-1, keepdims=True)
    small = s > -_SERIES_BELOW_RAD2
    safe = jnp.where(small, -1.0, s)
    half = jnp.sqrt(-safe) / 2
    share = jnp.where(small, _series(_BERNOULLI, s), (half / jnp.tan(half) - 1) / safe)
    W, t = skew(omega), T[..., :3, 3]
    turned = _rotate(W, t)
    return jnp.concatenate([t - turned / 2 + share * _rotate(W, turned), omega], axis=-1)


def so3_exp(omega: Float[ArrayLike, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Rotation matrix of a rotation vector [rad]."""
    omega = _floating(omega)
    return jaxlie.SO3.exp(omega).as_matrix().astype(omega.dtype)


def so3_log(R: Float[ArrayLike, "*b 3 3"]) -> Float[Array, "*b 3"]:
    """Rotation vector [rad] of a rotation matrix."""
    R = _floating(R)
    q = _quaternion_wxyz(R)
    w, v = q[..., :1], q[..., 1:]
    squared = jnp.sum(v * v, axis=-1, keepdims=True)
    small = squared < _ARCSINE_BELOW
    sine = jnp.sqrt(jnp.where(small, 1.0, squared))
    half_over_sine = jnp.where(small, _series(_ARCSINE, squared), jnp.arctan2(sine, jnp.abs(w)) / sine)
    return 2 * jnp.where(w < 0, -v, v) * half_over_sine  # q and -q are one rotation


def _quaternion_wxyz(R: Float[Array, "*b 3 3"]) -> Float[Array, "*b 4"]:
    """Unit quaternion of a rotation matrix, with either sign.

    The four rows of 4 q q' are four multiples of q; the longest is exact. (Of jaxlie's four cases all are compiled.)
    """
    outer = np.eye(4, dtype=R.dtype) + jnp.sum(_OUTER.astype(R.dtype) * R[..., None, None, :, :], axis=(-2, -1))
    longest = jnp.argmax(jnp.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    row = jnp.take_along_axis(outer, longest[..., None, None], axis=-2)[..., 0, :]
    return row / jnp.linalg.norm(row, axis=-1, keepdims=True)


def compose(T_a_b: Float[ArrayLike, "*b 4 4"], T_b_c: Float[ArrayLike, "*c 4 4"]) -> Float[Array, "... 4 4"]:
    """T_a_c = T_a_b @ T_b_c, in full precision also on accelerators that shorten float32 products."""
    return jnp.matmul(_floating(T_a_b), _floating(T_b_c), precision=_HIGHEST)


def inverse(T_a_b: Float[ArrayLike, "*b 4 4"]) -> Float[Array, "*b 4 4"]:
    """T_b_a."""
    T_a_b = _floating(T_a_b)
    R_b_a = jnp.swapaxes(T_a_b[..., :3, :3], -1, -2)
    return _from_rotation_translation(R_b_a, -_rotate(R_b_a, T_a_b[..., :3, 3]))


def transform(T_a_b: Float[ArrayLike, "*b 4 4"], p_b: Float[ArrayLike, "*n 3"]) -> Float[Array, "... 3"]:
    """Points of frame b in frame a; batch axes of T and p broadcast."""
    T_a_b, p_b = _floating(T_a_b), _floating(p_b)
    return _rotate(T_a_b[..., :3, :3], p_b) + T_a_b[..., :3, 3]


def so3_left_jacobian(omega: Float[ArrayLike, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """J_l with exp(omega + d) = exp(J_l d) exp(omega) for small d."""
    omega = _floating(omega)
    angle2 = jnp.sum(omega * omega, axis=-1)[..., None, None]
    small = angle2 < _TAYLOR_BELOW_RAD2
    safe2 = jnp.where(small, 1.0, angle2)
    angle = jnp.sqrt(safe2)
    first = jnp.where(small, 0.5 - angle2 / 24 + angle2**2 / 720, 2 * jnp.sin(angle / 2) ** 2 / safe2)
    second = jnp.where(small, 1 / 6 - angle2 / 120 + angle2**2 / 5040, (angle - jnp.sin(angle)) / (safe2 * angle))
    W = skew(omega)
    W2 = omega[..., :, None] * omega[..., None, :] - angle2 * jnp.eye(3, dtype=omega.dtype)
    return jnp.eye(3, dtype=omega.dtype) + first * W + second * W2


def so3_right_jacobian(omega: Float[ArrayLike, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """J_r with exp(omega + d) = exp(omega) exp(J_r d) for small d."""
    return jnp.swapaxes(so3_left_jacobian(omega), -1, -2)


def se3_right_jacobian_inverse(xi: Float[ArrayLike, "*b 6"]) -> Float[Array, "*b 6 6"]:
    """d log(exp(xi) exp(d)) / dd at d = 0, for rotations below 360 deg.

    The Bernoulli series of ad / (1 - exp(-ad)) closed by the minimal polynomial of ad: 1 + ad / 2 + a ad^2 + b ad^4.
    (jaxlie's `jlog` is off by 1e-5 at angles of 1e-4 rad and has no derivative at zero.)
    """
    xi = _floating(xi)
    s = -jnp.sum(xi[..., 3:] ** 2, axis=-1)[..., None, None]
    small = s > -_SERIES_BELOW_RAD2
    safe = jnp.where(small, -1.0, s)
    half = jnp.sqrt(-safe) / 2
    rest = half / jnp.tan(half) - 1
    slope = (1 / jnp.sin(half) ** 2 - 1 / (half * jnp.tan(half))) / 8
    a = jnp.where(small, _series([(1 - n) * c for n, c in enumerate(_BERNOULLI)], s), 2 * rest / safe - slope)
    b = jnp.where(small, _series([n * c for n, c in enumerate(_BERNOULLI)][1:], s), (slope * safe - rest) / safe**2)
    ad = small_adjoint(xi)
    ad2 = jnp.matmul(ad, ad, precision=_HIGHEST)
    return jnp.eye(6, dtype=xi.dtype) + ad / 2 + a * ad2 + b * jnp.matmul(ad2, ad2, precision=_HIGHEST)


def small_adjoint(xi: Float[ArrayLike, "*b 6"]) -> Float[Array, "*b 6 6"]:
    """ad with Ad of exp(xi) = exp(ad)."""
    xi = _floating(xi)
    W, V = skew(xi[..., 3:]), skew(xi[..., :3])
    return jnp.concatenate([jnp.concatenate([W, V], -1), jnp.concatenate([jnp.zeros_like(W), W], -1)], -2)


def adjoint(T_a_b: Float[ArrayLike, "*b 4 4"]) -> Float[Array, "*b 6 6"]:
    """Ad with T exp(xi) = exp(Ad xi) T."""
    T_a_b = _floating(T_a_b)
    R, t = T_a_b[..., :3, :3], T_a_b[..., :3, 3]
    tR = jnp.matmul(skew(t), R, precision=_HIGHEST)
    return jnp.concatenate([jnp.concatenate([R, tR], -1), jnp.concatenate([jnp.zeros_like(R), R], -1)], -2)


def skew(omega: Float[ArrayLike, "*b 3"]) -> Float[Array, "*b 3 3"]:
    """Matrix W with W p = omega x p."""
    omega = _floating(omega)
    return jnp.sum(_CROSS.astype(omega.dtype) * omega[..., None, None, :], axis=-1)


def se2_to_se3(x: ArrayLike, y: ArrayLike, yaw: ArrayLike, z: ArrayLike = 0.0) -> Float[Array, "*b 4 4"]:
    """Level pose at (x, y, z) [m] with heading `yaw` [rad] counter-clockwise from x."""
    x, y, yaw, z = jnp.broadcast_arrays(*(_floating(value) for value in (x, y, yaw, z)))
    c, s, zero, one = jnp.cos(yaw), jnp.sin(yaw), jnp.zeros_like(yaw), jnp.ones_like(yaw)
    rows = ((c, -s, zero, x), (s, c, zero, y), (zero, zero, one, z), (zero, zero, zero, one))
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def yaw(T: Float[ArrayLike, "*b 4 4"]) -> Float[Array, "*b"]:
    """Heading of the x axis [rad] in (-pi, pi]."""
    T = _floating(T)
    return jnp.arctan2(T[..., 1, 0], T[..., 0, 0])


def _series(coefficients: Sequence[float], s: Array) -> Array:
    value = jnp.zeros_like(s)
    for coefficient in reversed(coefficients):
        value = value * s + coefficient
    return value


def _floating(value: ArrayLike) -> Float[Array, "..."]:
    value = jnp.asarray(value)
    return value if jnp.issubdtype(value.dtype, jnp.floating) else value.astype(float)


def _rotate(R: Array, p: Array) -> Array:
    # Sums of products instead of a matrix product: it fuses, broadcasts and is exact float32 on every device.
    return R[..., :, 0] * p[..., 0:1] + R[..., :, 1] * p[..., 1:2] + R[..., :, 2] * p[..., 2:3]


def _from_rotation_translation(R: Array, t: Array) -> Array:
    shape = jnp.broadcast_shapes(R.shape[:-2], t.shape[:-1])
    R, t = jnp.broadcast_to(R, (*shape, 3, 3)), jnp.broadcast_to(t[..., None], (*shape, 3, 1))
    none, below = [(0, 0, 0)] * len(shape), (0, 1, 0)
    zero = jnp.zeros((), R.dtype)
    upper = jax.lax.pad(R, zero, [*none, below, (0, 1, 0)]) + jax.lax.pad(t, zero, [*none, below, (3, 0, 0)])
    return upper + np.diag([0.0, 0.0, 0.0, 1.0]).astype(R.dtype)
