"""Rigid motions on the host: the float64 numpy twin of `lie` for filters and logs (room: geometry; numpy only).

In: T_a_b [4 4], tangents xi = (v, omega), right perturbation T @ exp(xi). Out: the same, always in float64.
A filter in map coordinates needs float64 whatever JAX is set to, and takes steps too small to be worth a compilation.
"""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

_TAYLOR_BELOW_RAD2 = 1e-4
_NUM_TERMS = 16


def cross(a: Float[np.ndarray, "*#b 3"], b: Float[np.ndarray, "*#b 3"]) -> Float[np.ndarray, "*b 3"]:
    """Cross products, in a fifth of the time that numpy's own takes for some hundred of them."""
    ax, ay, az, bx, by, bz = *np.moveaxis(a, -1, 0), *np.moveaxis(b, -1, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def skew(omega: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b 3 3"]:
    """Matrix W with W p = omega x p."""
    W = np.zeros((*omega.shape[:-1], 3, 3))
    W[..., 2, 1], W[..., 0, 2], W[..., 1, 0] = omega[..., 0], omega[..., 1], omega[..., 2]
    return W - np.swapaxes(W, -1, -2)


def exp(xi: Float[np.ndarray, "*b 6"]) -> Float[np.ndarray, "*b 4 4"]:
    """Rigid motion of a tangent (v, omega) [m, rad]."""
    if xi.ndim == 1:
        return _exp_of_one(*xi.tolist())
    W = skew(xi[..., 3:])
    W2 = W @ W
    angle2 = np.sum(xi[..., 3:] ** 2, axis=-1)[..., None, None]
    small = angle2 < _TAYLOR_BELOW_RAD2
    safe2 = np.where(small, 1.0, angle2)
    angle = np.sqrt(safe2)
    a = np.where(small, 1 - angle2 / 6 + angle2**2 / 120, np.sin(angle) / angle)
    b = np.where(small, 1 / 2 - angle2 / 24 + angle2**2 / 720, 2 * np.sin(angle / 2) ** 2 / safe2)
    c = np.where(small, 1 / 6 - angle2 / 120 + angle2**2 / 5040, (angle - np.sin(angle)) / (safe2 * angle))
    T = np.zeros((*xi.shape[:-1], 4, 4))
    T[..., :3, :3] = np.eye(3) + a * W + b * W2
    T[..., :3, 3] = ((np.eye(3) + b * W + c * W2) @ xi[..., :3, None])[..., 0]
    T[..., 3, 3] = 1.0
    return T


def _exp_of_one(vx: float, vy: float, vz: float, x: float, y: float, z: float) -> Float[np.ndarray, "4 4"]:
    """`exp` of one tangent, in numbers: a frame takes some twenty, and numpy takes ten times as long for each."""
    angle2 = x * x + y * y + z * z
    if angle2 < _TAYLOR_BELOW_RAD2:
        a = 1 - angle2 / 6 + angle2**2 / 120
        b = 1 / 2 - angle2 / 24 + angle2**2 / 720
        c = 1 / 6 - angle2 / 120 + angle2**2 / 5040
    else:
        angle = math.sqrt(angle2)
        a, b = math.sin(angle) / angle, 2 * math.sin(angle / 2) ** 2 / angle2
        c = (angle - math.sin(angle)) / (angle2 * angle)
    # omega x v, and omega x (omega x v) = omega (omega . v) - v angle^2
    cx, cy, cz = y * vz - z * vy, z * vx - x * vz, x * vy - y * vx
    dot = x * vx + y * vy + z * vz
    kept = 1 - c * angle2
    return np.array([
        [1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y, kept * vx + b * cx + c * dot * x],
        [b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x, kept * vy + b * cy + c * dot * y],
        [b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y), kept * vz + b * cz + c * dot * z],
        [0.0, 0.0, 0.0, 1.0],
    ])  # fmt: skip


def log(T: Float[np.ndarray, "*b 4 4"]) -> Float[np.ndarray, "*b 6"]:
    """Tangent (v, omega) [m, rad] of a rigid motion; the inverse of `exp` for rotations below 179 deg."""
    if T.ndim == 2:
        return _log_of_one(T.tolist())
    R = T[..., :3, :3]
    axis = 0.5 * np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = np.arctan2(sine, 0.5 * (np.trace(R, axis1=-2, axis2=-1)[..., None] - 1.0))
    omega = axis * np.where(sine < 1e-9, 1.0, angle / np.where(sine < 1e-9, 1.0, sine))
    W = skew(omega)
    angle2 = angle[..., None] ** 2
    small = angle2 < _TAYLOR_BELOW_RAD2
    safe = np.where(small, 1.0, angle[..., None])
    curve = np.where(small, 1 / 12 + angle2 / 720, (1 - 0.5 * safe / np.tan(0.5 * safe)) / safe**2)
    v = ((np.eye(3) - 0.5 * W + curve * (W @ W)) @ T[..., :3, 3:])[..., 0]
    return np.concatenate([v, omega], axis=-1)


def _log_of_one(T: list[list[float]]) -> Float[np.ndarray, "6"]:
    """`log` of one motion, in numbers; see `_exp_of_one`."""
    (xx, xy, xz, vx), (yx, yy, yz, vy), (zx, zy, zz, vz), _ = T
    x, y, z = 0.5 * (zy - yz), 0.5 * (xz - zx), 0.5 * (yx - xy)
    sine = math.sqrt(x * x + y * y + z * z)
    angle = math.atan2(sine, 0.5 * (xx + yy + zz - 1.0))
    scale = 1.0 if sine < 1e-9 else angle / sine
    x, y, z, angle2 = scale * x, scale * y, scale * z, angle * angle
    curve = 1 / 12 + angle2 / 720
    if angle2 >= _TAYLOR_BELOW_RAD2:
        curve = (1 - 0.5 * angle / math.tan(0.5 * angle)) / angle2
    cx, cy, cz = y * vz - z * vy, z * vx - x * vz, x * vy - y * vx
    dot, norm2 = x * vx + y * vy + z * vz, x * x + y * y + z * z
    kept = 1 - curve * norm2
    return np.array([
        kept * vx - 0.5 * cx + curve * dot * x,
        kept * vy - 0.5 * cy + curve * dot * y,
        kept * vz - 0.5 * cz + curve * dot * z,
        x, y, z,
    ])  # fmt: skip


def planar_pose(
    x_m: float | int, y_m: float | int, heading_rad: float | int = 0, z_m: float | int = 0
) -> Float[np.ndarray, "4 4"]:
    """T_map_base of a vehicle that stands level at (x, y, z) [m] and looks along a heading, counter-clockwise from x.

    >>> sj.planar_pose(12.0, 3.0, np.pi / 2) @ [1.0, 0.0, 0.0, 1.0]  # 1 m ahead of the vehicle, in the map
    array([12.,  4.,  0.,  1.])
    """
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    return np.array([[c, -s, 0.0, x_m], [s, c, 0.0, y_m], [0.0, 0.0, 1.0, z_m], [0.0, 0.0, 0.0, 1.0]])


def pose_from(R_a_b: Float[np.ndarray, "*b 3 3"], t_a_b: Sequence | np.ndarray) -> Float[np.ndarray, "*b 4 4"]:
    """T_a_b of a rotation and a translation [m] `*b 3`."""
    T = np.zeros((*R_a_b.shape[:-2], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R_a_b, t_a_b, 1.0
    return T


def inverse(T_a_b: Float[np.ndarray, "*b 4 4"]) -> Float[np.ndarray, "*b 4 4"]:
    """T_b_a."""
    T = np.zeros_like(T_a_b)
    R_b_a = np.swapaxes(T_a_b[..., :3, :3], -1, -2)
    T[..., :3, :3] = R_b_a
    T[..., :3, 3] = -(R_b_a @ T_a_b[..., :3, 3:])[..., 0]
    T[..., 3, 3] = 1.0
    return T


def adjoint(T_a_b: Float[np.ndarray, "*b 4 4"]) -> Float[np.ndarray, "*b 6 6"]:
    """Ad with T exp(xi) = exp(Ad xi) T."""
    R = T_a_b[..., :3, :3]
    Ad = np.zeros((*T_a_b.shape[:-2], 6, 6))
    Ad[..., :3, :3] = Ad[..., 3:, 3:] = R
    Ad[..., :3, 3:] = skew(T_a_b[..., :3, 3]) @ R
    return Ad


def right_jacobian(xi: Float[np.ndarray, "*b 6"]) -> Float[np.ndarray, "*b 6 6"]:
    """J_r with exp(xi + d) = exp(xi) exp(J_r d) for small d: the series in -ad(xi), for rotations below 180 deg."""
    ad = np.zeros((*xi.shape[:-1], 6, 6))
    ad[..., :3, :3] = ad[..., 3:, 3:] = skew(xi[..., 3:])
    ad[..., :3, 3:] = skew(xi[..., :3])
    identity = np.eye(6)
    J = np.broadcast_to(identity, ad.shape)
    for k in range(_NUM_TERMS, 0, -1):
        J = identity - ad @ J / (k + 1)
    return J


def normalised(T_a_b: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """The rigid motion nearest to a product of many: rounding in the rotation removed."""
    U, _, Vt = np.linalg.svd(T_a_b[:3, :3])
    T = T_a_b.copy()
    T[:3, :3] = U @ Vt
    return T
