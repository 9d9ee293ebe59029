"""The posterior of a pose as a mixture over its modes (room: analysis; host).

In: modes of a localized frame with their scores and covariances. Out: PoseMixture: density, moments, intervals.
Laplace's rule: the mass of a mode is its density exp(-score) times its volume sqrt(det 2 pi C). A broad mode that fits
a little worse may hold more of the posterior than a sharp one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp, ndtr

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.analysis.uncertainty import SandwichConfig, pose_residuals, sandwich_covariance
from semloc_jax.cameras import Rig
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid


@dataclass(frozen=True)
class PoseMixture:
    """Gaussians in the right tangents of several poses, heaviest first.

    Attributes:
        weight: share of each mode, all sum to 1.
        Ts_map_base: their poses.
        covariance: of each, (x, y, z [m], roll, pitch, yaw [rad]).
    """

    weight: Float[np.ndarray, " mode"]
    Ts_map_base: Float[np.ndarray, "mode 4 4"]
    covariance: Float[np.ndarray, "mode 6 6"]

    def about_best(self) -> tuple[Float[np.ndarray, "mode 6"], Float[np.ndarray, "mode 6 6"]]:
        """Means and covariances of all modes in the right tangent of the first."""
        means, covariances = [], []
        for T, C in zip(self.Ts_map_base, self.covariance, strict=True):
            D = rigid.inverse(self.Ts_map_base[0]) @ T
            turn = np.kron(np.eye(2), D[:3, :3])
            means.append(rigid.log(D))
            covariances.append(turn @ C @ turn.T)
        return np.stack(means), np.stack(covariances)

    def moments(self) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6 6"]]:
        """Mean and covariance of the whole mixture in the right tangent of the first mode."""
        means, covariances = self.about_best()
        mean = self.weight @ means
        away = means - mean
        spread = np.einsum("k,ki,kj->ij", self.weight, away, away)
        return mean, np.einsum("k,kij->ij", self.weight, covariances) + spread

    def interval(self, direction: int, probability: float) -> tuple[float, float]:
        """Ends between which one coordinate of the right tangent of the first mode lies with a probability [m, rad].

        Args:
            direction: 0 longitudinal, 1 lateral, 5 heading.
            probability: In (0, 1); the rest is in two equal tails.

        Raises:
            SemlocError: another probability.
        """
        if not 0 < probability < 1:
            raise SemlocError(
                f"interval with probability {probability}; expected a number between 0 and 1, such as 0.95"
            )
        means, covariances = self.about_best()
        mean, sigma = means[:, direction], np.sqrt(covariances[:, direction, direction])

        def quantile(share: float) -> float:
            low, high = float(np.min(mean - 9 * sigma)), float(np.max(mean + 9 * sigma))
            for _ in range(80):
                middle = 0.5 * (low + high)
                below = self.weight @ ndtr((middle - mean) / sigma) < share
                low, high = (middle, high) if below else (low, middle)
            return 0.5 * (low + high)

        return quantile(0.5 - 0.5 * probability), quantile(0.5 + 0.5 * probability)


def laplace_mixture(
    score: Sequence[float] | np.ndarray,
    Ts_map_base: Float[np.ndarray, "mode 4 4"],
    covariance: Float[np.ndarray, "mode 6 6"],
) -> PoseMixture:
    """The mixture of modes by Laplace's rule.

    Args:
        score: Cost of each mode [nats].
        Ts_map_base: Their poses.
        covariance: Of their right tangents.

    Raises:
        SemlocError: no modes.
    """
    if not len(score):
        raise SemlocError("mixture of no modes; expected at least one pose that explains the masks")
    log_mass = 0.5 * np.linalg.slogdet(covariance)[1] - np.asarray(score, np.float64)
    order = np.argsort(-log_mass, kind="stable")
    weight = np.exp(log_mass - logsumexp(log_mass))
    return PoseMixture(weight[order], np.asarray(Ts_map_base)[order], np.asarray(covariance)[order])


def frame_mixture(
    localizer: FrameLocalizer,
    result: LocalizationResult,
    masks: Sequence[np.ndarray],
    rig: Rig,
    prior_sigma: Float[np.ndarray, "6"],
    config: SandwichConfig | None = None,
) -> PoseMixture:
    """The posterior of a localized frame: its modes with their weights and with sandwich covariances.

    Args:
        localizer: That localized it.
        result: What it said.
        masks: Class ids of every camera.
        rig: Cameras of the masks.
        prior_sigma: Standard deviations of the prior (x, y, z [m], roll, pitch, yaw [rad]).
        config: None for the defaults.

    Raises:
        SemlocError: the result has no modes.
    """
    inputs, local_map = localizer.prepare(masks, rig, result.T_map_prior)
    settings = localizer.config.frame
    covariances = []
    for mode in result.modes:
        T_local_base = jnp.asarray(local_map.frame.from_map(mode.T_map_base))
        residuals = pose_residuals(T_local_base, inputs, settings)
        covariances.append(sandwich_covariance(residuals, prior_sigma, config).covariance)
    if not covariances:
        raise SemlocError(f"frame {result.frame.id}: no pose explains the masks, so there is no posterior")
    # By the verdict: the costs of a search do not weigh its places against each other.
    weight = np.array([mode.weight for mode in result.modes])
    order = np.argsort(-weight, kind="stable")
    poses = np.stack([mode.T_map_base for mode in result.modes])
    return PoseMixture(weight[order] / weight.sum(), poses[order], np.stack(covariances)[order])
