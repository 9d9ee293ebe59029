"""What every camera shares: pixels = focal length x model coordinates + centre (room: cameras; pure JAX).

In: points `p_cam` [m], z forward, x right, y down. Out: pixels `uv` and `valid`.
A camera model is a map between points and *model coordinates* (tangents, angles or metres); everything that deals with
pixels (scale, crop, offset, border) lives here once. Every field is an array leaf: cameras of one model stack.
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import MISSING
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float
from numpy.typing import DTypeLike

Scalar = Float[Array | np.ndarray, "*stack"]
AnyCamera = TypeVar("AnyCamera", bound="Camera")


def as_leaf(value: ArrayLike) -> Scalar:
    """The number as an array leaf: float64 on the host, untouched if it is already a JAX array (or a tracer)."""
    return value if isinstance(value, jax.Array) else np.asarray(value, dtype=np.float64)


def number(default: ArrayLike | None = MISSING) -> Any:
    """A field of a camera: a number as an array leaf; None, where that is the default, until `__post_init__` knows."""
    return eqx.field(converter=lambda value: None if value is None else as_leaf(value), default=default)


class Camera(eqx.Module):
    """A camera: `project` sees points, `unproject` sees pixels.

    `valid` of a projection says that the point is in front of the lens and inside the field of view in which the model
    can be inverted; whether the pixel lies in the image is the separate question `in_image`.
    Where `valid` is False the pixel and its gradient are still finite.

    A new model is one file with a subclass and one row in `cameras.models.MODELS`. The contract
    (`tests/contracts/test_cameras.py`, add an example to CAMERAS there) holds it to this:

    - Every field is an array leaf (`number`). The constructor, which equinox makes, takes the fields in their order:
      fx fy cx cy width height [px], then the `leading` fields and the `coefficients` of its row, then limits of the
      view, which have a default; or the class overrides `of_numbers`.
    - A lens that can see beyond 90 deg from its axis has the field `max_theta_rad`: half its field of view. Where it
      is symmetric about the axis, `RadialCamera` does the rest: the subclass gives the radius for an angle. Any other
      model that cannot be inverted everywhere has a limit of its own, such as `max_radius`.
    - Beyond the limit `valid` is False and the pixel never folds back: it keeps moving outward, with a continuous
      slope. A model that turned there would show what is behind the vehicle in the middle of the image.
    - Points behind a lens are not `valid`. Values and derivatives are finite for every point, in float32 too: at the
      centre of the lens, on the axis, behind it.
    - `project(unproject(uv))` is `uv` wherever `unproject` is valid.
    - What `write_calibration` writes is read back as a camera with the same pixels, to 1e-6 px.
    """

    fx: Scalar = number()
    fy: Scalar = number()
    cx: Scalar = number()
    cy: Scalar = number()
    width: Scalar = number()
    height: Scalar = number()

    @abstractmethod
    def _to_model(self, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
        """Model coordinates and validity of points; elementwise, finite and differentiable everywhere."""

    @abstractmethod
    def _from_model(self, xm: Array, ym: Array) -> tuple[Array, Array, Array, Array]:
        """Line of sight (x, y, z) and validity of model coordinates; elementwise."""

    @classmethod
    def of_numbers(cls: type[AnyCamera], pixels: Sequence[ArrayLike], coefficients: Sequence[ArrayLike]) -> AnyCamera:
        """The camera of fx fy cx cy width height [px] and the leading fields and coefficients of its row."""
        return cls(*pixels, *coefficients)

    def project_xyz(self, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> tuple[Array, Array, Array]:
        """Pixels of points given by coordinate: the elementwise kernel, in the float type of the points.

        Args:
            x, y, z: Coordinates in the camera frame [m], arrays of one shape.

        Returns:
            u, v [px] and valid, each of that shape.
        """
        x, y, z = jnp.asarray(x), jnp.asarray(y), jnp.asarray(z)
        camera = self.astype(jnp.result_type(x, y, z))
        xm, ym, valid = camera._to_model(x, y, z)
        return camera.fx * xm + camera.cx, camera.fy * ym + camera.cy, valid

    def project(self, p_cam: Float[ArrayLike, "*n 3"]) -> tuple[Float[Array, "*n 2"], Bool[Array, "*n"]]:
        """Pixels uv [px] of points in the camera frame [m], and whether the camera can see in that direction."""
        return _project(self, jnp.asarray(p_cam))

    def unproject(self, uv: Float[ArrayLike, "*n 2"]) -> tuple[Float[Array, "*n 3"], Bool[Array, "*n"]]:
        """Unit line of sight in the camera frame of each pixel, and whether the model could be inverted there."""
        return _unproject(self, jnp.asarray(uv))

    def in_image(self, u: ArrayLike, v: ArrayLike, margin_px: ArrayLike = 0.0) -> Bool[ArrayLike, "*n"]:
        """Whether pixels lie at least `margin_px` inside the border of the image (the border is at -0.5)."""
        low = margin_px - 0.5
        return (u >= low) & (v >= low) & (u <= self.width - 1 - low) & (v <= self.height - 1 - low)

    def resized(self: AnyCamera, width_px: ArrayLike, height_px: ArrayLike) -> AnyCamera:
        """The camera of the same view resampled to another size: u -> (u + 0.5) s - 0.5, as cv2.resize does."""
        su, sv = width_px / self.width, height_px / self.height
        cx, cy = (self.cx + 0.5) * su - 0.5, (self.cy + 0.5) * sv - 0.5
        return self._with_pixels(self.fx * su, self.fy * sv, cx, cy, width_px, height_px)

    def cropped(
        self: AnyCamera, left_px: ArrayLike, top_px: ArrayLike, width_px: ArrayLike, height_px: ArrayLike
    ) -> AnyCamera:
        """The camera of the window [left, left + width) x [top, top + height) of the image."""
        return self._with_pixels(self.fx, self.fy, self.cx - left_px, self.cy - top_px, width_px, height_px)

    def shifted(self: AnyCamera, du_px: ArrayLike, dv_px: ArrayLike) -> AnyCamera:
        """The camera whose pixels all move by (du, dv): the offset that a mask made at another size carries."""
        return self._with_pixels(self.fx, self.fy, self.cx + du_px, self.cy + dv_px, self.width, self.height)

    @property
    def resolution(self) -> tuple[int, int]:
        """Width and height in whole pixels (host only)."""
        return round(float(self.width)), round(float(self.height))

    def astype(self: AnyCamera, dtype: DTypeLike) -> AnyCamera:
        """The camera with every number in one float type."""
        return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=dtype), self)

    def _with_pixels(self: AnyCamera, *values: ArrayLike) -> AnyCamera:
        def pixel_fields(camera: Camera) -> tuple:
            return camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height

        return eqx.tree_at(pixel_fields, self, tuple(as_leaf(value) for value in values))


@partial(jax.jit, inline=True)
def _project(camera: Camera, p_cam: Float[Array, "*n 3"]) -> tuple[Float[Array, "*n 2"], Bool[Array, "*n"]]:
    # On the host one program for each number of points, instead of thirty: one for each operation.
    u, v, valid = camera.project_xyz(p_cam[..., 0], p_cam[..., 1], p_cam[..., 2])
    return jnp.stack([u, v], axis=-1), valid


@jax.jit
def _unproject(camera: Camera, uv: Float[Array, "*n 2"]) -> tuple[Float[Array, "*n 3"], Bool[Array, "*n"]]:
    # Compiled, because a loop outside of jit is compiled anew at every call.
    camera = camera.astype(uv.dtype)
    x, y, z, valid = camera._from_model((uv[..., 0] - camera.cx) / camera.fx, (uv[..., 1] - camera.cy) / camera.fy)
    return jnp.stack([x, y, z], axis=-1), valid


def stack_cameras(cameras: Sequence[Camera]) -> Camera:
    """One camera whose leaves have a leading axis, for `vmap` over cameras of one model.

    Raises:
        ValueError: The cameras are of different models.
    """
    models = {type(camera).__name__ for camera in cameras}
    if len(models) != 1:
        raise ValueError(f"stack_cameras: got models {sorted(models)}, expected one; group first with Rig.groups()")
    return jax.tree.map(lambda *leaves: np.stack(leaves) if _host(leaves) else jnp.stack(leaves), *cameras)


def _host(leaves: Sequence[Scalar]) -> bool:
    return all(isinstance(leaf, np.ndarray | np.generic) for leaf in leaves)
