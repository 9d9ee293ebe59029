"""The covariance of a pose whose residuals are correlated (room: analysis; JAX and host).

In: the evidence of one frame at its optimum. Out: sandwich covariance H^-1 (M + P) H^-1.
H is the curvature of the robust cost: with ideal contours, since the stairs of masks hold a pose only until the next
stair, and with the slope that the ramps really have. M is the covariance of the gradient: with the gradients that the
ramps really have, whose stairs pull along a contour as well as across it, and with the correlation of displaced
boundaries, found in the residuals themselves and corrected for what the fit of the pose has taken out of them.
P is what the road under the vehicle adds where the prior holds the pose.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.optimize import nnls
from scipy.stats import t as student

from semloc_jax.alignment.level_choice import holds
from semloc_jax.alignment.pose import AlignConfig
from semloc_jax.alignment.single_frame import FrameInput, SingleFrameConfig
from semloc_jax.analysis.expected import BoundaryNoise
from semloc_jax.cameras import Rig
from semloc_jax.geometry import lie
from semloc_jax.residuals.alignment import Usable, visibility
from semloc_jax.residuals.alignment import camera_views as group_views
from semloc_jax.residuals.contour_rows import contour_rows, image_rows
from semloc_jax.residuals.noise import is_inlier
from semloc_jax.residuals.texture import RampTexture, lookup
from semloc_jax.residuals.view import view
from semloc_jax.runtime.stored_program import stored_program
from semloc_jax.structs import ViewSamples


@dataclass(frozen=True)
class SandwichConfig:
    """Prior values before a frame is seen, and their weight. All values are our choice."""

    noise: BoundaryNoise = field(default_factory=BoundaryNoise)
    """The ratios of its variances count: the level is that of the frame. Its efficiency is not used."""
    believed: float = 1.0
    """How much these weigh against the variogram of one frame: each is known to 1 / sqrt(believed) of itself."""
    least_efficiency: float = 0.2
    """The curvature of the robust cost is in every direction at least this share of its Gauss-Newton matrix."""
    freedom: float = 8.0
    """H and M are estimates themselves, as of so many independent pulls: the covariance grows as Student's does."""
    tail_freedom: float = 4.0
    """Errors are Student's with so many degrees of freedom: in some frames more masks are wrong than their residuals
    tell. See `error_bound`."""
    bin_px: tuple[float, ...] = (8.0, 22.0, 55.0, 140.0)
    """Limits of the distances along an edge of the variogram; farther pairs are its last bin."""


class BoundaryResiduals(NamedTuple):
    """Every boundary sample of one frame at its optimum, for one camera after the other."""

    slope: Float[Array, "n 6"]
    """Derivative of the distance out of an ideal mask by the right tangent [px/m, px/rad]."""
    gradient: Float[Array, "n 6"]
    """The same of the ramp as it is."""
    rise: Float[Array, " n"]
    """How much the ramp rises for each pixel out of the mask; 1 where it is ideal."""
    ramp: Float[Array, " n"]
    """Signed distance from the mask boundary to the contour of the map as a share of the ramp, outside positive."""
    ramp_px: Float[Array, " n"]
    weight: Float[Array, " n"]
    """Independent observations over their variance [1/px^2]; 0 where nothing is seen."""
    uv: Float[Array, "n 2"]
    normal: Float[Array, "n 2"]
    """Unit normal of the contour, out of the mask."""
    camera: Int[Array, " n"]
    element: Int[Array, " n"]


