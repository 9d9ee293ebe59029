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

from semloc_jax.fusion.inertial_graph import (
    SIZES,
    STATE,
    StateFactors,
    WindowPrior,
    WindowProblem,
    left_by_oldest,
    sight_residuals,
    unknowns_of,
)
from semloc_jax.fusion.inertial_samples import Steps
from semloc_jax.fusion.landmark_pool import LandmarkPool
from semloc_jax.geometry import rigid
from semloc_jax.perception.tracks import Tracks
from semloc_jax.residuals.preintegration import InertialNoise, Preintegrated, preintegrate
from semloc_jax.solvers.dense import DenseEquations
from semloc_jax.solvers.graph import Values
from semloc_jax.solvers.levenberg_marquardt import Damping, SolveConfig, levenberg_marquardt

_LARGEST_INVERSE_DEPTH = 5.0
_BEHIND = -0.01
"""An inverse depth below this [1/m] is that of a point behind the camera."""


@dataclass(frozen=True)
class InertialWindowConfig:
    """Beliefs about sensors and vehicle, and how the window is kept. All values are ours, of a production car."""

    num_states: int = 12
    num_landmarks: int = 256
    """Landmarks of one solve, those with most views."""
    min_views: int = 3
    sigma_px: float = 0.5
    """Of a followed corner."""
    cauchy_sigmas: float = 2.0
    refuse_sigmas: float = 5.0
    """A landmark that is farther off in some view is let go."""
    gyro_density: float = 3e-4
    """White noise [rad/s per root of Hz]."""
    accel_density: float = 6e-3
    """White noise [m/s^2 per root of Hz]."""
    gyro_walk: float = 3e-4
    """Change of the bias [rad/s per root of s]."""
    accel_walk: float = 2e-3
    """Change of the bias [m/s^2 per root of s]."""
    side_sigma_mps: float = 0.05
    """Velocity of the rear axle to the side; 0: not a vehicle on wheels."""
    up_sigma_mps: float = 0.3
    """Velocity of the rear axle up and down, by suspension and load."""
    speed_sigma_mps: float = 0.05
    """Of a wheel speed besides its scale."""
    scale_walk: float = 1e-4
    """Change of the odometer scale [per root of s]."""
    max_steps: int = 8


class InertialMoment(NamedTuple):
    """What sensors say of one image time."""

    time_s: float
    tracks: Tracks
    T_base_cam: Float[np.ndarray, "c 4 4"]
    steps: Steps | None
    """Inertial steps since the time before; None for the first."""
    speed_mps: float | None = None
    """Of the wheels."""
    is_standing: bool = False
    T_measured: Float[np.ndarray, "4 4"] | None = None
    """Pose in a map by an alignment, its own prior taken out."""
    information: Float[np.ndarray, "6 6"] | None = None
    """Of that pose in its right tangent; undetermined directions are zero."""


class MotionState(NamedTuple):
    """State of one time."""

    T_map_base: Float[np.ndarray, "4 4"]
    velocity_map: Float[np.ndarray, "3"]
    bias: Float[np.ndarray, "6"]
    """Of gyroscope [rad/s] and accelerometer [m/s^2]."""
    scale: float
    """True speed over wheel speed."""


class InertialEstimate(NamedTuple):
    """State of the newest time."""

    time_s: float
    state: MotionState
    covariance: Float[np.ndarray, "16 16"]
    """Pose (right tangent), velocity, biases, scale."""
    num_landmarks: int
    num_steps: int
    cost: float


