"""How well a place can be known, told from map and cameras alone (room: analysis; JAX).

In: map samples around a place, a pose, cameras. Out: information of the pose and its covariance, without an image.
Where masks are perfect, the ramp of a class rises across the contour and nowhere else: the gradient of a residual is
the image normal of its contour over the ramp. The rest is as in `alignment.pose.assess`: the same samples, weights,
limits for each element and noise of a mask boundary.
How boundaries of real masks are displaced (BoundaryNoise) was measured at true poses on simulated drives (degraded
masks, pinhole and fisheye, 640x400 to 960x600): neighbours on one edge of one element are wrong together, mostly over
10 px, a little along the whole line; the opposite edge of a stripe and other elements know nothing of it; and all masks
are too thin or too thick by the same. Lengths are pixels of the mask, whatever the size of the image: the network
displaces boundaries, not the camera.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from semloc_jax.alignment.pose import AlignConfig
from semloc_jax.alignment.scene import SceneConfig
from semloc_jax.cameras import Rig
from semloc_jax.geometry import lie
from semloc_jax.residuals.contour_rows import contour_rows
from semloc_jax.residuals.view import ViewConfig, view
from semloc_jax.structs import MapSamples, ViewSamples


@dataclass(frozen=True)
class BoundaryNoise:
    """Prior values for displaced boundaries, before a frame is seen. All values are our choice."""

    own_px2: float = 0.12
    """Variance of a boundary pixel that no other pixel shares."""
    length_px: tuple[float, ...] = (10.0, 150.0)
    """Lengths over which displacements of one edge of one element change."""
    edge_px2: tuple[float, ...] = (0.05, 0.02)
    """Their variances."""
    thickness_px2: float = 0.011
    """Variance of what all masks of an image are too thin or too thick by."""
    efficiency: float = 0.36
    """Curvature of the robust cost over that of squared distances to all that the map has in view: parts are missing,
    the loss lets go, and ramps on smoothed stairs rise by less than a pixel for each pixel."""
    height_m: float = 0.01
    """How far vehicles really stand off the plane of the road; the prior of the solver leaves room for much more."""
    roll_pitch_deg: float = 0.15

    @property
    def variance_px2(self) -> Float[np.ndarray, " component"]:
        """Own, by length, thickness."""
        return np.array([self.own_px2, *self.edge_px2, self.thickness_px2])

    def road_scatter(self, prior_sigma: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6 6"]:
        """Covariance of the vehicle about the prior that its place on the road gives, whitened by the prior.

        Position and heading: the prior is believed. Height, roll and pitch: as vehicles really stand, if that is less.
        """
        tilt = np.deg2rad(self.roll_pitch_deg)
        real = np.array([np.inf, np.inf, self.height_m, tilt, tilt, np.inf])
        sigma = np.asarray(prior_sigma, np.float64)
        return np.diag(np.where(sigma > 0, np.minimum(real / np.where(sigma > 0, sigma, 1.0), 1.0), 0.0) ** 2)


@dataclass(frozen=True)
class ExpectedConfig:
    """What the expected accuracy of a place rests on. All values are our choice."""

    scene: SceneConfig = field(default_factory=SceneConfig)
    """View, noise of mask boundaries, road."""
    boundary: BoundaryNoise = field(default_factory=BoundaryNoise)
    """How boundaries of real masks are displaced."""
    shared_error: float | None = None
    """As `ViewConfig.shared_error`; None for its default."""
    prior_xy_m: float = 1.0
    """What is known of the position before the image."""
    prior_heading_deg: float = 3.0

    @cached_property
    def view(self) -> ViewConfig:
        """How the map is seen from a place."""
        found = self.scene.view_of(ViewConfig())
        return found if self.shared_error is None else replace(found, shared_error=self.shared_error)

    @cached_property
    def align(self) -> AlignConfig:
        """Noise of mask boundaries; margin at the border of the image."""
        return self.scene.align_of(AlignConfig())

    @property
    def prior_sigma(self) -> np.ndarray:
        """Standard deviations of the prior along the tangent, `float64[6]` [m, rad]."""
        road = self.scene.road
        tilt = np.deg2rad(road.roll_pitch_deg)
        xy, heading = self.prior_xy_m, np.deg2rad(self.prior_heading_deg)
        return np.array([xy, xy, road.height_m, tilt, tilt, heading])


def view_information(
    T_local_base: Float[Array, "4 4"], rig: Rig, seen: ViewSamples, align: AlignConfig
) -> tuple[Float[Array, "cam p 6"], Float[Array, "cam p"]]:
    """Rows a and weights w of what is seen: the expected information is the sum of w a a'.

    Args:
        T_local_base: Pose relative to the local origin.
        rig: Cameras.
        seen: Samples as they are seen from about that pose.
        align: Noise of mask boundaries.
    """
    found = _contours(T_local_base, rig, seen, align)
    return found.row, found.weight


class _Contours(NamedTuple):
    """The contours in view, one row of arrays for each camera."""

    row: Float[Array, "cam p 6"]
    weight: Float[Array, "cam p"]
    uv: Float[Array, "cam p 2"]
    normal: Float[Array, "cam p 2"]


def _contours(T_local_base: Array, rig: Rig, seen: ViewSamples, align: AlignConfig) -> _Contours:
    parts = []
    for index, camera in enumerate(rig.cameras):
        T_cam_base = lie.inverse(jnp.asarray(rig.T_base_cam[index], T_local_base.dtype))
        a, uv, normal = contour_rows(T_local_base, T_cam_base, camera, seen.p_map[index], seen.tangent_map[index])
        inside = camera.in_image(*uv, align.border_px) & (seen.weight[index] > 0)
        weight = jnp.where(inside, seen.weight[index], 0.0) * align.noise.information_per_px
        parts.append((jnp.where(inside, a, 0.0).T, weight, uv.T, normal.T))
    return _Contours(*(jnp.stack(column) for column in zip(*parts, strict=True)))


def expected_covariance(
    information: Float[Array, "*b 6 6"], prior_sigma: Float[Array | np.ndarray, "6"]
) -> Float[Array, "*b 6 6"]:
    """Covariance [m, rad]^2 of the pose from the information of the image and the prior's standard deviations.

    As the solver states it: careful, and enough to compare cameras or maps. How far poses of masks with a network's
    faults really scatter is what `expected_scatter` says.
    """
    scale = jnp.asarray(prior_sigma, information.dtype)
    whitened = scale[:, None] * information * scale + jnp.eye(6, dtype=information.dtype)
    return scale[:, None] * jnp.linalg.inv(whitened) * scale


def expected_scatter(
    samples: MapSamples,
    T_local_base: Float[Array, "4 4"],
    rig: Rig,
    channel_of_label: Int[Array, " label"],
    config: ExpectedConfig,
) -> tuple[Float[Array, "6 6"], Float[Array, "6 6"]]:
    """Covariance [m, rad]^2 of the poses that masks with a network's faults give, and the information of perfect masks.

    The sandwich of `analysis.uncertainty`, with what is believed of masks in place of residuals. The information is
    about the right tangent of the pose [1/m, 1/rad]^2.
    """
    noise, dtype = config.boundary, T_local_base.dtype
    seen = view(samples, T_local_base, rig, channel_of_label, config.view)
    found = _contours(T_local_base, rig, seen, config.align)
    information = jnp.einsum("cpi,cp,cpj->ij", found.row, found.weight, found.row)
    sigma = np.asarray(config.prior_sigma)
    score = jax.vmap(partial(_score_covariance, noise=noise))(found, seen.element)
    scale = jnp.asarray(sigma, dtype)
    meat = scale[:, None] * jnp.sum(score, axis=0) * scale + jnp.asarray(noise.road_scatter(sigma), dtype)
    inverse = jnp.linalg.inv(noise.efficiency * scale[:, None] * information * scale + jnp.eye(6, dtype=dtype))
    return scale[:, None] * (inverse @ meat @ inverse) * scale, information


def _score_covariance(found: _Contours, element: Int[Array, " p"], noise: BoundaryNoise) -> Float[Array, "6 6"]:
    """Covariance of the gradient of the cost of one camera."""
    across = found.weight[:, None] * found.row
    apart = jnp.linalg.norm(found.uv[:, None] - found.uv[None], axis=-1)
    facing = jnp.where(element[:, None] == element, jnp.maximum(found.normal @ found.normal.T, 0.0), 0.0)
    terms = zip(noise.edge_px2, noise.length_px, strict=True)
    shared = facing * sum(variance * jnp.exp(-apart / length) for variance, length in terms)
    return noise.own_px2 * (across.T @ across) + across.T @ shared @ across


DIRECTIONS = ("longitudinal", "lateral", "heading")
TANGENT_OF_DIRECTION = np.array([0, 1, 5])


def expected_sigma(covariance: Float[Array, "*b 6 6"]) -> Float[Array, "*b 3"]:
    """Standard deviation of the longitudinal [m], lateral [m] and heading [rad] error."""
    index = TANGENT_OF_DIRECTION
    return jnp.sqrt(covariance[..., index, index])