@stored_program("align")
def boundary_residuals(
    T_local_base: Float[Array, "4 4"],
    rig: Rig,
    samples: ViewSamples,
    texture: RampTexture,
    usable: Usable,
    align: AlignConfig,
) -> BoundaryResiduals:
    """The residuals of all cameras at a pose.

    Args:
        T_local_base: Pose relative to the local origin.
        rig: Cameras of the masks.
        samples: The map as it is seen from there; see `residuals.view`.
        texture: The level of the cost maps on which the pose was found.
        usable: Usable pixels.
        align: Noise, correlation and border of the solve.
    """
    seen = jnp.zeros(samples.weight.shape, bool)
    for group in group_views(rig, samples):
        seen = seen.at[group.index].set(visibility(T_local_base, group, usable, align.border_px))
    parts = []
    for k, camera in enumerate(rig.cameras):
        camera = camera.astype(T_local_base.dtype)
        T_cam_base = lie.inverse(jnp.asarray(rig.T_base_cam[k], T_local_base.dtype))
        slope, (u, v), normal = contour_rows(T_local_base, T_cam_base, camera, samples.p_map[k], samples.tangent_map[k])
        image = texture.image_index(jnp.asarray(k), samples.channel[k])
        ramp, pull = jax.vjp(lambda u, v, image=image: lookup(texture, image, u, v), u, v)
        steep = texture.ramp_px * jnp.stack(pull(jnp.ones_like(ramp)))
        rise = jnp.sum(steep * normal, axis=0)
        out = jnp.where(rise >= 0, 1.0, -1.0)
        weight = jnp.where(seen[k], samples.weight[k], 0.0) * align.noise.information_per_px
        gradient = image_rows(T_local_base, T_cam_base, camera, samples.p_map[k], steep)
        row = (out * slope).T, gradient.T, out * rise, ramp, jnp.full(u.shape, texture.ramp_px), weight
        row += jnp.stack([u, v], axis=-1), (out * normal).T, jnp.full(u.shape, k), samples.element[k]
        parts.append(row)
    return BoundaryResiduals(*(jnp.concatenate(column) for column in zip(*parts, strict=True)))


def pose_residuals(
    T_local_base: Float[Array, "4 4"], inputs: FrameInput, config: SingleFrameConfig
) -> BoundaryResiduals:
    """The residuals of a frame at a pose that was found in it, on the finest level that held the pose.

    Args:
        T_local_base: Pose relative to the local origin.
        inputs: Map samples, cost maps, cameras.
        config: How the pose was found.
    """
    align = config.polish_align
    seen = view(inputs.samples, T_local_base, inputs.rig, inputs.channel_of_label, config.polish_view)
    for level in reversed(align.levels):
        texture = inputs.textures.level(level)
        found = boundary_residuals(T_local_base, inputs.rig, seen, texture, inputs.usable, align)
        weight = np.asarray(found.weight, np.float64)
        if holds(np.sum(weight * is_inlier(found.ramp)), align.min_inlier_ratio * np.sum(weight)):
            break
    return found


class Sandwich(NamedTuple):
    """What the residuals of one frame say of its pose.

    Attributes:
        covariance: of the right tangent [m, rad], residual correlation taken into account.
        naive: inverse of the information that the solver assumes, one observation each `correlation_px`.
        variance_px2: of a boundary: of its own pixel, by length along its edge, thickness; see `BoundaryNoise`.
    """

    covariance: Float[np.ndarray, "6 6"]
    naive: Float[np.ndarray, "6 6"]
    variance_px2: Float[np.ndarray, " component"]


def sandwich_covariance(
    residuals: BoundaryResiduals, prior_sigma: Float[np.ndarray, "6"], config: SandwichConfig | None = None
) -> Sandwich:
    """The covariance of a pose from the residuals at its optimum.

    Args:
        residuals: Of `pose_residuals`.
        prior_sigma: Standard deviations of the prior (x, y, z [m], roll, pitch, yaw [rad]).
        config: None for the defaults.
    """
    config, sigma = config or SandwichConfig(), np.asarray(prior_sigma, np.float64)
    if not np.any(np.asarray(residuals.weight) > 0):
        return Sandwich(np.diag(sigma**2), np.diag(sigma**2), config.noise.variance_px2)
    model = _Model(residuals, sigma, config)
    return model.sandwich(fitted_variances(*model.variogram(), config))


