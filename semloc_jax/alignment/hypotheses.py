"""Many hypotheses: score, cull, refine, merge into modes (room: alignment; pure JAX).

In: start poses, Evidence, Prior. Out: Modes, the distinct poses that explain the masks, best first, with weights.
The search limits accuracy more than the optimum does: everything is scored, few are refined, survivors must differ.
"""

import dataclasses
from dataclasses import dataclass
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.alignment.pose import AlignConfig, Evidence, Prior, in_chunks, refine, total_weight
from semloc_jax.alignment.proposals import displaced
from semloc_jax.alignment.same_pose import units_apart
from semloc_jax.geometry import lie
from semloc_jax.residuals.pose_terms import terms_cost
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.residuals.scoring import decimated, robust_cost
from semloc_jax.runtime.stored_program import stored_program
from semloc_jax.structs import PoseEstimate


@dataclass(frozen=True)
class CullStage:
    """Refine on some levels, score on one, keep the best that differ."""

    levels: tuple[int, ...]
    """Levels of the cost maps on which the poses are refined first; none: they are only scored."""
    score_level: int
    keep: int
    """Poses that survive."""
    apart: float
    """Survivors are at least this many units apart; see `alignment.same_pose`."""
    max_steps: int = 8
    """Most evaluations on each level."""
    keep_every: int = 1
    """Use every k-th sample."""
    restarts_m: tuple[float, ...] = (0.0,)
    """Every pose is first repeated at these offsets along the road, where dashes and far poles leave local minima."""


@dataclass(frozen=True)
class SearchConfig:
    """The schedule of a search. All values are ours."""

    stages: tuple[CullStage, ...] = (
        CullStage(levels=(), score_level=0, keep=256, apart=0.0, keep_every=4),
        CullStage(levels=(0,), score_level=1, keep=64, apart=0.8, max_steps=4, keep_every=4),
        CullStage(levels=(1, 2), score_level=2, keep=9, apart=0.3),
        CullStage(levels=(2, 3), score_level=2, keep=6, apart=0.1, restarts_m=(-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6)),
    )
    chunk: int | None = None
    """Poses side by side; None for what suits the device."""

    @classmethod
    def fast(cls) -> "SearchConfig":
        """A third of the work, for clear masks or where many searches are made: fewer survivors and restarts."""
        return cls(
            stages=(
                CullStage(levels=(), score_level=0, keep=128, apart=0.0, keep_every=8),
                CullStage(levels=(0,), score_level=1, keep=24, apart=0.5, max_steps=4, keep_every=4),
                CullStage(levels=(1, 2), score_level=2, keep=6, apart=0.3, max_steps=6, keep_every=2),
                CullStage(levels=(2, 3), score_level=2, keep=4, apart=0.1, max_steps=6, restarts_m=(-0.3, 0.0, 0.3)),
            )
        )


class Modes(eqx.Module):
    """Distinct poses, best first."""

    estimates: PoseEstimate
    """Leading axis: modes."""
    score: Float[Array | np.ndarray, " mode"]
    """Cost of evidence and prior [nats]; infinite for padding."""
    weight: Float[Array | np.ndarray, " mode"]
    """Posterior weight of the mode (Laplace: exp(-score) sqrt(det covariance)), sums to 1."""


def score(
    T_local_base: Float[Array, "4 4"],
    level: Int[Array, ""] | int,
    evidence: Evidence,
    prior: Prior,
    config: AlignConfig,
    in_view_px: Float[Array, ""] | None = None,
) -> Float[Array, ""]:
    """Cost of a pose [nats]: visibility-normalised robust cost of the whole view, and prior.

    Normalised by what is visible, so that a pose does not gain by hiding the map; scaled by what is in view, so that it
    does not gain by looking away from it.

    Args:
        T_local_base: Pose relative to the local origin.
        level: Level of the cost maps.
        evidence: What the cameras saw.
        prior: Gaussian prior.
        config: Robust loss and noise.
        in_view_px: Weighted contour length that the normalised cost is scaled by; one value for all poses that are
            compared. None takes that of the evidence.
    """
    texture = evidence.textures.level(level)
    cost = robust_cost(
        T_local_base,
        evidence.views,
        texture,
        evidence.usable,
        LOSSES[config.loss],
        config.border_px,
        config.path,
    )
    share = cost.summed / jnp.maximum(cost.visible, config.min_visible_px)
    unseen = jnp.maximum(1 - cost.visible / config.min_visible_px, 0.0)
    in_view_px = total_weight(evidence.views) if in_view_px is None else in_view_px
    nats = in_view_px * LOSSES[config.loss].worst * config.noise.gain(texture.ramp_px, evidence.grain)
    return nats * (share + unseen) + prior_cost(T_local_base, prior)


def prior_cost(T_local_base: Float[Array, "4 4"], prior: Prior) -> Float[Array, ""]:
    """Half the squared deviation from the prior, in sigmas, and the cost of its terms [nats]; locked directions do not
    count."""
    xi = lie.log(lie.inverse(prior.T_local_base) @ T_local_base)
    free = prior.sigma > 0
    deviation = jnp.where(free, xi / jnp.where(free, prior.sigma, 1.0), 0.0)
    return 0.5 * jnp.sum(deviation**2) + terms_cost(prior.terms, T_local_base)


