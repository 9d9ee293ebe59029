"""Sliding-window fusion: the last poses solved together, older ones kept as a prior (room: fusion; host).

In: PoseMeasurement, MotionIncrement, GnssMeasurement. Out: FusedPose.
System A.5: a prior pose factor for every well-tracked frame, odometry between neighbours. When the window is full, a
vehicle that stands drops its second newest state, one that drives gives up the oldest, by marginalisation.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import chdtri

from semloc_jax.fusion.measurements import (
    FusedPose,
    GnssMeasurement,
    Innovation,
    PoseMeasurement,
    SensorBeliefs,
    check_same_time,
    needs_no_offset,
    normalised_square,
)
from semloc_jax.fusion.pose_factors import GraphConfig, calibration_of
from semloc_jax.fusion.prediction import MotionIncrement, MotionQuality, coasted
from semloc_jax.fusion.window_state import (
    BY_EDGE,
    BY_STATE,
    WindowState,
    at_calibration,
    chained,
    graph_of,
    motion_of,
    oldest_alone,
    open_motion,
    replaced,
    sqrt_information,
    still,
    with_open,
    without_newest,
)
from semloc_jax.fusion.window_terms import cleared, empty_rows, fit, is_finite, require_kind, with_term, without_first
from semloc_jax.geometry import rigid
from semloc_jax.residuals.pose_terms import Terms
from semloc_jax.runtime.stored_program import stored_program
from semloc_jax.solvers.dense import DenseEquations, DenseProblem, marginal
from semloc_jax.solvers.factors import Factors
from semloc_jax.solvers.front import solve

_VAGUE = 100.0
"""Standard deviation of an unknown quantity [m, rad]; our choice."""


@dataclass(frozen=True)
class WindowConfig:
    """How the window is kept and solved; all values are ours but the rule for a vehicle that stands."""

    num_states: int = 10
    sensors: SensorBeliefs = field(default_factory=SensorBeliefs)
    graph: GraphConfig = field(default_factory=GraphConfig)
    gate_probability: float = 0.999
    """A measurement beyond this quantile of the chi-square distribution is refused."""
    standing_m: float = 0.03
    """A step shorter than this adds nothing to the window: its errors are those of the frame before."""
    marginalise: bool = True
    """False drops the oldest state with all that it knew: for comparison."""


class SlidingWindow:
    """Fixed-lag smoother over the last poses, one calibration, and what is left of everything before.

    A measured pose or fix that fails the chi-square test against the predicted pose is refused; one that passes is
    still held by a robust loss, so that later frames can outvote it.
    """

    def __init__(self, config: WindowConfig | None = None, terms: Terms = ()) -> None:
        """A window with the given beliefs; it is compiled at the first correction.

        Args:
            config: None for the defaults.
            terms: One example of each kind of term that `correct_term` will get, with as many observations as can come
                at one time; see `semloc_jax.residuals.pose_terms`.
        """
        self.config, self.terms = config or WindowConfig(), terms
        self._last: tuple[WindowState, FusedPose] | None = None

    def start(self, measurement: PoseMeasurement) -> WindowState:
        """State at the first pose, with nominal calibration."""
        num, edges = self.config.num_states, self.config.num_states - 1
        sigma = self.config.sensors.sigma
        covariance = np.zeros((11, 11))
        covariance[:6, :6], covariance[6:, 6:] = measurement.covariance, np.diag(sigma**2)
        prior_sqrt_info = np.zeros((11, 11))
        prior_sqrt_info[6:, 6:] = np.diag(1.0 / sigma)
        calibration = np.array([1.0, 0.0, 0.0, 0.0, 0.0])
        poses = np.tile(measurement.T_map_base.astype(np.float64), (num, 1, 1))
        pose_sqrt_info = np.zeros((num, 6, 6))
        pose_sqrt_info[0] = sqrt_information(measurement.covariance)
        return WindowState(
            np.int64(1), np.full(num, float(measurement.time_s)), poses, calibration, covariance,
            poses.copy(), pose_sqrt_info,
            np.tile(np.eye(4), (edges, 1, 1)), np.tile(np.eye(6), (edges, 1, 1)), np.zeros((edges, 6, 3)),
            np.tile(calibration[:3], (edges, 1)),
            np.zeros((num, 2)), np.zeros((num, 2)), np.zeros((num, 3)),
            poses[0], calibration, prior_sqrt_info, np.float64(measurement.time_s), *still(calibration[:3]),
            empty_rows(self.terms, num),
        )  # fmt: skip

    def predict(self, state: WindowState, increment: MotionIncrement) -> WindowState:
        """State after the motion; the poses of the window stay as they are."""
        check_same_time("increment", increment.from_s, float(state.now_s))
        if increment.quality is MotionQuality.MISSING and state.num > 1:
            newest = int(state.num) - 1
            step_s = state.time_s[newest] - state.time_s[newest - 1]
            step = rigid.inverse(state.T_map_base[newest - 1]) @ state.T_map_base[newest]
            age_s, noise = float(state.now_s - state.time_s[newest]), self.config.sensors.motion
            increment = coasted(increment, rigid.log(step) / step_s, age_s, float(step_s), noise)
        motion = chained(open_motion(state), motion_of(increment))
        return with_open(state, motion)._replace(now_s=np.float64(increment.to_s))

    def correct(self, state: WindowState, measurement: PoseMeasurement) -> tuple[WindowState, Innovation]:
        """State with a measured pose, unless the chi-square test refuses it."""
        check_same_time("pose", measurement.time_s, float(state.now_s))
        predicted = self.pose(state)
        difference = rigid.log(rigid.inverse(predicted.T_map_base) @ measurement.T_map_base)
        square = normalised_square(difference, predicted.covariance + measurement.covariance)
        if square > chdtri(6, 1.0 - self.config.gate_probability):
            return state, Innovation(square, 6, False)
        state = self._with_new_state(state)
        newest = int(state.num) - 1
        state = state._replace(
            T_measured=replaced(state.T_measured, newest, measurement.T_map_base),
            pose_sqrt_info=replaced(state.pose_sqrt_info, newest, sqrt_information(measurement.covariance)),
        )
        return self._solved(state), Innovation(square, 6, True)

    def correct_gnss(self, state: WindowState, measurement: GnssMeasurement) -> tuple[WindowState, Innovation]:
        """State with a satellite fix, unless the chi-square test refuses it.

        The fix joins the newest state, seen from there along the motion since; a second one opens a state of its own.
        """
        check_same_time("fix", measurement.time_s, float(state.now_s))
        T, joint = self._predicted(state)
        H = np.zeros((2, 11))
        H[:, :3], H[:, 9:] = T[:2, :3], np.eye(2)
        difference = measurement.p_map[:2] - T[:2, 3] - state.calibration[3:]
        spread = H @ joint @ H.T + np.diag(measurement.sigma_m[:2] ** 2)
        square = normalised_square(difference, spread)
        gate = self.config.gate_probability
        if square > chdtri(2, 1.0 - gate) and not needs_no_offset(measurement, T, joint[:6, :6], gate):
            return state, Innovation(square, 2, False)
        if state.fix_sqrt_info[int(state.num) - 1].any():
            state = self._with_new_state(state)
        newest = int(state.num) - 1
        state = state._replace(
            p_fix=replaced(state.p_fix, newest, measurement.p_map[:2]),
            fix_sqrt_info=replaced(state.fix_sqrt_info, newest, 1.0 / measurement.sigma_m[:2]),
            fix_base=replaced(state.fix_base, newest, at_calibration(open_motion(state), state.calibration)[:3, 3]),
        )
        return self._solved(state), Innovation(square, 2, True)

    def correct_term(self, state: WindowState, term: Factors) -> tuple[WindowState, Innovation]:
        """State with a term that was measured at the time of the state, unless the chi-square test refuses it.

        Raises:
            SemlocError: the window was not made for such a term, or for so many at one time.
        """
        require_kind(self.terms, term)
        predicted = self.pose(state)
        innovation, _, _ = fit(term, predicted.T_map_base, predicted.covariance)
        if not is_finite(term) or innovation.chi2 > chdtri(innovation.dof, 1.0 - self.config.gate_probability):
            return state, innovation
        state = self._with_new_state(state)
        state = state._replace(terms=with_term(self.terms, state.terms, int(state.num) - 1, term))
        return self._solved(state), innovation._replace(accepted=True)

    def pose(self, state: WindowState) -> FusedPose:
        """Newest pose carried on to the time of the last prediction, its covariance, and the calibration."""
        # A step needs the pose of the same state several times.
        if self._last is None or self._last[0] is not state:
            T, joint = self._predicted(state)
            scale, bias, travel = (float(value) for value in state.calibration[:3])
            offset = state.calibration[3:]
            travel_sigma = float(np.sqrt(max(joint[8, 8], 0.0)))
            known = travel, travel_sigma, float(joint[5, 8])
            pose = FusedPose(float(state.now_s), T, joint[:6, :6], scale, bias, offset, *known)
            self._last = (state, pose)
        return self._last[1]

    def _predicted(self, state: WindowState) -> tuple[np.ndarray, np.ndarray]:
        """Pose now, and its joint covariance with the calibration."""
        motion = at_calibration(open_motion(state), state.calibration)
        F = np.eye(11)
        F[:6, :6] = rigid.adjoint(rigid.inverse(motion))
        F[:6, 6:9] = state.open_jacobian
        joint = F @ state.covariance @ F.T
        joint[:6, :6] += state.open_covariance
        walked_s = float(state.now_s - state.time_s[int(state.num) - 1])
        joint[6:, 6:] += np.diag(self.config.sensors.walk**2) * abs(walked_s)
        return rigid.normalised(state.T_map_base[int(state.num) - 1] @ motion), joint

    def _with_new_state(self, state: WindowState) -> WindowState:
        """The window with one more state, at the predicted pose; itself where nothing was predicted since the last."""
        newest = int(state.num) - 1
        if state.now_s == state.time_s[newest]:
            return state
        T, _ = self._predicted(state)
        if newest + 1 == self.config.num_states:
            is_standing = float(np.linalg.norm(state.T_open[:3, 3])) < self.config.standing_m
            state = without_newest(state) if is_standing else self._without_oldest(state)
        num, motion = int(state.num), open_motion(state)
        return with_open(state, still(state.calibration[:3]))._replace(
            num=np.int64(num + 1),
            time_s=replaced(state.time_s, num, state.now_s),
            T_map_base=replaced(state.T_map_base, num, T),
            pose_sqrt_info=replaced(state.pose_sqrt_info, num, np.zeros((6, 6))),
            fix_sqrt_info=replaced(state.fix_sqrt_info, num, np.zeros(2)),
            terms=cleared(state.terms, num),
            T_edge=replaced(state.T_edge, num - 1, motion.T),
            edge_covariance=replaced(state.edge_covariance, num - 1, motion.covariance),
            edge_jacobian=replaced(state.edge_jacobian, num - 1, motion.jacobian),
            edge_calibration=replaced(state.edge_calibration, num - 1, motion.calibration),
        )

    def _without_oldest(self, state: WindowState) -> WindowState:
        """The window one state later; what the oldest one knew stays as a prior of the next and the calibration."""
        if self.config.marginalise:
            with jax.enable_x64(True):
                equations = _known_by_oldest(oldest_alone(state), self.terms, self.config.graph)
            covariance = np.linalg.inv(np.asarray(equations.information))
            step = -covariance @ np.asarray(equations.gradient)
            passed_s = float(state.time_s[1] - state.time_s[0])
            covariance[6:, 6:] += np.diag(self.config.sensors.walk**2) * passed_s
            state = state._replace(
                T_prior=state.T_map_base[1] @ rigid.exp(step[:6]),
                calibration_prior=state.calibration + step[6:],
                prior_sqrt_info=sqrt_information(covariance),
            )
        else:
            # So vague that it only keeps the equations regular.
            sqrt_info = state.prior_sqrt_info.copy()
            sqrt_info[:6] = np.eye(6, 11) / _VAGUE
            state = state._replace(T_prior=state.T_map_base[1], prior_sqrt_info=sqrt_info)
        moved = {name: np.roll(getattr(state, name), -1, axis=0) for name in BY_STATE + BY_EDGE}
        return state._replace(num=np.int64(state.num - 1), terms=without_first(state.terms), **moved)

    def _solved(self, state: WindowState) -> WindowState:
        with jax.enable_x64(True):
            solution = _solved(state, self.terms, self.config.graph)
        unknowns = 6 * self.config.num_states + 5
        newest = 6 * (int(state.num) - 1)
        wanted = np.eye(unknowns)[:, [*range(newest, newest + 6), *range(unknowns - 5, unknowns)]]
        covariance = wanted.T @ np.linalg.solve(np.asarray(solution.information), wanted)
        return state._replace(
            T_map_base=np.array(solution.T_map_base),
            calibration=np.array(solution.calibration),
            covariance=0.5 * (covariance + covariance.T),
        )


class _Solved(NamedTuple):
    """A window after its solve: its poses, calibration, and information of all unknowns."""

    T_map_base: Float[Array, "n 4 4"]
    calibration: Float[Array, "5"]
    information: Float[Array, "k k"]


@stored_program("config")
def _solved(state: WindowState, kinds: Terms, config: GraphConfig) -> _Solved:
    solution = solve(*graph_of(state, config, kinds), config.solve)
    return _Solved(solution.value["pose"], calibration_of(solution.value), solution.equations.information)


@stored_program("config")
def _known_by_oldest(state: WindowState, kinds: Terms, config: GraphConfig) -> DenseEquations:
    """What the factors of the oldest state say of the next state and the calibration."""
    graph, values = graph_of(state, config, kinds)
    equations = DenseProblem(graph).linearise(values, jnp.asarray(False))
    return marginal(equations, np.arange(6), np.arange(6, 17))