def error_bound(
    covariance: Float[np.ndarray, "6 6"], share: float, config: SandwichConfig | None = None
) -> Float[np.ndarray, "6"]:
    """Half widths [m, rad] of the intervals that hold a share of the errors, direction by direction.

    Args:
        covariance: Of `sandwich_covariance`.
        share: Of the errors, above 0 and below 1.
        config: Of the same call; None for the defaults.
    """
    config = config or SandwichConfig()
    scale = np.sqrt(np.diag(covariance) * (config.freedom - 2.0) / config.freedom)
    return scale * student.ppf(0.5 + 0.5 * share, config.tail_freedom)


def fitted_variances(
    found: Float[np.ndarray, " bin"],
    design: Float[np.ndarray, "bin component"],
    spread: Float[np.ndarray, " bin"],
    config: SandwichConfig,
) -> Float[np.ndarray, " component"]:
    """Variances that explain a variogram: least squares without negative ones, near what is believed.

    Args:
        found: Weighted sum of the products of residuals in each bin of distances.
        design: What a variance of 1 of each component would give.
        spread: Standard deviation of each sum.
        config: Beliefs.
    """
    belief = config.noise.variance_px2
    belief = belief * max(found[0] / max(design[0] @ belief, 1e-12), 1e-3)
    sure = np.sqrt(config.believed) / belief
    rows = np.concatenate([design / spread[:, None], np.diag(sure)])
    return nnls(rows, np.concatenate([found / spread, sure * belief]))[0]


class _Block(NamedTuple):
    """The samples of one element in one camera."""

    index: np.ndarray
    bins: np.ndarray
    pair: np.ndarray
    """Weight of each pair in the variogram; pairs that face different ways count nothing."""
    parts: tuple[np.ndarray, ...]
    """Covariance of their displacements for a variance of 1, of their own and for each length."""