@dataclass
class InertialWindow:
    """The states, the landmarks that they see and the prior of what went before; all changed by `add`."""

    config: InertialWindowConfig
    num_states: int
    pool: LandmarkPool
    moments: list[InertialMoment] = field(default_factory=list)
    values: Values = field(default_factory=dict)
    prior: WindowPrior | None = None

    @classmethod
    def of(
        cls,
        moments: list[InertialMoment],
        values: Values,
        prior: WindowPrior,
        config: InertialWindowConfig,
        pool_rows: int = 1024,
    ) -> "InertialWindow":
        """A window of the first times, with guesses of their states."""
        window = cls(config, len(moments), LandmarkPool(pool_rows, len(moments)), list(moments), dict(values), prior)
        for index, moment in enumerate(moments):
            window.pool.add(moment.tracks, index)
        return window

    def add(self, moment: InertialMoment) -> InertialEstimate:
        """Go on to the next image time: the oldest state leaves, the new one is predicted, all are solved."""
        self.slide()
        self.moments.append(moment)
        newest = self.predicted(moment.steps)
        state = (newest.T_map_base, newest.velocity_map, newest.bias, [newest.scale])
        for name, new in zip(SIZES, state, strict=True):
            self.values[name][-1] = new
        first = {name: np.array(self.prior.first[name]) for name in SIZES}
        for name in SIZES:
            first[name][-1] = self.values[name][-1]
        self.prior = WindowPrior(
            first, self.prior.touched, self.prior.held, self.prior.gradient, self.prior.information
        )
        self.pool.add(moment.tracks, self.num_states - 1)
        return self.solve()

    def predicted(self, steps: Steps) -> MotionState:
        """The newest state carried on by the inertial sensor."""
        T, v, bias = (self.values[name][-1] for name in ("pose", "velocity", "bias"))
        with jax.enable_x64(True):
            moved = _preintegrated(*(s[None] for s in steps), bias[None], self.noise)
        dt, R = float(moved.duration_s[0]), T[:3, :3]
        gravity = np.array([0.0, 0.0, -9.81])
        after = np.eye(4)
        after[:3, :3] = R @ np.asarray(moved.rotation[0])
        after[:3, 3] = T[:3, 3] + v * dt + 0.5 * gravity * dt**2 + R @ np.asarray(moved.position[0])
        velocity = v + gravity * dt + R @ np.asarray(moved.velocity[0])
        return MotionState(rigid.normalised(after), velocity, bias.copy(), float(self.values["scale"][-1, 0]))

    def solve(self) -> InertialEstimate:
        """Solve all states and landmarks together, let go of landmarks that do not fit, judge the newest state."""
        rows, problem, values = self._problem()
        config = self.config
        with jax.enable_x64(True):
            found = _solved(problem, self._steps(), values, self.noise, config.max_steps)
        found = jax.tree.map(np.array, found)
        self.values = {name: found.values[name] for name in SIZES}
        num = len(rows)
        off = np.linalg.norm(found.residuals[:num], axis=2).max(axis=1, initial=0.0)
        rho = found.values["landmark"][:num, 2]
        is_good = (off < config.refuse_sigmas) & (rho > _BEHIND) & (rho < _LARGEST_INVERSE_DEPTH)
        self.pool.keep(rows, found.values["landmark"][:num], is_good)
        return InertialEstimate(
            self.moments[-1].time_s, self.state(-1), found.covariance, int(is_good.sum()), int(found.num_steps),
            float(found.cost),
        )  # fmt: skip

    def slide(self, num_gone: int = 1) -> None:
        """Give up the oldest states: what they and their landmarks say becomes a prior of the others."""
        rows, problem, values = self._problem(solved_only=True)
        with jax.enable_x64(True):
            left = jax.tree.map(np.array, _left(problem, self._steps(), values, self.noise, num_gone))
        self.prior = _moved_prior(self.prior, left, self.values, num_gone)
        self.values = {name: _shifted(array, num_gone) for name, array in self.values.items()}
        used = np.zeros(self.pool.num_rows, bool)
        used[rows[self.pool.anchors()[rows] < num_gone]] = True
        self.pool.slide(used, num_gone)
        self.moments = self.moments[num_gone:]

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
        return InertialWindow(self.config, num_states, self.pool.first(num_states), self.moments, values, prior)

    def state(self, index: int) -> MotionState:
        """Pose, velocity, biases and scale of one state."""
        T, v, b, s = (self.values[name][index] for name in SIZES)
        return MotionState(rigid.normalised(T), v.copy(), b.copy(), float(s[0]))

    @property
    def noise(self) -> InertialNoise:
        """White noise of the inertial sensor."""
        return InertialNoise(self.config.gyro_density, self.config.accel_density)

    def _problem(self, solved_only: bool = False) -> tuple[np.ndarray, WindowProblem, Values]:
        """Rows of the landmarks, the problem without its inertial steps, the values."""
        config, pool = self.config, self.pool
        num = config.num_landmarks
        T_base_cam = np.stack([moment.T_base_cam for moment in self._all_moments()])
        rows = pool.chosen(num, config.min_views)
        rows = rows[pool.is_solved[rows]] if solved_only else rows
        pool.prepare(rows, np.asarray(self.values["pose"]), T_base_cam)
        views, landmarks = pool.views(rows, num, config.sigma_px, T_base_cam)
        problem = WindowProblem(self._factors(), views, self.prior, config.cauchy_sigmas)
        return rows, problem, self.values | {"landmark": landmarks}

    def _all_moments(self) -> list[InertialMoment]:
        """One moment for each state; while a new one is awaited the last stands for it."""
        return self.moments + self.moments[-1:] * (self.num_states - len(self.moments))

    def _steps(self) -> Steps:
        steps = [moment.steps for moment in self._all_moments()[1:]]
        return Steps(*(np.stack(parts) for parts in zip(*steps, strict=True)))

    def _factors(self) -> StateFactors:
        config, moments, num = self.config, self._all_moments(), self.num_states
        step_s = np.array([moment.steps.step_s.sum() for moment in moments[1:]])
        walk = np.repeat([config.gyro_walk, config.accel_walk], 3)
        has_speed = np.array([moment.speed_mps is not None for moment in moments])
        standing = np.array([moment.is_standing for moment in moments])
        sides = np.array([config.side_sigma_mps, config.up_sigma_mps])
        rolling = np.tile(1.0 / sides if config.side_sigma_mps > 0 else np.zeros(2), (num, 1))
        both = standing[1:] & standing[:-1]
        still = np.diag(1.0 / np.array([1e-3, 1e-3, 1e-3, 1e-4, 1e-4, 1e-4]))
        return StateFactors(
            steps=None,
            inertial=np.zeros((num - 1, 9, 9)),
            walk=1.0 / (walk * np.sqrt(step_s)[:, None]),
            scale_walk=1.0 / (config.scale_walk * np.sqrt(step_s)[:, None]),
            rolling=rolling,
            speed_mps=np.array([moment.speed_mps or 0.0 for moment in moments]),
            wheels=np.where(has_speed, 1.0 / config.speed_sigma_mps, 0.0)[:, None],
            standing=np.where(standing[:, None], np.full(3, 1.0 / 0.005), 0.0),
            still=np.where(both[:, None, None], still, 0.0),
            T_measured=np.stack([np.eye(4) if m.T_measured is None else m.T_measured for m in moments]),
            measured=np.stack([_root(m.information) for m in moments]),
        )


