"""The last states of a vehicle by camera and inertial sensor, solved together (room: fusion; host around JAX).

In: tracks, inertial steps and wheel speeds of one image time after another. Out: InertialEstimate of the newest.
Pose, velocity, biases and odometer scale at every image; landmarks are eliminated first. When the window is full, the
oldest state and the landmarks that it saw first become a prior of the others, with first estimates held.
All arrays keep their shapes: a window compiles once.
"""

from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from semloc_jax.fusion.inertial_graph import WindowProblem, left_by_oldest
from semloc_jax.fusion.inertial_intervals import InertialInterval, stacked
from semloc_jax.fusion.inertial_moment import InertialMoment, InertialWindowConfig, state_factors
from semloc_jax.fusion.inertial_motion import Moving
from semloc_jax.fusion.inertial_prior import WindowPrior, moved_prior, shifted
from semloc_jax.fusion.inertial_samples import Steps
from semloc_jax.fusion.inertial_sights import step_residuals
from semloc_jax.fusion.inertial_states import SIZES, STATE, unknowns_of
from semloc_jax.fusion.landmark_pool import LandmarkPool
from semloc_jax.geometry import rigid
from semloc_jax.solvers.graph import Values
from semloc_jax.solvers.levenberg_marquardt import Damping, SolveConfig
from semloc_jax.structs import InertialNoise

_LARGEST_INVERSE_DEPTH = 5.0
_MAD = 1.4826
_LEAST_STEPS = 40
"""Fewer steps of tracks say nothing about their size."""
_BEHIND = -0.01
"""An inverse depth below this [1/m] is that of a point behind the camera."""


class MotionState(NamedTuple):
    """State of one time; the fields are the families of `inertial_states`, in their order."""

    T_map_base: Float[np.ndarray, "4 4"]
    height_m: Float[np.ndarray, "1"]
    bend_per_m: Float[np.ndarray, "1"]
    """How the road bends upwards, one over its radius."""
    velocity_map: Float[np.ndarray, "3"]
    bias: Float[np.ndarray, "6"]
    """Of gyroscope [rad/s] and accelerometer [m/s^2]."""
    scale: Float[np.ndarray, "1"]
    """True speed over wheel speed."""
    mount_rad: Float[np.ndarray, "3"]
    """Rotation vector that turns the axes of the inertial sensor into those of the base."""
    delay_s: Float[np.ndarray, "1"]
    """Clock of the inertial sensor less that of the cameras."""


class InertialEstimate(NamedTuple):
    """State of the newest time."""

    time_s: float
    state: MotionState
    covariance: Float[np.ndarray, "22 22"]
    """In the order of `inertial_states`; the pose in its right tangent."""
    num_landmarks: int
    num_steps: int
    cost: float
    step_px: float
    """What corners slipped from one image to the next within the window; NaN where it holds too few of them."""
    oldest_s: float
    oldest: MotionState
    across_oldest: Float[np.ndarray, "22 22"]
    """Covariance of the newest state with the oldest."""


