"""Inverse perspective mapping as a camera: an orthographic view of the road plane (room: cameras; pure JAX).

In: points `p_bev` (x right, y backward, z down; origin on the road under the vehicle). Out: pixels of the top view.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from semloc_jax.cameras.base import Camera, Scalar, as_leaf

Number = float | int


class BevCamera(Camera):
    """Top view of the road plane: u = x / metres_per_px + cx, v = y / metres_per_px + cy.

    Its frame `bev` looks down on the road: x to the right of the vehicle, y backward, z down, so that forward is up in
    the image; `T_base_bev` is its pose. The plane is that of the road under the vehicle, never the level of gravity.
    Only what lies within `max_height_m` of the plane is `valid`: a top view shows nothing else in its place.
    Lines of sight are parallel, so `unproject` returns the point of the road plane in metres, not a unit ray.
    """

    max_height_m: Scalar

    def __init__(
        self,
        metres_per_px: ArrayLike,
        cx: ArrayLike,
        cy: ArrayLike,
        width: ArrayLike,
        height: ArrayLike,
        max_height_m: ArrayLike = 0.5,
    ) -> None:
        """Scale [m/px], pixel of the origin of `bev`, image size [px], height of what counts as road [m]."""
        self.fx = self.fy = as_leaf(1 / metres_per_px)
        self.cx, self.cy, self.width, self.height = as_leaf(cx), as_leaf(cy), as_leaf(width), as_leaf(height)
        self.max_height_m = as_leaf(max_height_m)

    @classmethod
    def of_numbers(cls, pixels: Sequence[ArrayLike], coefficients: Sequence[ArrayLike]) -> "BevCamera":
        """The camera of fx fy [px/m], cx cy width height [px]; a resized one may have pixels that are not square."""
        fx, _, *centre_and_size = pixels
        return cls(1 / as_leaf(fx), *centre_and_size, *coefficients)._with_pixels(*pixels)

    @classmethod
    def covering(
        cls, forward_m: Number, backward_m: Number, left_m: Number, right_m: Number, metres_per_px: Number
    ) -> "BevCamera":
        """The top view that covers the rectangle from `backward_m` behind to `forward_m` ahead of the base frame."""
        width, height = round((left_m + right_m) / metres_per_px), round((forward_m + backward_m) / metres_per_px)
        return cls(metres_per_px, left_m / metres_per_px - 0.5, forward_m / metres_per_px - 0.5, width, height)

    @property
    def metres_per_px(self) -> Scalar:
        """Size of a pixel on the road [m]."""
        return 1 / self.fx

    def _to_model(self, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
        return x, y, jnp.abs(z) < self.max_height_m

    def _from_model(self, xm: Array, ym: Array) -> tuple[Array, Array, Array, Array]:
        return xm, ym, jnp.zeros_like(xm), jnp.isfinite(xm + ym)


def T_base_bev() -> Float[np.ndarray, "4 4"]:
    """Pose of the `bev` frame whose origin is that of the base frame."""
    T = np.zeros((4, 4))
    T[1, 0] = T[0, 1] = T[2, 2] = -1.0
    T[3, 3] = 1.0
    return T
