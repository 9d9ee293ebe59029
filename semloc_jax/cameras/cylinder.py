"""Cylindrical panorama: upright things stay upright, all around the vehicle (room: cameras; pure JAX).

In: points `p_cam` in a levelled camera frame. Out: model coordinates = (azimuth [rad], tangent of the elevation).
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array

from semloc_jax.cameras.base import Camera, Scalar, as_leaf
from semloc_jax.cameras.elementwise import angle_of, at_least

MIN_RADIUS_M = 1e-2
"""Points nearer to the axis of the cylinder are not projected."""


class CylindricalCamera(Camera):
    """Cylinder around the y axis: u = fx atan2(x, z) + cx, v = fy y / sqrt(x^2 + z^2) + cy.

    The frame is levelled by the extrinsics (its y axis is the axis of the cylinder). `valid` is False further than
    `max_phi_rad` from the z axis.
    """

    max_phi_rad: Scalar

    def __init__(
        self,
        f: ArrayLike,
        cx: ArrayLike,
        cy: ArrayLike,
        width: ArrayLike,
        height: ArrayLike,
        fy: ArrayLike | None = None,
        max_phi_rad: ArrayLike = 3.1,
    ) -> None:
        """Pixels per radian, centre [px], size [px], pixels per unit of tangent (None: f), half view [rad]."""
        self.fx, self.fy, self.cx, self.cy = as_leaf(f), as_leaf(f if fy is None else fy), as_leaf(cx), as_leaf(cy)
        self.width, self.height = as_leaf(width), as_leaf(height)
        self.max_phi_rad = as_leaf(max_phi_rad)

    @classmethod
    def of_numbers(cls, pixels: Sequence[ArrayLike], coefficients: Sequence[ArrayLike]) -> "CylindricalCamera":
        """The camera of fx fy cx cy width height [px]."""
        fx, fy, *centre_and_size = pixels
        return cls(fx, *centre_and_size, *coefficients, fy=fy)

    def _to_model(self, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
        rho2 = x * x + z * z
        inverse_rho = jax.lax.rsqrt(at_least(rho2, MIN_RADIUS_M**2))
        phi = angle_of(x, z)
        return phi, y * inverse_rho, (jnp.abs(phi) < self.max_phi_rad) & (rho2 > MIN_RADIUS_M**2)

    def _from_model(self, xm: Array, ym: Array) -> tuple[Array, Array, Array, Array]:
        scale = jax.lax.rsqrt(1 + ym * ym)
        return jnp.sin(xm) * scale, ym * scale, jnp.cos(xm) * scale, jnp.abs(xm) < self.max_phi_rad
