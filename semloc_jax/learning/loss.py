"""How well an estimated pose foretells the true one (room: learning; JAX).

In: Parameters, a TrainingFrame. Out: its negative log-likelihood, differentiable by the parameters.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from semloc_jax.alignment.implicit import SmoothConfig, SmoothEstimate, smooth_optimum
from semloc_jax.geometry import lie
from semloc_jax.learning.config import LearningConfig
from semloc_jax.learning.parameters import Parameters
from semloc_jax.learning.scenes import TrainingFrame
from semloc_jax.structs import SolveStatus

POLISH = SmoothConfig()
"""How exact a solve is before its derivative is taken; learning never needed it otherwise."""

PLANAR = np.array([0, 1, 5])
"""Longitudinal, lateral, heading: the directions that count for a vehicle; height and tilt follow from the road."""


class FrameScore(eqx.Module):
    """How one frame went."""

    error: Float[Array, "3"]
    """Estimate less truth along and across [m] and in heading [rad], in the vehicle frame of the truth."""
    covariance: Float[Array, "3 3"]
    nll: Float[Array, ""]
    """Negative log-likelihood of the truth, without the constant."""
    nees: Float[Array, ""]
    """Normalised squared error for each of the three: 1 on average where covariances are right."""
    used: Bool[Array, ""]
    """Whether the solve ended well."""


def pose_nll(
    error: Float[Array, "*b 3"], covariance: Float[Array, "*b 3 3"]
) -> tuple[Float[Array, "*b"], Float[Array, "*b"]]:
    """0.5 e^T S^-1 e + 0.5 log det S, and the normalised squared error for each direction."""
    root = jnp.linalg.cholesky(covariance)
    whitened = jax.scipy.linalg.solve_triangular(root, error[..., None], lower=True)[..., 0]
    squared = jnp.sum(whitened * whitened, axis=-1)
    log_det = 2 * jnp.sum(jnp.log(jnp.diagonal(root, axis1=-2, axis2=-1)), axis=-1)
    return 0.5 * squared + 0.5 * log_det, squared / error.shape[-1]


def solved(parameters: Parameters, frame: TrainingFrame, config: LearningConfig) -> SmoothEstimate:
    """The pose of a frame, from where the fast solve ended: which optimum it is, is decided there; where it lies is
    learned."""
    model, nats_per_px = parameters.model(frame.place, config)
    scene = eqx.tree_at(lambda s: (s.model, s.nats_per_px), frame.scene, (model, nats_per_px))
    return smooth_optimum(frame.T_start, scene, parameters.road(frame.prior), POLISH)


def frame_score(parameters: Parameters, frame: TrainingFrame, config: LearningConfig) -> FrameScore:
    """Error, covariance and likelihood of a frame."""
    return scored(solved(parameters, frame, config), frame.T_true)


def scored(estimate: SmoothEstimate, T_true: Float[Array, "4 4"], doubt: Array | float = 0.0) -> FrameScore:
    """Error, covariance and likelihood of an estimate.

    Args:
        estimate: With its covariance.
        T_true: True pose.
        doubt: Covariance of the true pose along and across [m] and in heading [rad], where it was measured.
    """
    error = lie.log(lie.compose(lie.inverse(T_true), estimate.T_local_base))[PLANAR]
    covariance = estimate.covariance[PLANAR][:, PLANAR] + doubt
    nll, nees = pose_nll(error, covariance)
    used = (estimate.status == SolveStatus.CONVERGED) & jnp.isfinite(nll)
    return FrameScore(error, covariance, nll, nees, used)


def heavy_tailed_nll(score: FrameScore, dof: float) -> Array:
    """0.5 (n + d) log(1 + e^T S^-1 e / n) + 0.5 log det S: Student's distribution of n degrees of freedom in d = 3
    directions, without the constant. With many degrees of freedom it is the normal one."""
    num = score.error.shape[-1]
    squared = num * score.nees
    half_log_det = score.nll - 0.5 * squared
    return 0.5 * (dof + num) * jnp.log1p(squared / dof) + half_log_det


def frame_loss(parameters: Parameters, frame: TrainingFrame, config: LearningConfig) -> tuple[Array, FrameScore]:
    """The heavy-tailed likelihood of a frame, `used` or not: one that comes and goes would be a step in the loss."""
    score = frame_score(parameters, frame, config)
    loss = heavy_tailed_nll(score, config.tail_dof)
    return jnp.where(jnp.isfinite(loss), loss, 0.0), score