@dataclass
class InertialWindow:
    """The states, the landmarks that they see and the prior of what went before; all changed by `add`."""

    config: InertialWindowConfig
    noise: InertialNoise
    """Of the inertial sensor."""
    num_states: int
    pool: LandmarkPool
    moments: list[InertialMoment] = field(default_factory=list)
    values: Values = field(default_factory=dict)
    prior: WindowPrior | None = None
    step_px: float = 0.0
    """What corners slip from one image to the next, as the images so far show it."""
    _intervals: dict[int, InertialInterval] = field(default_factory=dict)
    """Those of the last solve, by the identity of their steps; the next one takes them as they are."""
    _last: tuple[np.ndarray, WindowProblem] | None = None
    """Rows of the landmarks and the problem of the last solve, until states leave."""

    @classmethod
    def of(
        cls,
        moments: list[InertialMoment],
        values: Values,
        prior: WindowPrior,
        config: InertialWindowConfig,
        noise: InertialNoise | None = None,
        pool_rows: int = 1024,
    ) -> "InertialWindow":
        """A window of the first times, with guesses of their states; noise None: that of a production car."""
        pool, noise = LandmarkPool(pool_rows, len(moments)), noise or InertialNoise()
        window = cls(config, noise, len(moments), pool, list(moments), dict(values), prior, config.step_px)
        for index, moment in enumerate(moments):
            window.pool.add(moment.tracks, index)
        return window

    def add(self, moment: InertialMoment) -> InertialEstimate:
        """Go on to the next image time: the oldest state leaves, the new one is predicted, all are solved."""
        self.slide()
        self.moments.append(moment)
        newest = self.predicted(moment.steps)
        for name, new in zip(SIZES, newest, strict=True):
            self.values[name][-1] = new
        self.pool.add(moment.tracks, self.num_states - 1)
        estimate = self.solve(takes_short=True)
        if not moment.is_standing:  # corners of a vehicle that stands do not slip
            self._learn_steps(estimate.step_px)
        return estimate

    def predicted(self, steps: Steps) -> MotionState:
        """The newest state carried on by the inertial sensor."""
        T, v, bias = (self.values[name][-1] for name in ("pose", "velocity", "bias"))
        turn = rigid.exp(np.concatenate([np.zeros(3), self.values["mount"][-1]]))[:3, :3]
        moving = Moving(T[:3, :3], v, bias, np.zeros((3, 3)), turn)
        motion = self._interval(steps, bias).motion(self.noise)
        T_from_to, velocity = motion.turned(turn).after(moving)
        return self.state(-1)._replace(T_map_base=rigid.normalised(T @ T_from_to), velocity_map=velocity)

    def solve(self, takes_short: bool = False) -> InertialEstimate:
        """Solve all states and landmarks together, let go of landmarks that do not fit, judge the newest state.

        Args:
            takes_short: Whether the last step, which moves little, is taken without looking at where it leads.
        """
        rows, problem, values = self._problem()
        config = self.config
        with jax.enable_x64(True):
            found = _solved(problem, values, config.max_steps, config.least_step_sigmas, takes_short)
        found = jax.tree.map(np.array, found)
        self.values = {name: found.values[name] for name in SIZES}
        num = len(rows)
        off = np.linalg.norm(found.residuals[:num], axis=2).max(axis=1, initial=0.0)
        rho = found.values["landmark"][:num, 2]
        is_good = (off < config.refuse_sigmas) & (rho > _BEHIND) & (rho < _LARGEST_INVERSE_DEPTH)
        self.pool.keep(rows, found.values["landmark"][:num], is_good)
        self._last = rows, problem
        return InertialEstimate(
            time_s=self.moments[-1].time_s,
            state=self.state(-1),
            covariance=found.covariance[:STATE, :STATE],
            num_landmarks=int(is_good.sum()),
            num_steps=int(found.num_steps),
            cost=float(found.cost),
            step_px=self._measured_step(found.residuals[:num], problem.views.sqrt_info[:num]),
            oldest_s=self.moments[0].time_s,
            oldest=self.state(0),
            across_oldest=found.covariance[:STATE, STATE:],
        )

    def _learn_steps(self, found_px: float) -> None:
        """Believe of the next images what these showed."""
        if np.isfinite(found_px):
            least, most = self.config.step_limits_px
            share = 1.0 / self.config.step_memory
            square = (1.0 - share) * self.step_px**2 + share * np.clip(found_px, least, most) ** 2
            self.step_px = float(np.sqrt(square))

    def _measured_step(self, steps: Float[np.ndarray, "l f 2"], sqrt_info: Float[np.ndarray, "l f"]) -> float:
        """Standard deviation of the steps of tracks [px]: robust, and less what the solve has fitted."""
        seen = sqrt_info > 0
        views = seen.sum(axis=1)
        is_step = seen.copy()
        is_step[np.arange(len(seen)), np.argmax(seen, axis=1)] = False
        if is_step.sum() < _LEAST_STEPS:
            return float("nan")
        # The depth of a landmark takes one of the coordinates of its steps.
        left = 1.0 - (views >= 2).sum() / (2.0 * is_step.sum())
        return float(self.step_px * _MAD * np.median(np.abs(steps[is_step])) / np.sqrt(max(left, 0.25)))

    def slide(self, num_gone: int = 1) -> None:
        """Give up the oldest states: what they and their landmarks say becomes a prior of the others."""
        rows, problem, values = self._solved_problem()
        with jax.enable_x64(True):
            self.prior = jax.tree.map(np.array, _left(problem, values, num_gone))
        self.values = {name: shifted(array, num_gone) for name, array in self.values.items()}
        used = np.zeros(self.pool.num_rows, bool)
        used[rows[self.pool.anchors()[rows] < num_gone]] = True
        self.pool.slide(used, num_gone)
        self.moments, self._last = self.moments[num_gone:], None

    def shrunk(self, num_states: int) -> "InertialWindow":
        """The window of the newest states; the others are given up."""
        if len(self.moments) == num_states:
            return self
        self.slide(len(self.moments) - num_states)
        kept = unknowns_of(np.arange(num_states), self.num_states)
        prior, here = self.prior, slice(0, num_states)
        first = {name: prior.first[name][here] for name in SIZES}
        information = prior.information[np.ix_(kept, kept)]
        prior = WindowPrior(first, prior.touched[here], prior.held[here], prior.gradient[kept], information)
        values = {name: array[here].copy() for name, array in self.values.items()}
        return InertialWindow(
            self.config, self.noise, num_states, self.pool.first(num_states), self.moments, values, prior, self.step_px
        )

    def state(self, index: int) -> MotionState:
        """Pose, velocity, biases and scale of one state."""
        T, *rest = (self.values[name][index].copy() for name in SIZES)
        return MotionState(rigid.normalised(T), *rest)

    def motion(self, from_state: int, to_state: int) -> Float[np.ndarray, "4 4"]:
        """T_from_to of two states."""
        Ts = self.values["pose"]
        return rigid.inverse(Ts[from_state]) @ Ts[to_state]

    def _solved_problem(self) -> tuple[np.ndarray, WindowProblem, Values]:
        """What was solved last, without the landmarks that it let go: put together anew only after other changes."""
        if self._last is None:
            return self._problem(solved_only=True)
        (rows, problem), pool = self._last, self.pool
        kept = pool.is_solved[rows]
        landmarks, is_kept = pool.values_of(rows[kept], np.flatnonzero(kept), self.config.num_landmarks)
        views = problem.views.only(is_kept)
        solved = WindowProblem(problem.factors, views, self.prior, problem.threshold)
        return rows[kept], solved, self.values | {"landmark": landmarks}

    def _problem(self, solved_only: bool = False) -> tuple[np.ndarray, WindowProblem, Values]:
        """Rows of the landmarks, the problem, the values."""
        config, pool = self.config, self.pool
        num = config.num_landmarks
        T_base_cam = np.stack([moment.T_base_cam for moment in self._all_moments()])
        rows = pool.chosen(num, config.min_views)
        rows = rows[pool.is_solved[rows]] if solved_only else rows
        pool.prepare(rows, np.asarray(self.values["pose"]), T_base_cam)
        views, landmarks = pool.views(rows, num, (config.sigma_px, self.step_px), T_base_cam, config.road)
        moments, bias = self._all_moments(), self.values["bias"]
        intervals = [self._interval(m.steps, b) for m, b in zip(moments[1:], bias[:-1], strict=True)]
        self._intervals = {id(one.steps): one for one in intervals}
        factors = state_factors(moments, config, self._ways_m(), self.noise, stacked(intervals))
        problem = WindowProblem(factors, views, self.prior, config.cauchy_sigmas)
        return rows, problem, self.values | {"landmark": landmarks}

    def _all_moments(self) -> list[InertialMoment]:
        """One moment for each state; while a new one is awaited the last stands for it."""
        return self.moments + self.moments[-1:] * (self.num_states - len(self.moments))

    def _ways_m(self) -> Float[np.ndarray, " e"]:
        """From each state to the next."""
        return np.linalg.norm(np.diff(self.values["pose"][:, :3, 3], axis=0), axis=1)

    def _interval(self, steps: Steps, bias: Float[np.ndarray, "6"]) -> InertialInterval:
        """The steps put together, or those that were, where they hold."""
        known = self._intervals.get(id(steps))
        if known is None or not known.holds(steps, bias):
            known = self._intervals[id(steps)] = InertialInterval.of(steps, bias, self.noise)
        return known