class _Model:
    """Matrices of one frame, whitened by the prior."""

    def __init__(self, residuals: BoundaryResiduals, sigma: np.ndarray, config: SandwichConfig):
        given = BoundaryResiduals(*(np.asarray(leaf) for leaf in residuals))
        given = BoundaryResiduals(*(leaf[given.weight > 0] for leaf in given))
        ramp, self.weight, rise = (leaf.astype(np.float64) for leaf in (given.ramp, given.weight, given.rise))
        # Tukey's loss, as `residuals.robust` has it: weight, and the derivative of weight times residual.
        inside = np.maximum(1 - ramp**2, 0.0)
        held, bent = inside**2, inside * (1 - 5 * ramp**2)
        slope, gradient = given.slope * sigma, given.gradient * sigma
        information = (slope.T * (self.weight * held)) @ slope
        curvature = (slope.T * (self.weight * bent * rise**2)) @ slope
        self.naive = np.linalg.inv(information + np.eye(6))
        curvature = _at_least(curvature, information, config.least_efficiency)
        self.inverse = np.linalg.inv(curvature + np.eye(6))
        self.scatter, self.sigma = config.noise.road_scatter(sigma), sigma
        self.unsure = config.freedom / (config.freedom - 2.0)
        self.pulled, self.score = held * ramp * given.ramp_px, gradient * self.weight[:, None]
        # An error e moves the pose by fit @ e, which leaves e - moved @ (fit @ e) in the residuals.
        self.fit, self.moved = self.inverse @ self.score.T, bent[:, None] * gradient
        self.in_camera = given.camera[:, None] == np.unique(given.camera)
        self.blocks = [_block(index, given, self.weight, config) for index in _elements(given)]

    def _spread_to_pose(self) -> list[np.ndarray]:
        """Covariance of every residual with the pose, `[n 6]`, for a variance of 1 of each component."""
        columns = []
        for blocks in self._by_part():
            column = np.empty_like(self.moved)
            for block, part in blocks:
                column[block.index] = part @ self.fit[:, block.index].T
            columns.append(column)
        return [*columns, self.in_camera @ (self.in_camera.T @ self.fit.T)]

    def variogram(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Sums of products of residuals by distance along an edge, what each component would give, and their spread.

        The last sum is over all pairs of a camera: it tells of the thickness of the masks.
        """
        with_pose = self._spread_to_pose()
        of_pose = [self.fit @ column for column in with_pose]
        num_bins = 2 + max(block.bins.max() for block in self.blocks)
        found, squares, design = np.zeros(num_bins), np.zeros(num_bins), np.zeros((num_bins, len(with_pose)))
        for index, bins, pair, parts in self.blocks:
            moved, pulled = self.moved[index], self.pulled[index]
            found += np.bincount(bins.ravel(), (pair * np.outer(pulled, pulled)).ravel(), num_bins)
            squares += np.bincount(bins.ravel(), (pair**2).ravel(), num_bins)
            for k, part in enumerate((*parts, np.ones_like(pair))):
                taken = moved @ with_pose[k][index].T
                left = part - taken - taken.T + moved @ of_pose[k] @ moved.T
                design[:, k] += np.bincount(bins.ravel(), (pair * left).ravel(), num_bins)
        for inside in self.in_camera.T:
            weight = self.weight * inside
            moved = self.moved.T @ weight
            found[-1] += (weight @ self.pulled) ** 2
            squares[-1] += (weight @ weight) ** 2
            sums = [sum(weight[b.index] @ part @ weight[b.index] for b, part in blocks) for blocks in self._by_part()]
            for k, whole in enumerate((*sums, np.sum(weight) ** 2)):
                design[-1, k] += whole - 2 * moved @ (with_pose[k].T @ weight) + moved @ of_pose[k] @ moved
        scale = np.average(self.pulled**2, weights=self.weight)
        return found, design, np.maximum(scale * np.sqrt(squares), 1e-9)

    def _by_part(self) -> list[list[tuple[_Block, np.ndarray]]]:
        """Blocks with their covariances, for one component after the other."""
        return [[(b, b.parts[k]) for b in self.blocks] for k in range(len(self.blocks[0].parts))]

    def sandwich(self, variance: np.ndarray) -> Sandwich:
        """The covariance with these variances."""
        meat = self.scatter.copy()
        for s, blocks in zip(variance, self._by_part(), strict=False):
            meat += s * sum(self.score[b.index].T @ part @ self.score[b.index] for b, part in blocks)
        by_camera = self.in_camera.T @ self.score
        meat += variance[-1] * by_camera.T @ by_camera
        covariance, scale = self.unsure * (self.inverse @ meat @ self.inverse), np.outer(self.sigma, self.sigma)
        return Sandwich(scale * covariance, scale * self.naive, variance)


def _at_least(curvature: np.ndarray, information: np.ndarray, share: float) -> np.ndarray:
    """The curvature, raised to a share of the information in every direction where it is less."""
    root = np.linalg.cholesky(information + 1e-9 * np.trace(information) * np.eye(6))
    inverse = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(inverse @ curvature @ inverse.T)
    held = root @ vectors
    return (held * np.maximum(values, share)) @ held.T


def _elements(given: BoundaryResiduals) -> list[np.ndarray]:
    """Indices of the samples of each element in each camera."""
    _, number = np.unique(np.stack([given.camera, given.element]), axis=1, return_inverse=True)
    order = np.argsort(number.ravel(), kind="stable")
    return [part for part in np.split(order, np.cumsum(np.bincount(number.ravel()))[:-1]) if len(part)]


def _block(index: np.ndarray, given: BoundaryResiduals, weight: np.ndarray, config: SandwichConfig) -> _Block:
    uv, normal = given.uv[index].astype(np.float64), given.normal[index].astype(np.float64)
    apart = np.linalg.norm(uv[:, None] - uv[None], axis=-1)
    facing = np.maximum(normal @ normal.T, 0.0)
    bins = 1 + np.digitize(apart, config.bin_px)
    pair = np.outer(weight[index], weight[index]) * (facing > 0.5)
    np.fill_diagonal(bins, 0)
    np.fill_diagonal(pair, weight[index])
    parts = (np.eye(len(index)), *(facing * np.exp(-apart / length) for length in config.noise.length_px))
    return _Block(index, bins, pair, parts)
