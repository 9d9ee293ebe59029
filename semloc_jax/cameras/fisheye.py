"""Kannala-Brandt fisheye (Kalibr `equidistant`, cv2.fisheye) (room: cameras; pure JAX).

In: points `p_cam`, also beside and behind the lens. Out: model coordinates = distorted angle x direction.
"""

from jaxtyping import Array

from semloc_jax.cameras.base import Scalar, as_leaf, number
from semloc_jax.cameras.elementwise import horner, slope, usable_radius
from semloc_jax.cameras.radial import LARGEST_THETA_RAD, RadialCamera


class KannalaBrandtCamera(RadialCamera):
    """Fisheye: theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8), u = fx theta_d x / r + cx.

    theta is the angle to the optical axis, r the distance from it. Beyond `max_theta_rad` theta_d continues linearly
    and `valid` is False.
    """

    k1: Scalar = number(0.0)
    k2: Scalar = number(0.0)
    k3: Scalar = number(0.0)
    k4: Scalar = number(0.0)
    max_theta_rad: Scalar = number(None)

    def __post_init__(self) -> None:
        """Without `max_theta_rad`: the angle at which the polynomial is about to turn, at most LARGEST_THETA_RAD."""
        if self.max_theta_rad is None:
            self.max_theta_rad = as_leaf(usable_radius(self._polynomial(), LARGEST_THETA_RAD))

    def _polynomial(self) -> tuple:
        return 1.0, self.k1, self.k2, self.k3, self.k4

    def _radius(self, theta: Array) -> Array:
        return theta * horner(self._polynomial(), theta * theta)

    def _slope(self, theta: Array) -> Array:
        return horner(slope(self._polynomial()), theta * theta)
