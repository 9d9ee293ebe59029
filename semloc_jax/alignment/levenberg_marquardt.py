"""Levenberg-Marquardt on fused 6x6 normal equations, as an optimistix solver (room: alignment; pure JAX).

In: an AlignmentProblem as `args`, y0. Out: what optimistix.least_squares returns.
Optimistix keeps the trust region, the damped step, the loop, the status and the adjoint; we bring the evaluation. Its
own LM carries the whole Jacobian through the loop and, under vmap, selects over it at every step.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.alignment.problem import AlignmentProblem, prior_offset
from semloc_jax.residuals import native_kernels
from semloc_jax.residuals.chart import Chart
from semloc_jax.residuals.native_kernels import Path
from semloc_jax.residuals.normal_equations import chart_equations
from semloc_jax.residuals.robust import KERNELS


class QuadraticModel(eqx.Module):
    """Cost [nats], gradient and Hessian by y."""

    cost: Float[Array, ""]
    gradient: Float[Array, "6"]
    hessian: Float[Array, "6 6"]

    def info(self) -> optx.FunctionInfo.EvalGradHessian:
        """The same for optimistix."""
        operator = lx.MatrixLinearOperator(self.hessian, lx.positive_semidefinite_tag)
        return optx.FunctionInfo.EvalGradHessian(self.cost, self.gradient, operator)


def quadratic_model(
    y: Float[Array, "6"], problem: AlignmentProblem, skip: Bool[Array, ""] | bool = False
) -> QuadraticModel:
    """Cost, gradient and Gauss-Newton Hessian of half the squared norm of `residual`, fused.

    Where `skip` is True the result is not needed: of a batch, hypotheses that are done cost nothing.
    """
    evidence = chart_equations(
        Chart(problem.T_start, problem.sigma, y),
        problem.views,
        problem.texture,
        KERNELS[problem.kernel],
        problem.always,
        problem.path,
        skip,
    )
    deviation = y - prior_offset(problem)
    return QuadraticModel(
        problem.gain * evidence.cost + 0.5 * jnp.sum(deviation * deviation),
        problem.gain * evidence.gradient + deviation,
        problem.gain * evidence.hessian + jnp.eye(6, dtype=y.dtype),
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


class FusedLevenbergMarquardtState(eqx.Module):
    """Loop state: a few hundred bytes, whatever the number of points."""

    first_step: Bool[Array, ""]
    y_eval: Float[Array, "6"]
    model: QuadraticModel
    search: Any
    converged: Bool[Array, ""]
    num_accepted: Int[Array, ""]


class FusedLevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """Levenberg-Marquardt whose evaluation is `quadratic_model`; the rest is optimistix.

    A step is accepted when the cost falls; the solve ends when an accepted step is below `atol` in every direction
    [sigma of the prior].
    """

    atol: float
    rtol: float = 0.0
    norm: Callable[[Any], Array] = optx.max_norm
    search: optx.AbstractSearch = optx.ClassicalTrustRegion()

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        """State before the first evaluation."""
        zero = jnp.zeros((), y.dtype)
        model = QuadraticModel(zero, jnp.zeros_like(y), jnp.eye(6, dtype=y.dtype))
        return FusedLevenbergMarquardtState(
            jnp.array(True), y, model, self.search.init(y, model.info()), jnp.array(False), jnp.array(0)
        )

    def step(self, fn, y, args, options, state, tags):
        """One evaluation: judge the candidate, then propose the next."""
        candidate = quadratic_model(state.y_eval, args, state.converged)
        step_size, accept, _, search = self.search.step(
            state.first_step, y, state.y_eval, state.model.info(), candidate.info(), state.search
        )
        small = self.norm(state.y_eval - y) < self.atol
        y = jnp.where(accept, state.y_eval, y)
        model = _select(accept, candidate, state.model)
        state = FusedLevenbergMarquardtState(
            jnp.array(False),
            y + damped_step(model, step_size, args.path),
            model,
            search,
            small & jnp.invert(state.first_step),
            state.num_accepted + accept,
        )
        return y, state, None

    def terminate(self, fn, y, args, options, state, tags):
        """Whether the last step was small."""
        return state.converged, optx.RESULTS.successful

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        """The solution with its quadratic model."""
        return y, aux, {"model": state.model}


def _select(accept: Array, new: QuadraticModel, old: QuadraticModel) -> QuadraticModel:
    return QuadraticModel(
        jnp.where(accept, new.cost, old.cost),
        jnp.where(accept, new.gradient, old.gradient),
        jnp.where(accept, new.hessian, old.hessian),
    )
