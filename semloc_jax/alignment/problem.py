"""One alignment problem as data: chart, prior, evidence (room: alignment; pure JAX).

In: start pose, prior, views, texture, weights. Out: AlignmentProblem, its residual and its fused normal equations.
The unknown y is the right tangent of the start pose in units of the prior's sigmas:
T_local_base = T_start exp(sigma y).
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from semloc_jax.residuals import native_kernels
from semloc_jax.residuals.alignment import CameraViews, alignment_residual
from semloc_jax.residuals.chart import Chart
from semloc_jax.residuals.native_kernels import Path
from semloc_jax.residuals.normal_equations import chart_equations
from semloc_jax.residuals.pose_terms import Terms, terms_equations, terms_residual
from semloc_jax.residuals.robust import LOSSES, robust_root
from semloc_jax.residuals.texture import RampTexture
from semloc_jax.solvers.levenberg_marquardt import Damping
from semloc_jax.solvers.problem import Step

POSE_DAMPING = Damping(first=1.0, good_fall=0.99, ease=1 / 3.5, press=4.0)
"""In sigmas of the prior. The first steps of a single pose must not leave the ramps, so the damping starts at the prior
and is eased slowly (constants of Gould, Orban, Sartenaer, Toint, Sensitivity of trust-region algorithms, 2005)."""


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
    loss: str = eqx.field(static=True, default="tukey")
    path: Path = eqx.field(static=True, default="auto")
    """How the evidence is evaluated; see `semloc_jax.residuals.native_kernels`."""
    terms: Terms = ()
    """What else is known of the pose, see `semloc_jax.residuals.pose_terms`; relative to the local origin."""

    def linearise(self, value: Float[Array, "6"], skip: Bool[Array, ""]) -> "QuadraticModel":
        """Fused normal equations at y. Of a batch of hypotheses, those that are done cost nothing."""
        return quadratic_model(value, self, skip)

    def step(self, equations: "QuadraticModel", damping: Float[Array, ""]) -> Step:
        """The damped step; the unit of every coordinate is a sigma of the prior."""
        d = damped_step(equations, 1 / damping, self.path)
        change = jnp.sum(d * (equations.gradient + 0.5 * (equations.hessian @ d)))
        return Step(d, change, jnp.max(jnp.abs(d)))

    def retract(self, value: Float[Array, "6"], tangent: Float[Array, "6"]) -> Float[Array, "6"]:
        """y after a step: the chart is flat."""
        return value + tangent


class QuadraticModel(eqx.Module):
    """Cost [nats], gradient and Hessian by y."""

    cost: Float[Array, ""]
    gradient: Float[Array, "6"]
    hessian: Float[Array, "6 6"]


def pose_of(y: Float[Array, "6"], problem: AlignmentProblem) -> Float[Array, "4 4"]:
    """T_local_base of a scaled tangent y."""
    return Chart(problem.T_start, problem.sigma, y).pose()


def prior_offset(problem: AlignmentProblem) -> Float[Array, "6"]:
    """Centre of the prior in units of y; 0 in locked directions."""
    free = problem.sigma > 0
    return jnp.where(free, problem.xi_prior / jnp.where(free, problem.sigma, 1.0), 0.0)


def residual(y: Float[Array, "6"], problem: AlignmentProblem) -> Float[Array, " n"]:
    """Whitened residuals of the evidence, of the prior and of the terms; half their squared norm is the cost in nats.

    The solver works with the fused normal equations of the same cost; this definition is what they are tested against
    and what implicit derivatives go through.
    """
    T_local_base = pose_of(y, problem)
    r, weight = alignment_residual(T_local_base, problem.views, problem.texture)
    evidence = jnp.sqrt(problem.gain * weight) * robust_root(r, LOSSES[problem.loss])
    return jnp.concatenate([evidence, y - prior_offset(problem), terms_residual(problem.terms, T_local_base)])


def quadratic_model(
    y: Float[Array, "6"], problem: AlignmentProblem, skip: Bool[Array, ""] | bool = False
) -> QuadraticModel:
    """Cost, gradient and Gauss-Newton Hessian of half the squared norm of `residual`, fused.

    Where `skip` is True the result is not needed: of a batch, hypotheses that are done cost nothing.
    """
    chart = Chart(problem.T_start, problem.sigma, y)
    evidence = chart_equations(
        chart,
        problem.views,
        problem.texture,
        LOSSES[problem.loss],
        problem.path,
        skip,
    )
    known = known_model(y, problem)
    return QuadraticModel(
        problem.gain * evidence.cost + known.cost,
        problem.gain * evidence.gradient + known.gradient,
        problem.gain * evidence.hessian + known.hessian,
    )


def known_model(y: Float[Array, "6"], problem: AlignmentProblem) -> QuadraticModel:
    """The part of `quadratic_model` that the masks have no share in: the prior and the terms."""
    deviation = y - prior_offset(problem)
    known = QuadraticModel(0.5 * jnp.sum(deviation * deviation), deviation, jnp.eye(6, dtype=y.dtype))
    if not problem.terms:
        return known
    chart = Chart(problem.T_start, problem.sigma, y)
    terms, J = terms_equations(problem.terms, chart.pose()), chart.jacobian()
    return QuadraticModel(
        known.cost + terms.cost, known.gradient + J.T @ terms.gradient, known.hessian + J.T @ terms.hessian @ J
    )


def damped_step(model: QuadraticModel, step_size: Float[Array, ""], path: Path = "auto") -> Float[Array, "6"]:
    """Solution d of (H + I / step_size) d = -g.

    The matrix is at least the identity, so no pivoting is needed. A library call would be made for each of a batch of
    problems; Gauss-Jordan elimination, unrolled, vectorises over the batch.
    """
    if native_kernels.are_used(path, model.gradient.dtype):
        return native_kernels.damped_step(model.hessian, model.gradient, step_size)
    num = model.gradient.shape[0]
    damped = model.hessian + jnp.eye(num, dtype=model.hessian.dtype) / step_size
    rows = jnp.concatenate([damped, -model.gradient[:, None]], axis=1)
    for k in range(num):
        pivot = rows[k] / rows[k, k]
        rows = jnp.where((np.arange(num) == k)[:, None], pivot, rows - rows[:, k : k + 1] * pivot)
    return rows[:, num]