def keep_distinct(
    Ts: Float[Array, "n 4 4"], scores: Float[Array, " n"], keep: int, apart: float | Array
) -> tuple[Int[Array, " keep"], Bool[Array, " keep"]]:
    """Indices of the best poses that differ from every better one kept, and whether each slot is filled."""
    sane = jnp.where(jnp.isfinite(scores), scores, jnp.inf)
    if isinstance(apart, float) and apart == 0:
        best, index = jax.lax.top_k(-sane, min(keep, Ts.shape[0]))
        return index, jnp.isfinite(best)

    def pick(remaining: Array, _: None) -> tuple[Array, tuple[Array, Array]]:
        best = jnp.argmin(remaining)
        filled = jnp.isfinite(remaining[best])
        near = (units_apart(Ts, Ts[best]) < apart).at[best].set(True)
        return jnp.where(near, jnp.inf, remaining), (best, filled)

    _, (index, filled) = jax.lax.scan(pick, sane, length=min(keep, Ts.shape[0]))
    return index, filled


@partial(jax.jit, static_argnames=("config", "chunk", "levels"))
def refine_and_score(
    Ts: Float[Array, "n 4 4"],
    score_level: Int[Array, ""] | int,
    evidence: Evidence,
    prior: Prior,
    config: AlignConfig,
    chunk: int | None,
    levels: tuple[int, ...] = (),
) -> tuple[Float[Array, "n 4 4"], Float[Array, " n"]]:
    """Every pose refined on the given levels (none: left where it is), and its score [nats] on one level."""

    def one(T: Array) -> tuple[Array, Array]:
        if levels:
            T = refine(T, evidence, prior, config, jnp.asarray(levels))[0][-1]
        return T, score(T, score_level, evidence, prior, config)

    return in_chunks(one, Ts, chunk)


def _restarted(Ts: Float[Array, "n 4 4"], offsets_m: tuple[float, ...]) -> Float[Array, "m 4 4"]:
    """Every pose at every offset along the road."""
    along = jnp.zeros((len(offsets_m), 3), Ts.dtype).at[:, 0].set(jnp.asarray(offsets_m, Ts.dtype))
    return jax.vmap(lambda T: displaced(T, along))(Ts).reshape(-1, 4, 4)


@stored_program("stage", "config", "chunk")
def cull(
    Ts: Float[Array, "n 4 4"],
    stage: CullStage,
    evidence: Evidence,
    prior: Prior,
    config: AlignConfig,
    chunk: int | None,
) -> tuple[Float[Array, "keep 4 4"], Float[Array, " keep"]]:
    """The surviving poses of a stage and their scores; an empty slot repeats the best pose with an infinite score."""
    thinned = eqx.tree_at(lambda e: e.views, evidence, decimated(evidence.views, stage.keep_every))
    stage_config = dataclasses.replace(config, levels=(), max_steps=stage.max_steps)
    starts = Ts if stage.restarts_m == (0.0,) else _restarted(Ts, stage.restarts_m)
    poses, scores = refine_and_score(starts, stage.score_level, thinned, prior, stage_config, chunk, stage.levels)
    index, filled = keep_distinct(poses, scores, stage.keep, stage.apart)
    return poses[jnp.where(filled, index, index[0])], jnp.where(filled, scores[index], jnp.inf)


def search_from(
    Ts_init: Float[Array, "n 4 4"], evidence: Evidence, prior: Prior, config: AlignConfig, schedule: SearchConfig
) -> tuple[Float[Array, "m 4 4"], Float[Array, " m"]]:
    """Candidate poses after all stages of the schedule, best first, and their scores [nats] (infinite: empty slot)."""
    Ts, scores = Ts_init, jnp.zeros(Ts_init.shape[0], Ts_init.dtype)
    for stage in schedule.stages:
        Ts, scores = cull(Ts, stage, evidence, prior, config, schedule.chunk)
    return Ts, scores


def weigh(estimates: PoseEstimate, scores: Float[Array, " m"]) -> Modes:
    """Modes sorted by score, weighted by their share of the posterior (Laplace approximation)."""
    order = jnp.argsort(scores)
    estimates, scores = jax.tree.map(lambda leaf: leaf[order], estimates), scores[order]
    # Locked directions have no width: the identity stands in for them in the determinant.
    width = estimates.covariance + jnp.eye(6) * (jnp.diagonal(estimates.covariance, axis1=1, axis2=2) <= 0)[:, None, :]
    log_weight = -scores + 0.5 * jnp.linalg.slogdet(width)[1]
    log_weight = jnp.where(jnp.isfinite(scores) & jnp.isfinite(log_weight), log_weight, -jnp.inf)
    any_left = jnp.any(jnp.isfinite(log_weight))
    weight = jnp.where(any_left, jax.nn.softmax(jnp.where(any_left, log_weight, 0.0)), 0.0)
    return Modes(estimates, scores, weight)