class _Found(NamedTuple):
    values: Values
    residuals: Array
    covariance: Array
    cost: Array
    num_steps: Array


def _with_steps(problem: WindowProblem, steps: Steps, biases: Array, noise: InertialNoise) -> WindowProblem:
    """The problem with its inertial steps, integrated at the present biases."""
    moved = _preintegrated(*steps, biases[:-1], noise)
    lower = jnp.linalg.cholesky(moved.covariance)
    eye = jnp.broadcast_to(jnp.eye(9, dtype=lower.dtype), lower.shape)
    root = jax.scipy.linalg.solve_triangular(lower, eye, lower=True)
    return WindowProblem(
        problem.factors._replace(steps=moved, inertial=root), problem.views, problem.prior, problem.threshold
    )


@jax.jit
def _preintegrated(gyro: Array, accel: Array, step_s: Array, bias: Array, noise: InertialNoise) -> Preintegrated:
    return jax.vmap(preintegrate, in_axes=(0, 0, 0, 0, None))(gyro, accel, step_s, bias, noise)


@partial(jax.jit, static_argnames="max_steps")
def _solved(problem: WindowProblem, steps: Steps, values: Values, noise: InertialNoise, max_steps: int) -> _Found:
    problem = _with_steps(problem, steps, jnp.asarray(values["bias"]), noise)
    solution = levenberg_marquardt(problem, values, SolveConfig(1e-3, max_steps, damping=Damping(1e-6)))
    left, _ = solution.equations.reduced()
    num = len(problem.prior.touched)
    newest = unknowns_of(np.array([num - 1]), num)
    residuals = sight_residuals(problem.views, solution.value)
    return _Found(solution.value, residuals, left.covariance(newest), solution.cost, solution.num_steps)


