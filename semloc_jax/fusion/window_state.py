"""State of the sliding window as fixed arrays, and the graph that they are (room: fusion; host).

In: poses, increments. Out: WindowState with or without a state, its FactorGraph and values.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from semloc_jax.fusion.pose_factors import GraphConfig, fixes, measured_poses, odometry, pose_graph, prior, values_of
from semloc_jax.fusion.prediction import MotionIncrement
from semloc_jax.fusion.window_terms import TermRows, factors_of, of_first_of_two
from semloc_jax.geometry import rigid
from semloc_jax.residuals.pose_terms import Terms
from semloc_jax.solvers.graph import FactorGraph, Values


class Motion(NamedTuple):
    """Motion between two states: transform, covariance, derivative by scale, bias and travel, those taken."""

    T: Float[np.ndarray, "*e 4 4"]
    covariance: Float[np.ndarray, "*e 6 6"]
    jacobian: Float[np.ndarray, "*e 6 3"]
    calibration: Float[np.ndarray, "*e 3"]


class WindowState(NamedTuple):
    """State of `SlidingWindow`: fixed arrays; states beyond `num` and factors with information 0 are not there."""

    num: Int[np.ndarray, ""]
    time_s: Float[np.ndarray, " n"]
    T_map_base: Float[np.ndarray, "n 4 4"]
    calibration: Float[np.ndarray, "5"]
    """Odometer scale, gyroscope bias [rad/s], direction of travel [rad], GNSS offset east, north [m]."""
    covariance: Float[np.ndarray, "11 11"]
    """Of the newest pose (right tangent) and the calibration."""
    T_measured: Float[np.ndarray, "n 4 4"]
    pose_sqrt_info: Float[np.ndarray, "n 6 6"]
    T_edge: Float[np.ndarray, "e 4 4"]
    edge_covariance: Float[np.ndarray, "e 6 6"]
    edge_jacobian: Float[np.ndarray, "e 6 3"]
    edge_calibration: Float[np.ndarray, "e 3"]
    p_fix: Float[np.ndarray, "n 2"]
    fix_sqrt_info: Float[np.ndarray, "n 2"]
    fix_base: Float[np.ndarray, "n 3"]
    T_prior: Float[np.ndarray, "4 4"]
    calibration_prior: Float[np.ndarray, "5"]
    prior_sqrt_info: Float[np.ndarray, "11 11"]
    now_s: Float[np.ndarray, ""]
    """Time up to which the vehicle was predicted beyond the newest state."""
    T_open: Float[np.ndarray, "4 4"]
    open_covariance: Float[np.ndarray, "6 6"]
    open_jacobian: Float[np.ndarray, "6 3"]
    open_calibration: Float[np.ndarray, "3"]
    terms: tuple[TermRows, ...] = ()
    """Cost terms of the user; see `window_terms`."""


BY_STATE = ("time_s", "T_map_base", "T_measured", "pose_sqrt_info", "p_fix", "fix_sqrt_info", "fix_base")
BY_EDGE = ("T_edge", "edge_covariance", "edge_jacobian", "edge_calibration")


def sqrt_information(covariance: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    """R with R^T R = covariance^-1: whitens a difference of this covariance.

    A wide one of nearly dependent directions, which rounding of float32 has left without a root, counts as ten times
    as open there as rounding is large.
    """
    scale = np.sqrt(np.diag(covariance))
    scaled = covariance / np.outer(scale, scale)
    try:
        return np.linalg.inv(np.linalg.cholesky(scaled)) / scale
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
        least = 10.0 * max(-float(values.min()), 1e-6)
        return (vectors / np.sqrt(np.maximum(values, least))).T / scale


def graph_of(state: WindowState, config: GraphConfig, kinds: Terms = ()) -> tuple[FactorGraph, Values]:
    """The factors of a window, and its values; `kinds` are those of its terms. Inside jit, too."""
    edges, num = len(state.T_edge), state.num
    is_used, is_edge = jnp.arange(edges + 1) < num, jnp.arange(edges) < num - 1
    edge_sqrt_info = jnp.linalg.inv(jnp.linalg.cholesky(state.edge_covariance))
    start = np.arange(edges)
    factors = (
        measured_poses(
            state.T_measured, jnp.where(is_used[:, None, None], state.pose_sqrt_info, 0.0), config.pose_threshold
        ),
        odometry(
            start,
            start + 1,
            state.T_edge,
            state.edge_jacobian,
            state.edge_calibration,
            jnp.where(is_edge[:, None, None], edge_sqrt_info, 0.0),
        ),
        fixes(
            state.p_fix,
            state.fix_base,
            jnp.where(is_used[:, None], state.fix_sqrt_info, 0.0),
            config.fix_threshold,
        ),
        prior(state.T_prior, state.calibration_prior, state.prior_sqrt_info),
        *factors_of(kinds, state.terms, is_used),
    )
    return pose_graph(is_used, factors), values_of(state.T_map_base, state.calibration)


def oldest_alone(state: WindowState) -> WindowState:
    """A window of the two oldest states, in which only the oldest and the motion to the next one say something."""
    short = {name: getattr(state, name)[:2] for name in BY_STATE} | {name: getattr(state, name)[:1] for name in BY_EDGE}
    alone = np.array([1.0, 0.0])
    short["pose_sqrt_info"] = short["pose_sqrt_info"] * alone[:, None, None]
    short["fix_sqrt_info"] = short["fix_sqrt_info"] * alone[:, None]
    return state._replace(num=np.int64(2), terms=of_first_of_two(state.terms), **short)


def without_newest(state: WindowState) -> WindowState:
    """The window without its newest state: the motion to it and since it become one."""
    last = int(state.num) - 2
    before = Motion(*(getattr(state, name)[last] for name in BY_EDGE))
    since = open_motion(state)
    return with_open(state, chained(before, since))._replace(num=np.int64(state.num - 1))


def chained(first: Motion, second: Motion) -> Motion:
    """One motion after the other, with the calibration of the first."""
    step = at_calibration(second, first.calibration)
    Ad = rigid.adjoint(rigid.inverse(step))
    covariance = Ad @ first.covariance @ Ad.T + second.covariance
    jacobian = Ad @ first.jacobian + second.jacobian
    return Motion(rigid.normalised(first.T @ step), covariance, jacobian, first.calibration)


def motion_of(increment: MotionIncrement) -> Motion:
    """The motion of one increment."""
    calibration = np.array(increment.calibration)
    return Motion(increment.T_from_to, increment.covariance, increment.jacobian, calibration)


def still(calibration: np.ndarray) -> Motion:
    """No motion yet."""
    return Motion(np.eye(4), np.zeros((6, 6)), np.zeros((6, 3)), calibration)


def open_motion(state: WindowState) -> Motion:
    """Motion since the newest state."""
    return Motion(state.T_open, state.open_covariance, state.open_jacobian, state.open_calibration)


def with_open(state: WindowState, motion: Motion) -> WindowState:
    """The state with another motion since its newest state."""
    return state._replace(
        T_open=motion.T,
        open_covariance=motion.covariance,
        open_jacobian=motion.jacobian,
        open_calibration=motion.calibration,
    )


def at_calibration(motion: Motion, calibration: np.ndarray) -> np.ndarray:
    """Transform of a motion with another calibration, to first order."""
    return motion.T @ rigid.exp(motion.jacobian @ (calibration[:3] - motion.calibration))


def replaced(array: np.ndarray, index: int, value: np.ndarray | np.floating) -> np.ndarray:
    """A copy with one entry changed."""
    changed = array.copy()
    changed[index] = value
    return changed
