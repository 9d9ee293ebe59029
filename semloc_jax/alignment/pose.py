"""One pose, coarse to fine: Levenberg-Marquardt on each level of the cost maps (room: alignment; pure JAX).

In: start pose, Evidence, Prior. Out: PoseEstimate with covariance, cost, coverage, weak direction and status.
Weights and visibility are frozen at the start of every level: a mask that changes under the solver moves the optimum.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.alignment.level_choice import INLIER_LIMITS, finest_held
from semloc_jax.alignment.problem import POSE_DAMPING, AlignmentProblem, known_model, pose_of, quadratic_model
from semloc_jax.geometry import lie
from semloc_jax.residuals import native_kernels
from semloc_jax.residuals.alignment import CameraViews, Usable
from semloc_jax.residuals.forward_only import forward_only
from semloc_jax.residuals.native_kernels import Path
from semloc_jax.residuals.noise import NoiseModel, is_inlier
from semloc_jax.residuals.pose_terms import Terms
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.residuals.scoring import ramp_values, visible_weight
from semloc_jax.residuals.texture import RampTextures
from semloc_jax.solvers.front import solve
from semloc_jax.solvers.levenberg_marquardt import LEAST_DAMPING, LEAST_FALL, MOST_DAMPING, SolveConfig
from semloc_jax.structs import PoseEstimate, SolveStatus


def usual_grain() -> Float[np.ndarray, ""]:
    """The grain of masks that the noise model was made for."""
    return np.ones((), np.float32)


class Evidence(eqx.Module):
    """What the cameras saw: views of the map, textures of all levels (coarsest first), usable pixels."""

    views: tuple[CameraViews, ...]
    textures: RampTextures
    usable: Usable
    grain: Float[Array | np.ndarray, ""] = eqx.field(default_factory=usual_grain)
    """Of the masks, see `NoiseModel.grain`."""


class Prior(eqx.Module):
    """What is known of the vehicle pose before the masks: a Gaussian in its right tangent, and further terms."""

    T_local_base: Float[Array | np.ndarray, "4 4"]
    """Centre, relative to the local origin."""
    sigma: Float[Array | np.ndarray, "6"]
    """Standard deviations (x, y, z [m], roll, pitch, yaw [rad]) in the vehicle frame; 0 locks a direction."""
    terms: Terms = ()
    """Other measurements of the pose, see `semloc_jax.residuals.pose_terms`; relative to the local origin, too."""


@dataclass(frozen=True)
class AlignConfig:
    """How one pose is refined. All values are ours."""

    levels: tuple[int, ...] = (0, 1, 2, 3)
    """Levels of the cost maps that are visited, in this order."""
    max_steps: int = 8
    """Most evaluations on each level."""
    tolerance: float = 2e-3
    """A level ends when a step is below this share of the prior's sigma in every direction."""
    loss: str = "tukey"
    path: Path = "auto"
    """How residuals are evaluated: by native kernels (`analytic`, `autodiff`) or by JAX alone (`xla`)."""
    noise: NoiseModel = field(default_factory=NoiseModel)
    min_inlier_ratio: float = INLIER_LIMITS.level
    """Share of the visible contour within the ramp that a finer level needs to hold the pose."""
    border_px: float = 2.0
    """Samples nearer to the border of the image are not used."""
    min_visible_px: float = 100.0
    """Less contour than this on usable pixels is no evidence."""


def visible_views(
    T_local_base: Float[Array, "4 4"], evidence: Evidence, border_px: float, path: Path = "auto"
) -> tuple[CameraViews, ...]:
    """The views with the weight of every sample that cannot be seen from `T_local_base` set to zero."""

    def seen(view: CameraViews) -> CameraViews:
        weight = visible_weight(T_local_base, view, evidence.usable, border_px, path)
        return eqx.tree_at(lambda v: v.weight, view, weight)

    return tuple(seen(view) for view in evidence.views)


