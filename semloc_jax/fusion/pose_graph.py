"""Many poses at once: measured poses, motion between them, satellite fixes, one calibration (room: fusion; pure JAX).

In: PoseGraph of fixed capacity. Out: PoseGraphSolution: poses, calibration and their joint information.
The normal equations are dense: made for tens of poses. Where they span more than some metres, use float64.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.geometry import lie
from semloc_jax.residuals.motion import (
    fix_linearised,
    fix_residual,
    odometry_linearised,
    odometry_residual,
    pose_linearised,
    pose_residual,
    robust_cost,
)

TANGENT_UNIT = np.array([0.1, 0.1, 0.1, 0.01, 0.01, 0.01])
"""Scale of the damping [m, rad]; ours."""
CALIBRATION_UNIT = np.array([0.01, 0.002, 1.0, 1.0])
"""Scale of odometer scale, gyroscope bias [rad/s], GNSS offset [m]; ours."""


class PoseGraph(eqx.Module):
    """Poses and what was measured about them; a factor with `sqrt_info` 0 is not there."""

    T_map_base: Float[Array | np.ndarray, "n 4 4"]
    """Start poses; relative to a local origin where the float type is float32."""
    calibration: Float[Array | np.ndarray, "4"]
    """Odometer scale, gyroscope bias [rad/s], GNSS-to-map offset east, north [m]."""
    used: Bool[Array | np.ndarray, " n"]
    """False for padding."""
    T_measured: Float[Array | np.ndarray, "n 4 4"]
    pose_sqrt_info: Float[Array | np.ndarray, "n 6 6"]
    edge_from: Int[Array | np.ndarray, " e"]
    edge_to: Int[Array | np.ndarray, " e"]
    T_edge: Float[Array | np.ndarray, "e 4 4"]
    """T_from_to of every edge."""
    edge_sqrt_info: Float[Array | np.ndarray, "e 6 6"]
    edge_jacobian: Float[Array | np.ndarray, "e 6 2"]
    """Derivative of T_from_to by odometer scale and gyroscope bias; 0 for a loop closure."""
    edge_calibration: Float[Array | np.ndarray, "e 2"]
    """Scale and bias that the edge was made with."""
    edge_robust: Bool[Array | np.ndarray, " e"]
    """True for edges that may be wrong, such as loop closures."""
    p_fix: Float[Array | np.ndarray, "n 2"]
    fix_sqrt_info: Float[Array | np.ndarray, "n 2"]
    """1 / sigma of east and north [1/m]."""
    fix_base: Float[Array | np.ndarray, "n 3"]
    """The point of the vehicle, in the frame of its pose, that the fix saw."""
    T_prior: Float[Array | np.ndarray, "4 4"]
    """What is known of the first pose and of the calibration beside the factors."""
    calibration_prior: Float[Array | np.ndarray, "4"]
    prior_sqrt_info: Float[Array | np.ndarray, "10 10"]


class PoseGraphSolution(eqx.Module):
    """Poses and calibration with the quadratic model of the cost there; its inverse information is the covariance."""

    T_map_base: Float[Array, "n 4 4"]
    calibration: Float[Array, "4"]
    equations: "NormalEquations"
    num_steps: Int[Array, ""]
    converged: Bool[Array, ""]


@dataclass(frozen=True)
class GraphConfig:
    """How a pose graph is solved. All values are ours."""

    pose_threshold: float = 4.0
    """Norm of a whitened pose difference (6 numbers) beyond which its pull grows no more."""
    fix_threshold: float = 2.0
    edge_threshold: float = 3.0
    tolerance: float = 1e-3
    """A solve ends when a step is below this, in units of `TANGENT_UNIT` and `CALIBRATION_UNIT`."""
    max_steps: int = 20


class NormalEquations(eqx.Module):
    """Quadratic model of the cost: cost + gradient x + 0.5 x^T information x, x in metres, radians, units."""

    cost: Float[Array, ""]
    gradient: Float[Array, " d"]
    information: Float[Array, "d d"]


def solve_pose_graph(graph: PoseGraph, config: GraphConfig) -> PoseGraphSolution:
    """The most likely poses and calibration, by Levenberg-Marquardt from the start poses."""
    solution = optx.least_squares(
        lambda y, args: graph_residuals(*y, args[0]),
        _GraphLevenbergMarquardt(atol=config.tolerance),
        (graph.T_map_base, graph.calibration),
        args=(graph, config),
        max_steps=config.max_steps,
        throw=False,
    )
    Ts, calibration = solution.value
    equations = solution.stats["equations"]
    return PoseGraphSolution(
        Ts,
        calibration,
        equations,
        solution.stats["num_steps"],
        solution.result == optx.RESULTS.successful,
    )


class _State(eqx.Module):
    candidate: tuple[Array, Array]
    step_length: Float[Array, ""]
    damping: Float[Array, ""]
    equations: NormalEquations
    first: Bool[Array, ""]
    converged: Bool[Array, ""]


class _GraphLevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """Levenberg-Marquardt on the manifold: every evaluation is `linearise` at the candidate, in its own chart."""

    atol: float
    rtol: float = 0.0
    norm: Callable[[Any], Array] = optx.max_norm

    def init(self, fn, y, args, options, f_struct, aux_struct, tags):
        """State before the first evaluation."""
        zero = jnp.zeros((), y[1].dtype)
        unit = _units(args[0])
        unknown = NormalEquations(zero, jnp.zeros_like(unit), jnp.diag(unit))
        return _State(y, zero, zero + 1e-4, unknown, jnp.array(True), jnp.array(False))

    def step(self, fn, y, args, options, state, tags):
        """One evaluation: judge the candidate, then propose the next."""
        graph, config = args
        candidate = linearise(*state.candidate, graph, config)
        worst = state.equations.cost * (1 + 1e-9) + 1e-9
        accept = state.first | (candidate.cost <= worst)
        y, equations = jax.tree.map(
            lambda new, old: jnp.where(accept, new, old), (state.candidate, candidate), (y, state.equations)
        )
        damping = jnp.where(accept, 0.1 * state.damping, 10.0 * state.damping)
        unit = _units(graph)
        damped = unit[:, None] * equations.information * unit + damping * jnp.eye(len(unit), dtype=unit.dtype)
        scaled = -jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(damped), unit * equations.gradient)
        converged = accept & ~state.first & (state.step_length < self.atol)
        moved = _moved(*y, unit * scaled)
        return y, _State(moved, self.norm(scaled), damping, equations, jnp.array(False), converged), None

    def terminate(self, fn, y, args, options, state, tags):
        """Whether the last accepted step was small."""
        return state.converged, optx.RESULTS.successful

    def postprocess(self, fn, y, aux, args, options, state, tags, result):
        """The solution with its normal equations."""
        return y, aux, {"equations": state.equations}


def marginal(equations: NormalEquations, gone: Int[np.ndarray, " g"], kept: Int[np.ndarray, " k"]) -> NormalEquations:
    """What the equations say of the `kept` unknowns when the `gone` ones are free: the Schur complement."""
    H, g = equations.information, equations.gradient
    across = jnp.linalg.solve(H[np.ix_(gone, gone)], jnp.concatenate([H[np.ix_(gone, kept)], g[gone, None]], axis=1))
    back = _mul(H[np.ix_(kept, gone)], across)
    # The cost at the best value of what is gone.
    cost = equations.cost - 0.5 * _mul(g[gone], across[:, -1])
    return NormalEquations(cost, g[kept] - back[:, -1], H[np.ix_(kept, kept)] - back[:, :-1])


def linearise(
    Ts: Float[Array, "n 4 4"], calibration: Float[Array, "4"], graph: PoseGraph, config: GraphConfig
) -> NormalEquations:
    """Cost and normal equations at given poses; robust factors are weighted as they lie there.

    Unknowns are the right tangents of pose 0, 1, ... and the calibration. Padding has unit information.
    """
    num = Ts.shape[0]
    at_pose = jnp.eye(num, dtype=Ts.dtype)
    poses, J_poses = jax.vmap(pose_linearised)(Ts, graph.T_measured, graph.pose_sqrt_info)
    edges, J_from, J_to, J_calibration = jax.vmap(odometry_linearised)(*_edges(Ts, calibration, graph))
    fixes, J_fixes, J_offset = jax.vmap(fix_linearised, in_axes=(0, None, 0, 0, 0))(
        Ts, calibration[2:], graph.fix_base, graph.p_fix, graph.fix_sqrt_info
    )
    J_edges = _placed(J_from, at_pose[graph.edge_from]) + _placed(J_to, at_pose[graph.edge_to])
    no_calibration = jnp.zeros((num, 6, 4), Ts.dtype)
    by_motion = jnp.pad(J_calibration, ((0, 0), (0, 0), (0, 2)))
    by_offset = jnp.pad(J_offset, ((0, 0), (0, 0), (2, 0)))
    parts = [
        _weighed(poses, _placed(J_poses, at_pose), no_calibration, config.pose_threshold, graph.used),
        _weighed(edges, J_edges, by_motion, config.edge_threshold, graph.edge_robust),
        _weighed(fixes, _placed(J_fixes, at_pose), by_offset, config.fix_threshold, graph.used),
        _prior(Ts, calibration, graph),
    ]
    cost = sum(part[0] for part in parts)
    r, J = (jnp.concatenate(rows) for rows in zip(*(part[1:] for part in parts), strict=True))
    padding = jnp.repeat(~graph.used, 6).astype(Ts.dtype)
    return NormalEquations(cost, _mul(J.T, r), _mul(J.T, J) + jnp.diag(jnp.pad(padding, (0, 4))))


def graph_residuals(Ts: Float[Array, "n 4 4"], calibration: Float[Array, "4"], graph: PoseGraph) -> Float[Array, " m"]:
    """Whitened residuals of poses, edges, fixes and prior, before any kernel: what `linearise` is tested with."""
    poses = jax.vmap(pose_residual)(Ts, graph.T_measured, graph.pose_sqrt_info)
    edges = jax.vmap(odometry_residual)(*_edges(Ts, calibration, graph))
    fixes = jax.vmap(fix_residual, in_axes=(0, None, 0, 0, 0))(
        Ts, calibration[2:], graph.fix_base, graph.p_fix, graph.fix_sqrt_info
    )
    off = pose_residual(Ts[0], graph.T_prior, jnp.eye(6, dtype=Ts.dtype))
    prior = _mul(graph.prior_sqrt_info, jnp.concatenate([off, calibration - graph.calibration_prior]))
    return jnp.concatenate([part.ravel() for part in (poses, edges, fixes, prior)])


def _edges(Ts: Array, calibration: Array, graph: PoseGraph) -> tuple[Array, ...]:
    change = calibration[:2] - graph.edge_calibration
    return Ts[graph.edge_from], Ts[graph.edge_to], change, graph.T_edge, graph.edge_jacobian, graph.edge_sqrt_info


def _placed(J: Float[Array, "f k 6"], at_pose: Float[Array, "f n"]) -> Float[Array, "f k d"]:
    """Derivatives by one pose each, in the columns of that pose."""
    return jnp.einsum("fki,fn->fkni", J, at_pose).reshape(*J.shape[:2], -1)


def _weighed(
    r: Float[Array, "f k"],
    J_poses: Float[Array, "f k d"],
    J_calibration: Float[Array, "f k 4"],
    threshold: float,
    is_robust: Bool[Array, " f"],
) -> tuple[Float[Array, ""], Float[Array, " m"], Float[Array, "m c"]]:
    """Cost, residuals and derivatives of a family of factors with the weights of the robust kernel in them."""
    cost, weight = jax.vmap(robust_cost, in_axes=(0, None))(r, threshold)
    cost = jnp.where(is_robust, cost, 0.5 * jnp.sum(r * r, axis=1))
    weight = jnp.where(is_robust, weight, 1.0)[:, None]
    J = jnp.concatenate([J_poses, J_calibration], axis=-1)
    return jnp.sum(cost), (weight * r).ravel(), (weight[:, :, None] * J).reshape(r.size, -1)


def _prior(Ts: Array, calibration: Array, graph: PoseGraph) -> tuple[Array, Array, Array]:
    """Cost, residuals and derivatives of the prior on the first pose and the calibration."""
    off, J_pose = pose_linearised(Ts[0], graph.T_prior, jnp.eye(6, dtype=Ts.dtype))
    r = _mul(graph.prior_sqrt_info, jnp.concatenate([off, calibration - graph.calibration_prior]))
    between = jnp.zeros((10, 6 * (Ts.shape[0] - 1)), Ts.dtype)
    by_pose = _mul(graph.prior_sqrt_info[:, :6], J_pose)
    return 0.5 * jnp.sum(r * r), r, jnp.concatenate([by_pose, between, graph.prior_sqrt_info[:, 6:]], axis=1)


def _moved(Ts: Array, calibration: Array, x: Array) -> tuple[Array, Array]:
    """Poses and calibration after a step in their tangents."""
    return lie.compose(Ts, lie.exp(x[:-4].reshape(-1, 6))), calibration + x[-4:]


def _units(graph: PoseGraph) -> Float[Array, " d"]:
    num, dtype = graph.T_map_base.shape[0], graph.T_map_base.dtype
    return jnp.asarray(np.concatenate([np.tile(TANGENT_UNIT, num), CALIBRATION_UNIT]), dtype)


def _mul(A: Array, b: Array) -> Array:
    return jnp.matmul(A, b, precision=jax.lax.Precision.HIGHEST)
