"""Kannala-Brandt fisheye (Kalibr `equidistant`, cv2.fisheye) (room: cameras; pure JAX).

In: points `p_cam`, also beside and behind the lens. Out: model coordinates = distorted angle x direction.
"""

from jax.typing import ArrayLike
from jaxtyping import Array

from semloc_jax.cameras.base import Scalar, as_leaf
from semloc_jax.cameras.elementwise import horner, slope, usable_radius
from semloc_jax.cameras.radial import LARGEST_THETA_RAD, RadialCamera


class KannalaBrandtCamera(RadialCamera):
    """Fisheye: theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8), u = fx theta_d x / r + cx.

    theta is the angle to the optical axis, r the distance from it. Beyond `max_theta_rad` theta_d continues linearly
    and `valid` is False.
    """

    fx: Scalar
    fy: Scalar
    cx: Scalar
    cy: Scalar
    width: Scalar
    height: Scalar
    k1: Scalar
    k2: Scalar
    k3: Scalar
    k4: Scalar
    max_theta_rad: Scalar

    def __init__(
        self,
        fx: ArrayLike,
        fy: ArrayLike,
        cx: ArrayLike,
        cy: ArrayLike,
        width: ArrayLike,
        height: ArrayLike,
        k1: ArrayLike = 0.0,
        k2: ArrayLike = 0.0,
        k3: ArrayLike = 0.0,
        k4: ArrayLike = 0.0,
        max_theta_rad: ArrayLike | None = None,
    ) -> None:
        """Focal lengths and centre [px], image size [px], distortion, half field of view [rad].

        `max_theta_rad` None takes the angle at which the polynomial is about to turn, at most LARGEST_THETA_RAD.
        """
        self.fx, self.fy, self.cx, self.cy = as_leaf(fx), as_leaf(fy), as_leaf(cx), as_leaf(cy)
        self.width, self.height = as_leaf(width), as_leaf(height)
        self.k1, self.k2, self.k3, self.k4 = (as_leaf(k) for k in (k1, k2, k3, k4))
        if max_theta_rad is None:
            max_theta_rad = usable_radius(self._polynomial(), LARGEST_THETA_RAD)
        self.max_theta_rad = as_leaf(max_theta_rad)

    def _polynomial(self) -> tuple:
        return 1.0, self.k1, self.k2, self.k3, self.k4

    def _radius(self, theta: Array) -> Array:
        return theta * horner(self._polynomial(), theta * theta)

    def _slope(self, theta: Array) -> Array:
        return horner(slope(self._polynomial()), theta * theta)
