"""Every step of a solve, to be looked at (room: alignment; pure JAX).

In: start pose, Evidence, Prior, a level. Out: LevelPath, what the solver evaluated, accepted and refused there.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.alignment.pose import (
    AlignConfig,
    Evidence,
    Prior,
    assess,
    level_problem,
    solve_config,
    visible_views,
)
from semloc_jax.alignment.problem import pose_of
from semloc_jax.geometry import lie
from semloc_jax.runtime.stored_program import stored_program
from semloc_jax.solvers.levenberg_marquardt import Iterate, advance, begin
from semloc_jax.structs import PoseEstimate, SolveStatus


class LevelPath(eqx.Module):
    """The evaluations of a solve on one level in their order; those after its end are not valid."""

    T_tried: Float[Array, "step 4 4"]
    """Pose that was evaluated."""
    T_held: Float[Array, "step 4 4"]
    """Pose that the solver holds after it: the one tried where it was accepted, else the last one accepted."""
    xi_held: Float[Array, "step 6"]
    """The same as a right tangent of `T_origin` [m, rad]."""
    cost: Float[Array, " step"]
    """Cost of evidence and prior at the held pose [nats]; those of two levels cannot be compared."""
    accepted: Bool[Array, " step"]
    valid: Bool[Array, " step"]
    converged: Bool[Array, ""]
    estimate: PoseEstimate
    """The pose at the end of the level, with its covariance there."""


@stored_program("config")
def trace_level(
    T_start: Float[Array, "4 4"],
    T_origin: Float[Array, "4 4"],
    level: Int[Array | np.ndarray, ""],
    max_steps: Int[Array | np.ndarray, ""],
    evidence: Evidence,
    prior: Prior,
    config: AlignConfig,
) -> LevelPath:
    """What `solve_level` does, step by step.

    Level and step limit are data: one program serves all of them, up to `config.max_steps` steps.

    Args:
        T_start: Start pose T_local_base relative to the local origin.
        T_origin: The pose that tangents are relative to.
        level: Level of the cost maps.
        max_steps: Most evaluations, at most `config.max_steps`.
        evidence, prior: As `solve_level`.
        config: As `solve_level`; its levels do not matter.
    """
    views = visible_views(T_start, evidence, config.border_px, config.path)
    problem = level_problem(T_start, views, level, evidence, prior, config)
    rule = solve_config(config)

    def step(state: Iterate, number: Array) -> tuple[Iterate, tuple[Array, ...]]:
        valid = ~state.ended & (number < max_steps)
        after = jax.tree.map(lambda new, old: jnp.where(valid, new, old), advance(problem, state, rule), state)
        accepted = valid & (after.num_accepted > state.num_accepted)
        return after, (state.candidate, after.value, after.equations.cost, accepted, valid)

    start = begin(problem, jnp.zeros(6, T_start.dtype), rule)
    end, (tried, held, cost, accepted, valid) = jax.lax.scan(step, start, jnp.arange(config.max_steps))
    T_tried, T_held = (jax.vmap(lambda y: pose_of(y, problem))(y) for y in (tried, held))
    xi_held = lie.log(lie.inverse(T_origin) @ T_held)
    estimate = assess(pose_of(end.value, problem), level, evidence, prior, config)
    converged = end.status == SolveStatus.CONVERGED
    return LevelPath(T_tried, T_held, xi_held, cost, accepted, valid, converged, estimate)