@partial(jax.jit, static_argnames="num_gone")
def _left(problem: WindowProblem, steps: Steps, values: Values, noise: InertialNoise, num_gone: int) -> DenseEquations:
    problem = _with_steps(problem, steps, jnp.asarray(values["bias"]), noise)
    return left_by_oldest(problem, jax.tree.map(jnp.asarray, values), num_gone)


def _moved_prior(prior: WindowPrior, left: DenseEquations, values: Values, num_gone: int) -> WindowPrior:
    """The prior some states later, around the first estimates of all states that it knows of now."""
    num = len(prior.touched)
    rest = num - num_gone
    held, first = np.zeros(num, bool), {}
    held[:rest] = np.asarray(prior.held)[num_gone:]
    for name in SIZES:
        now, before = (_shifted(np.asarray(of[name], float), num_gone) for of in (values, prior.first))
        if name == "pose" and held.any():
            # As the derivatives were taken: see `WindowProblem.slopes_at`.
            before[:, :3, 3] += np.mean((np.asarray(values[name]) - prior.first[name])[prior.held, :3, 3], axis=0)
        first[name] = np.where(held.reshape(-1, *(1,) * (now.ndim - 1)), before, now)
    new = unknowns_of(np.arange(rest), num)
    information, gradient = np.zeros((STATE * num, STATE * num)), np.zeros(STATE * num)
    information[np.ix_(new, new)] = 0.5 * (left.information + left.information.T)
    # The gradient was taken at the values, not at the first estimates.
    now = {name: _shifted(np.asarray(values[name]), num_gone) for name in SIZES}
    gradient[new] = left.gradient
    gradient -= information @ _difference(first, now)
    size = np.abs(information).max(axis=1)
    touched = np.array([size[unknowns_of(np.array([state]), num)].max() > 0 for state in range(num)])
    return WindowPrior(first, touched, touched.copy(), gradient, information)


def _difference(first: Values, values: Values) -> Float[np.ndarray, " d"]:
    """All states less their first estimates."""
    parts = [rigid.log(rigid.inverse(first["pose"]) @ values["pose"])]
    parts += [values[name] - first[name] for name in ("velocity", "bias", "scale")]
    return np.concatenate([part.ravel() for part in parts])


def first_prior(values: Values, sigma: Float[np.ndarray, "16"], R_map_base: Float[np.ndarray, "3 3"]) -> WindowPrior:
    """A prior of the first state alone.

    Args:
        values: Of all states; the first is the mean.
        sigma: Standard deviations of position, rotation about the axes of the map, velocity, biases, scale.
        R_map_base: Attitude of the first state.
    """
    num = len(values["pose"])
    information = np.zeros((STATE * num, STATE * num))
    own = np.diag(1.0 / sigma**2)
    own[3:6, 3:6] = R_map_base.T @ own[3:6, 3:6] @ R_map_base
    at = unknowns_of(np.arange(1), num)
    information[np.ix_(at, at)] = own
    touched = np.arange(num) == 0
    first = {name: np.array(values[name]) for name in SIZES}
    return WindowPrior(first, touched, np.zeros(num, bool), np.zeros(len(information)), information)


def _shifted(array: np.ndarray, num_gone: int) -> np.ndarray:
    """Some states later; the last is repeated."""
    return np.concatenate([array[num_gone:], np.repeat(array[-1:], num_gone, axis=0)])


def _root(information: np.ndarray | None) -> np.ndarray:
    """Rows R with R^T R = information, which may leave directions free."""
    if information is None:
        return np.zeros((6, 6))
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    return np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
