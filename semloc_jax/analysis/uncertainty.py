"""The covariance of a pose whose residuals are correlated (room: analysis; JAX and host).

In: the evidence of one frame at its optimum. Out: sandwich covariance H^-1 M H^-1 with H the curvature of the robust
cost and M the covariance of its gradient.
Mask boundaries are displaced by a smooth field D(u, v): neighbours along one element are wrong together, both sides of
a stripe move the same way, and what displaces the whole image displaces every element. A residual is n . D with n the
normal of its contour: residuals i and j have the covariance (n_i . n_j) sum_k s_k exp(-d_ij / l_k). The variances s_k
are found in the residuals themselves by their variogram, corrected for what the fit of the pose has taken out of them.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.optimize import nnls

from semloc_jax.analysis.expected import contour_rows
from semloc_jax.cameras import Rig
from semloc_jax.geometry import lie
from semloc_jax.native.programs import stored_program
from semloc_jax.residuals.alignment import Usable, visibility
from semloc_jax.residuals.alignment import camera_views as group_views
from semloc_jax.residuals.robust import KERNELS
from semloc_jax.residuals.texture import RampTexture, lookup
from semloc_jax.solvers.pose import AlignConfig
from semloc_jax.structs import ViewSamples


@dataclass(frozen=True)
class SandwichConfig:
    """What is known of displaced boundaries before a frame is looked at. All values are ours."""

    length_px: tuple[float, ...] = (6.0, 20.0, 60.0, 200.0)
    """Lengths l_k over which the field changes."""
    variance_px2: tuple[float, ...] = (0.20, 0.005, 0.02, 0.002, 0.002)
    """Variances of a boundary: of its own pixel, then s_k; of masks as `datasets.synthetic.degrade` makes them. Their
    ratios count: the level is that of the frame."""
    believed: float = 1.0
    """How much these weigh against the variogram of one frame: each is known to 1 / sqrt(believed) of itself."""
    least_efficiency: float = 0.3
    """The curvature of the robust cost is at least this share of its Gauss-Newton matrix."""
    bin_px: tuple[float, ...] = (0.5, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0)
    """Limits of the distances of the variogram; farther pairs are its last bin."""


class BoundaryResiduals(NamedTuple):
    """Every boundary sample of one frame at its optimum, for one camera after the other."""

    slope: Float[Array, "n 6"]
    """Derivative of the distance across the contour by the right tangent [px/m, px/rad]."""
    distance_px: Float[Array, " n"]
    """From the contour of the map to the mask boundary, along the normal."""
    ramp: Float[Array, " n"]
    """The same as a share of the ramp, in [-1, 1]."""
    weight: Float[Array, " n"]
    """Independent observations over their variance [1/px^2]; 0 where nothing is seen."""
    uv: Float[Array, "n 2"]
    normal: Float[Array, "n 2"]
    camera: Int[Array, " n"]
    element: Int[Array, " n"]


@stored_program("align")
def boundary_residuals(
    T_map_base: Float[Array, "4 4"],
    rig: Rig,
    samples: ViewSamples,
    texture: RampTexture,
    usable: Usable,
    align: AlignConfig,
) -> BoundaryResiduals:
    """The residuals of all cameras at a pose.

    Args:
        T_map_base: Pose relative to the local origin.
        rig: Cameras of the masks.
        samples: The map as it is seen from there; see `residuals.view`.
        texture: The level of the cost maps on which the pose was found.
        usable: Usable pixels.
        align: Noise, correlation and border of the solve.
    """
    seen = jnp.zeros(samples.weight.shape, bool)
    for group in group_views(rig, samples):
        seen = seen.at[group.index].set(visibility(T_map_base, group, usable, align.border_px))
    parts = []
    for k, camera in enumerate(rig.cameras):
        camera = camera.astype(T_map_base.dtype)
        T_cam_base = lie.inverse(jnp.asarray(rig.T_base_cam[k], T_map_base.dtype))
        slope, u, v = contour_rows(T_map_base, T_cam_base, camera, samples.p_map[k], samples.tangent_map[k])
        normal = _normal(T_map_base, T_cam_base, camera, samples.p_map[k], samples.tangent_map[k])
        image = texture.image_index(jnp.asarray(k), samples.channel[k])
        ramp, rise = jax.jvp(lambda u, v, image=image: lookup(texture, image, u, v), (u, v), tuple(normal))
        weight = jnp.where(seen[k], samples.weight[k], 0.0) / (align.noise_px**2 * align.correlation_px)
        signed = jnp.where(rise >= 0, ramp, -ramp)
        number = jnp.full(u.shape, k)
        uv = jnp.stack([u, v], axis=-1)
        row = (slope.T, texture.ramp_px * signed, signed, weight, uv, normal.T, number, samples.element[k])
        parts.append(row)
    return BoundaryResiduals(*(jnp.concatenate(column) for column in zip(*parts, strict=True)))


def _normal(T_map_base: Array, T_cam_base: Array, camera, p_map: Array, tangent_map: Array) -> Float[Array, "2 p"]:
    """Unit normal of each contour in the image, the one that `contour_rows` measures along."""
    T_cam_map = T_cam_base @ lie.inverse(T_map_base)
    points = tuple(T_cam_map[:3, :3] @ p_map + T_cam_map[:3, 3:])
    along = tuple(T_cam_map[:3, :3] @ tangent_map)
    _, (du, dv) = jax.jvp(lambda *p: camera.project_xyz(*p)[:2], points, along)
    length = jnp.sqrt(du * du + dv * dv + 1e-12)
    return jnp.stack([-dv / length, du / length])


class Sandwich(NamedTuple):
    """What the residuals of one frame say of its pose.

    Attributes:
        covariance: of the right tangent [m, rad], residual correlation taken into account.
        naive: inverse of the information that the solver assumes, one observation each `correlation_px`.
        variance_px2: of a boundary: of its own pixel, then by length; see `SandwichConfig`.
    """

    covariance: Float[np.ndarray, "6 6"]
    naive: Float[np.ndarray, "6 6"]
    variance_px2: Float[np.ndarray, " component"]


def sandwich_covariance(
    residuals: BoundaryResiduals, prior_sigma: Float[np.ndarray, "6"], config: SandwichConfig | None = None
) -> Sandwich:
    """The covariance of a pose from the residuals at its optimum.

    Args:
        residuals: Of `boundary_residuals`.
        prior_sigma: Standard deviations of the prior (x, y, z [m], roll, pitch, yaw [rad]).
        config: None for the defaults.
    """
    config = config or SandwichConfig()
    model = _Model.of(residuals, np.asarray(prior_sigma, np.float64), config)
    variance = fitted_variances(*model.variogram(), config)
    return model.sandwich(variance)


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
    belief = np.array(config.variance_px2)
    belief = belief * max(found[0] / (design[0] @ belief), 1e-3)
    rows = design / spread[:, None]
    sure = np.sqrt(config.believed) / belief
    everything = np.concatenate([rows, np.diag(sure)])
    return nnls(everything, np.concatenate([found / spread, sure * belief]))[0]


@dataclass(frozen=True)
class _Model:
    """Matrices of one frame, whitened by the prior."""

    rows: np.ndarray
    score: np.ndarray
    weight: np.ndarray
    inverse: np.ndarray
    naive: np.ndarray
    parts: tuple[np.ndarray, ...]
    """Covariance of the residuals for a variance of 1, for each component."""
    moved: np.ndarray
    fit: np.ndarray
    bins: np.ndarray
    cosine: np.ndarray
    sigma: np.ndarray
    num_bins: int

    @classmethod
    def of(cls, residuals: BoundaryResiduals, sigma: np.ndarray, config: SandwichConfig) -> "_Model":
        given = [np.asarray(leaf) for leaf in residuals]
        used = given[3] > 0
        slope, distance, ramp, weight, uv, normal, camera, _ = (leaf[used] for leaf in given)
        rows, weight = slope.astype(np.float64) * sigma, weight.astype(np.float64)
        held = np.asarray(KERNELS["tukey"].weight(jnp.asarray(ramp)), np.float64)
        bent = (1 - ramp.astype(np.float64) ** 2) * (1 - 5 * ramp.astype(np.float64) ** 2)
        efficiency = max(np.sum(weight * bent) / max(np.sum(weight * held), 1e-12), config.least_efficiency)
        information = (rows.T * (weight * held)) @ rows
        inverse = np.linalg.inv(efficiency * information + np.eye(6))
        naive = np.linalg.inv(information + np.eye(6))
        apart = np.linalg.norm(uv[:, None] - uv[None], axis=-1)
        same = camera[:, None] == camera
        cosine = np.where(same, normal @ normal.T, 0.0)
        parts = (np.eye(len(uv)), *(cosine * np.exp(-apart / length) for length in config.length_px))
        bins = np.digitize(apart, config.bin_px)
        np.fill_diagonal(bins, 0)
        # An error e moves the pose by fit @ e, which leaves e - moved @ (fit @ e) in the residuals.
        moved, fit = bent[:, None] * rows, inverse @ (rows.T * weight)
        score = held * distance.astype(np.float64)
        return cls(rows, score, weight, inverse, naive, parts, moved, fit, bins, cosine, sigma, len(config.bin_px) + 1)

    def variogram(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Sums of products of residuals by distance, what each component would give, and their spread."""
        pair = self.weight[:, None] * self.weight * self.cosine
        flat, label = pair.ravel(), self.bins.ravel()

        def summed(matrix: np.ndarray) -> np.ndarray:
            return np.bincount(label, flat * matrix.ravel(), self.num_bins)

        design = []
        for part in self.parts:
            left = part - self.moved @ (self.fit @ part)
            design.append(summed(left - (left @ self.fit.T) @ self.moved.T))
        found = summed(np.outer(self.score, self.score))
        scale = np.average(self.score**2, weights=self.weight)
        spread = scale * np.sqrt(np.bincount(label, flat**2, self.num_bins)) + 1e-12
        return found, np.stack(design, axis=1), np.maximum(spread, 1e-3 * spread.max())

    def sandwich(self, variance: np.ndarray) -> Sandwich:
        """The covariance with these variances."""
        pull = self.rows * self.weight[:, None]
        meat = sum(s * (pull.T @ part @ pull) for s, part in zip(variance, self.parts, strict=True))
        # The road under the vehicle scatters as the prior says.
        meat = meat + np.eye(6)
        scale = np.outer(self.sigma, self.sigma)
        return Sandwich(scale * (self.inverse @ meat @ self.inverse), scale * self.naive, variance)