def visible_ramps(
    T_local_base: Float[Array, "4 4"], level: Int[Array, ""] | int, evidence: Evidence, config: AlignConfig
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Signed ramp value of every sample on one level, and its weight where it can be seen from the pose, else 0."""
    views = visible_views(T_local_base, evidence, config.border_px, config.path)
    return ramp_values(T_local_base, views, evidence.textures.level(level), config.path)


def total_weight(views: tuple[CameraViews, ...]) -> Float[Array, ""]:
    """Weighted contour length of the views [px]."""
    return sum(jnp.sum(view.weight) for view in views)


def level_problem(
    T_start: Float[Array, "4 4"],
    views: tuple[CameraViews, ...],
    level: Int[Array, ""] | int,
    evidence: Evidence,
    prior: Prior,
    config: AlignConfig,
) -> AlignmentProblem:
    """The problem of one level with its chart at `T_start`."""
    texture = evidence.textures.level(level)
    gain = config.noise.gain(texture.ramp_px, evidence.grain)
    xi_prior = lie.log(lie.inverse(T_start) @ prior.T_local_base)
    return AlignmentProblem(
        T_start,
        xi_prior,
        prior.sigma,
        views,
        texture,
        gain.astype(T_start.dtype),
        config.loss,
        config.path,
        prior.terms,
    )


def solve_level(
    T_start: Float[Array, "4 4"], level: Int[Array, ""] | int, evidence: Evidence, prior: Prior, config: AlignConfig
) -> tuple[Float[Array, "4 4"], Int[Array, ""], Bool[Array, ""]]:
    """Pose after one level, evaluations spent, and whether it converged."""
    views = visible_views(T_start, evidence, config.border_px, config.path)
    problem = level_problem(T_start, views, level, evidence, prior, config)
    solution = solve(problem, jnp.zeros(6, T_start.dtype), solve_config(config))
    return pose_of(solution.value, problem), solution.num_steps, solution.converged


def solve_config(config: AlignConfig) -> SolveConfig:
    """When the solve of one level ends, and how it is damped."""
    return SolveConfig(config.tolerance, config.max_steps, damping=POSE_DAMPING)


def refine(
    T_start: Float[Array, "4 4"],
    evidence: Evidence,
    prior: Prior,
    config: AlignConfig,
    levels: Int[Array, " level"] | None = None,
) -> tuple[Float[Array, "level 4 4"], Int[Array, " level"], Bool[Array, " level"]]:
    """Pose after each level (None: those of the configuration), evaluations spent there, and whether it converged."""
    levels = jnp.asarray(config.levels) if levels is None else levels
    if _is_in_one_call(T_start, evidence, prior, config):
        return _refined_in_one_call(T_start, evidence, prior, config, levels)
    T_start, evidence, prior = forward_only(
        "the fast solve (align_one, align_many, search)", (T_start, evidence, prior)
    )

    def one_level(T: Array, level: Array) -> tuple[Array, tuple[Array, Array, Array]]:
        T, num_steps, converged = solve_level(T, level, evidence, prior, config)
        return T, (T, num_steps, converged)

    # A loop over levels, not a chain of them: the solver is compiled once.
    _, visited = jax.lax.scan(one_level, T_start, levels)
    return visited


def _is_in_one_call(T_start: Array, evidence: Evidence, prior: Prior, config: AlignConfig) -> bool:
    """Whether a kernel does a whole solve: cameras of one model that has kernels, and nothing known but the prior."""
    if len(evidence.views) != 1 or prior.terms:
        return False
    camera, loss = evidence.views[0].camera, LOSSES[config.loss]
    return native_kernels.use(config.path, camera, loss, T_start.dtype) == "analytic"


def _refined_in_one_call(
    T_start: Float[Array, "4 4"], evidence: Evidence, prior: Prior, config: AlignConfig, levels: Int[Array, " level"]
) -> tuple[Float[Array, "level 4 4"], Int[Array, " level"], Bool[Array, " level"]]:
    """`refine` without a loop of XLA, whose every small operation costs as much as an evaluation."""
    rule = solve_config(config).damping
    numbers = (1 / evidence.usable.stride, config.border_px, config.tolerance)
    numbers = (*numbers, rule.first, rule.good_fall, rule.ease, rule.press, LEAST_FALL, LEAST_DAMPING, MOST_DAMPING)
    numbers = jnp.asarray(numbers, jnp.float32)
    gain = jax.vmap(lambda ramp_px: config.noise.gain(ramp_px, evidence.grain))(evidence.textures.ramp_px)
    held = prior.T_local_base, prior.sigma, levels, gain, numbers
    seen = evidence.views[0], evidence.usable, evidence.textures, config.max_steps
    return tuple(native_kernels.refine(T_start, *held, *seen))


def _held_rms(r: Float[Array, " n"], weight: Float[Array, " n"], config: AlignConfig) -> Float[Array, ""]:
    """Root mean square of the ramp values that the robust loss holds on to."""
    held = weight * LOSSES[config.loss].weight(r)
    return jnp.sqrt(jnp.sum(held * r * r) / jnp.maximum(jnp.sum(held), 1e-6))


def scatter_px(
    T_local_base: Float[Array, "4 4"], level: Int[Array, ""] | int, evidence: Evidence, config: AlignConfig
) -> Float[Array, ""]:
    """How far the contours that the loss holds on to lie from the boundaries of their class [px RMS]."""
    r, weight = visible_ramps(T_local_base, level, evidence, config)
    return evidence.textures.level(level).ramp_px * _held_rms(r, weight, config)


def typical_px(
    T_local_base: Float[Array, "4 4"], level: Int[Array, ""] | int, evidence: Evidence, config: AlignConfig
) -> Float[Array, ""]:
    """How far a contour within reach typically lies from the boundary of its class [px]: 1.48 times the median of the
    distances, the standard deviation of a Gaussian. The noise of the model where nothing is within reach."""
    r, weight = visible_ramps(T_local_base, level, evidence, config)
    weight = jnp.where(is_inlier(r), weight, 0.0)
    order = jnp.argsort(jnp.abs(r))
    running = jnp.cumsum(weight[order])
    middle = jnp.abs(r)[order][jnp.searchsorted(running, 0.5 * running[-1])]
    return jnp.where(running[-1] > 0.0, 1.4826 * evidence.textures.level(level).ramp_px * middle, config.noise.noise_px)


class MaskFit(NamedTuple):
    """How well a pose explains the masks."""

    cost: Float[Array, ""]
    """Visibility-normalised robust cost in [0, 1]; 1 where nothing is visible."""
    coverage: Float[Array, ""]
    """Share of the contour in view that is on usable pixels."""
    inlier_ratio: Float[Array, ""]
    """Share of that within reach of a boundary of its class."""


def fit_at(
    T_local_base: Float[Array, "4 4"], level: Int[Array, ""] | int, evidence: Evidence, config: AlignConfig
) -> MaskFit:
    """How well a pose explains the masks on one level, without how well it is held."""
    return _fit(*visible_ramps(T_local_base, level, evidence, config), evidence, config)


def _fit(r: Float[Array, " n"], weight: Float[Array, " n"], evidence: Evidence, config: AlignConfig) -> MaskFit:
    loss, visible = LOSSES[config.loss], jnp.sum(weight)
    per_visible = 1 / jnp.maximum(visible, 1e-6)
    return MaskFit(
        cost=jnp.where(visible > 0, jnp.sum(weight * loss.rho(r)) * per_visible / loss.worst, 1.0),
        coverage=visible / jnp.maximum(total_weight(evidence.views), 1e-6),
        inlier_ratio=jnp.sum(weight * is_inlier(r)) * per_visible,
    )


def assess(
    T_local_base: Float[Array, "4 4"],
    level: Int[Array, ""] | int,
    evidence: Evidence,
    prior: Prior,
    config: AlignConfig,
) -> PoseEstimate:
    """The pose estimate at a pose that is not moved: cost, coverage, information, covariance on one level.

    Where the residuals scatter more than `config.noise` has it, the covariance of the evidence grows with them.
    """
    views = visible_views(T_local_base, evidence, config.border_px, config.path)
    problem = level_problem(T_local_base, views, level, evidence, prior, config)
    here = jnp.zeros(6, T_local_base.dtype)
    model, known = quadratic_model(here, problem), known_model(here, problem)
    r, weight = ramp_values(T_local_base, views, problem.texture, config.path)
    ramp_px = problem.texture.ramp_px
    scatter_px = ramp_px * _held_rms(r, weight, config)
    excess = config.noise.excess(scatter_px, ramp_px, evidence.grain)
    information = (model.hessian - known.hessian) / excess**2 + known.hessian
    eigenvalues, eigenvectors = jnp.linalg.eigh(information)
    scale = jnp.where(prior.sigma > 0, prior.sigma, 0.0)
    covariance = scale[:, None] * jnp.linalg.inv(information) * scale
    finite = jnp.all(jnp.isfinite(T_local_base)) & jnp.isfinite(model.cost) & jnp.all(jnp.isfinite(model.hessian))
    status = jnp.where(jnp.sum(weight) < config.min_visible_px, SolveStatus.NO_EVIDENCE, SolveStatus.CONVERGED)
    return PoseEstimate(
        T_local_base=T_local_base,
        covariance=covariance,
        **_fit(r, weight, evidence, config)._asdict(),
        information_eigenvalues=eigenvalues,
        weak_direction=eigenvectors[:, 0],
        num_steps=jnp.asarray(0),
        status=jnp.where(finite, status, SolveStatus.NOT_FINITE),
    )


def align_one(T_init: Float[Array, "4 4"], evidence: Evidence, prior: Prior, config: AlignConfig) -> PoseEstimate:
    """The pose that aligns the map with the masks, refined from one start.

    Args:
        T_init: Start pose T_local_base relative to the local origin.
        evidence: Views, textures and usable pixels.
        prior: Gaussian prior; its sigmas are also the scale of the damping. A sigma of 0 locks a direction.
        config: Levels, steps, robust loss, noise.

    Returns:
        PoseEstimate; `status` says MAX_STEPS, NO_EVIDENCE or NOT_FINITE where it is not CONVERGED. The pose is finite
        even then: that of the start, else of the prior, else the identity.

    >>> prior = sj.Prior(jnp.asarray(T_local), jnp.asarray([1, 1, 0.03, 0.01, 0.01, 0.05], jnp.float32))
    >>> solve = jax.jit(sj.align_one, static_argnames="config")
    >>> estimate = solve(prior.T_local_base, evidence, prior, sj.AlignConfig())
    >>> sj.SolveStatus(int(estimate.status)).name, estimate.covariance.shape
    ('CONVERGED', (6, 6))
    """
    end = descended(T_init, evidence, prior, config)
    return assessed(end, assess(end.T_local_base, end.level, evidence, prior, config))


class SolveEnd(NamedTuple):
    """Where a solve ended, before anything is said of how good that is."""

    T_local_base: Float[Array, "4 4"]
    level: Int[Array, ""]
    """The finest that holds the pose."""
    num_steps: Int[Array, ""]
    converged: Bool[Array, ""]
    sane: Bool[Array, ""]
    """Whether every pose on the way was finite; the pose is that of the start otherwise."""


def descended(T_init: Float[Array, "4 4"], evidence: Evidence, prior: Prior, config: AlignConfig) -> SolveEnd:
    """The end of one solve; arguments as `align_one`. Of many ends, few are worth the covariance."""
    levels = jnp.asarray(config.levels)
    Ts, num_steps, converged = refine(T_init, evidence, prior, config)
    sane = jnp.all(jnp.isfinite(Ts))
    Ts = jnp.where(sane, Ts, _first_finite(T_init, prior.T_local_base))
    held = jax.vmap(lambda T, level: fit_at(T, level, evidence, config).inlier_ratio)(Ts, levels)
    last = finest_held(held, config.min_inlier_ratio)
    return SolveEnd(Ts[last], levels[last], jnp.sum(num_steps), converged[last], sane)


def assessed(end: SolveEnd, estimate: PoseEstimate) -> PoseEstimate:
    """The estimate at the end of a solve with how it got there."""
    stopped = (estimate.status == SolveStatus.CONVERGED) & ~end.converged
    status = jnp.where(stopped, SolveStatus.MAX_STEPS, estimate.status)
    status = jnp.where(end.sane, status, SolveStatus.NOT_FINITE)
    return eqx.tree_at(lambda e: (e.num_steps, e.status), estimate, (end.num_steps, status))


def _first_finite(*poses: Float[Array, "4 4"]) -> Float[Array, "4 4"]:
    """The first pose that holds numbers only; the identity where there is none."""
    chosen = jnp.eye(4, dtype=poses[0].dtype)
    for T in reversed(poses):
        chosen = jnp.where(jnp.all(jnp.isfinite(T)), T, chosen)
    return chosen


CHUNK_ON_CPU, CHUNK_ELSEWHERE = 32, 1024
"""Poses side by side where nobody says how many: on a CPU what a chunk touches stays in the cache, other devices are
idle below. Ours, measured."""


def in_chunks(function, Ts: Float[Array, "n 4 4"], chunk: int | None):
    """function over n poses, at most `chunk` of them side by side; None for what suits the device."""
    if chunk is None:
        chunk = CHUNK_ON_CPU if jax.default_backend() == "cpu" else CHUNK_ELSEWHERE
    num = Ts.shape[0]
    size = -(-num // -(-num // chunk))
    # Chunks of one size: a smaller last one would be a second program, which takes as long to compile as the first.
    filled = jnp.concatenate([Ts, jnp.broadcast_to(Ts[:1], (-num % size, *Ts.shape[1:]))])
    return jax.tree.map(lambda leaf: leaf[:num], jax.lax.map(function, filled, batch_size=size))


def align_many(
    Ts_init: Float[Array, "n 4 4"], evidence: Evidence, prior: Prior, config: AlignConfig, chunk: int | None = None
) -> PoseEstimate:
    """`align_one` from every start; all leaves of the estimate have a leading axis.

    >>> starts = prior.T_local_base + jnp.zeros((2, 1, 1))
    >>> solve = jax.jit(sj.align_many, static_argnames=("config", "chunk"))
    >>> solve(starts, evidence, prior, sj.AlignConfig()).T_local_base.shape
    (2, 4, 4)
    """
    return in_chunks(lambda T: align_one(T, evidence, prior, config), Ts_init, chunk)