class _Found(NamedTuple):
    values: Values
    residuals: Array
    covariance: Array
    """Of the newest state and, behind it, the oldest."""
    cost: Array
    num_steps: Array


@partial(jax.jit, static_argnames=("max_steps", "least_step_sigmas", "takes_short"))
def _solved(
    problem: WindowProblem, values: Values, max_steps: int, least_step_sigmas: float, takes_short: bool
) -> _Found:
    rules = SolveConfig(least_step_sigmas, max_steps, damping=Damping(1e-6), takes_short=takes_short)
    from semloc_jax.solvers.optimistix_loop import levenberg_marquardt  # loaded when it is traced, see there

    solution = levenberg_marquardt(problem, values, rules)
    left = solution.equations.reduced()
    num = len(problem.prior.touched)
    ends = np.concatenate([unknowns_of(np.array([state]), num) for state in (num - 1, 0)])
    residuals = step_residuals(problem.views, solution.value)
    return _Found(solution.value, residuals, left.covariance(ends), solution.cost, solution.num_steps)


@partial(jax.jit, static_argnames="num_gone")
def _left(problem: WindowProblem, values: Values, num_gone: int) -> WindowPrior:
    values = jax.tree.map(jnp.asarray, values)
    left = left_by_oldest(problem, values, num_gone)
    return moved_prior(problem.prior, left, problem.prior.slopes_at(values), values, num_gone)
