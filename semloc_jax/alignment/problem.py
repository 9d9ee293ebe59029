"""One alignment problem as data: chart, prior, evidence (room: alignment; pure JAX).

In: start pose, prior, views, texture, weights. Out: AlignmentProblem and `residual`, the one function of (y, problem).
The unknown y is the right tangent of the start pose in units of the prior's sigmas: T_map_base = T_start exp(sigma y).
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from semloc_jax.residuals.alignment import CameraViews, alignment_residual
from semloc_jax.residuals.chart import Chart
from semloc_jax.residuals.native_kernels import Path
from semloc_jax.residuals.robust import KERNELS, robust_root
from semloc_jax.residuals.texture import RampTexture


class AlignmentProblem(eqx.Module):
    """Everything that one solve at one level of the cost maps needs."""

    T_start: Float[Array, "4 4"]
    """Origin of the chart, relative to the local origin."""
    xi_prior: Float[Array, "6"]
    """Centre of the prior in the chart [m, rad]."""
    sigma: Float[Array, "6"]
    """Standard deviations of the prior along the tangent [m, rad]; 0 locks a direction."""
    views: tuple[CameraViews, ...]
    texture: RampTexture
    gain: Float[Array, ""]
    """Independent observations for each unit of sample weight x (ramp / boundary noise)^2: turns rho into nats."""
    always: Bool[Array, "2"]
    """True; see `semloc_jax.residuals.fusion_barrier`."""
    kernel: str = eqx.field(static=True, default="tukey")
    path: Path = eqx.field(static=True, default="auto")
    """How the evidence is evaluated; see `semloc_jax.residuals.native_kernels`."""


def pose_of(y: Float[Array, "6"], problem: AlignmentProblem) -> Float[Array, "4 4"]:
    """T_map_base of a scaled tangent y."""
    return Chart(problem.T_start, problem.sigma, y).pose()


def prior_offset(problem: AlignmentProblem) -> Float[Array, "6"]:
    """Centre of the prior in units of y; 0 in locked directions."""
    free = problem.sigma > 0
    return jnp.where(free, problem.xi_prior / jnp.where(free, problem.sigma, 1.0), 0.0)


def residual(y: Float[Array, "6"], problem: AlignmentProblem) -> Float[Array, " n"]:
    """Whitened residuals of the evidence and of the prior; half their squared norm is the cost in nats.

    The solver works with the fused normal equations of the same cost; this definition is what they are tested against
    and what implicit derivatives go through.
    """
    r, weight = alignment_residual(pose_of(y, problem), problem.views, problem.texture)
    evidence = jnp.sqrt(problem.gain * weight) * robust_root(r, KERNELS[problem.kernel])
    return jnp.concatenate([evidence, y - prior_offset(problem)])
