"""How far along the road the masks leave a frame open (room: alignment; pure JAX).

In: the best pose of a search. Out: RoadPosterior: poses at other places along the road, each aligned in all else, and
the spread of the posterior over them.
Dashes and far stripes leave a flat and rugged valley along the road, in which a search keeps one local minimum after
another of the same place. Curvature at any of them says nothing about the length of the valley: that is measured.
"""

import dataclasses
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from semloc_jax.alignment.hypotheses import keep_distinct, prior_cost
from semloc_jax.alignment.level_choice import telling
from semloc_jax.alignment.pieces import believed, nats_at
from semloc_jax.alignment.pose import AlignConfig, Evidence, Prior, assess, in_chunks, refine, scatter_px, visible_views
from semloc_jax.geometry import lie
from semloc_jax.residuals.contour_rows import contour_information
from semloc_jax.residuals.pose_terms import terms_equations
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.residuals.scoring import ramp_values
from semloc_jax.runtime.stored_program import stored_program


@dataclass(frozen=True)
class AlongRoadConfig:
    """Where the valley is measured. All values are ours."""

    reach_m: float = 2.0
    """To both sides. A pose whose posterior reaches farther is too uncertain to be used anyway."""
    num_offsets: int = 41
    level: int = 2
    """Coarsest level of the cost maps on which places are compared; in fine masks it is a finer one, see
    `level_choice.telling`."""
    least_believed: float = 0.1
    """Share of the nats between two places that counts even where few pieces decide; see `pieces.believed`."""
    max_steps: int = 5
    keep: int = 2
    """Poses that are handed on to the last refinement."""
    apart: float = 0.6
    """They are at least this many units apart; see `alignment.same_pose`."""
    by_contours: bool = True
    """Whether the way along the road is told by displacements across contours. Slopes of the masks are rough along a
    contour as well, and put places beside two plain lines 13 cm aside for each metre: solves of few steps do not all
    come back, and the valley looks shorter than it is. `track` learns from the drive how large errors are, and what it
    takes them for at first was measured with slopes."""


class RoadPosterior(NamedTuple):
    """The posterior along the road."""

    Ts_local_base: Float[Array, "keep 4 4"]
    """The best poses that differ, relative to the local origin."""
    scores: Float[Array, " keep"]
    """Their costs [nats]; infinite: empty slot."""
    spread: Float[Array, "6 6"]
    """Second moment about the best pose, in its right tangent [m, rad]."""
    places: Float[Array, "n 4 4"]
    """Every pose that was looked at."""
    log_masks: Float[Array, " n"]
    """Log likelihood of the masks at each; -inf where there is none."""
    log_prior: Float[Array, " n"]
    """Log prior at each."""


class Places(NamedTuple):
    """Poses along the road through one of them, each solved in all other directions."""

    Ts_local_base: Float[Array, "n 4 4"]
    scores: Float[Array, " n"]
    """Their costs [nats]; infinite where there is none."""
    noise: Float[Array, ""]
    """Scatter of the boundaries in this frame over what is assumed: costs of the masks are worth 1 / noise^2."""


def places_along(
    T_local_base: Float[Array, "4 4"],
    evidence: Evidence,
    prior: Prior,
    align: AlignConfig,
    config: AlongRoadConfig,
    chunk: int | None,
) -> Places:
    """Poses along the road; arguments as `weighed_along_road`. A prior along it is in their costs, but holds none."""
    offsets_m = jnp.linspace(-config.reach_m, config.reach_m, config.num_offsets, dtype=T_local_base.dtype)
    offsets_m = jnp.where(prior.sigma[0] > 0, offsets_m, 0.0)  # a locked direction stays locked
    still = eqx.tree_at(lambda p: p.sigma, prior, prior.sigma.at[0].set(0.0))
    short = dataclasses.replace(align, max_steps=config.max_steps)
    level = telling(evidence.textures.ramp_px, align.noise.noise_px * evidence.grain, config.level)

    starts = T_local_base @ lie.exp(offsets_m[:, None] * _valley(T_local_base, level, evidence, prior, align, config))
    Ts = in_chunks(lambda T: refine(T, evidence, still, short, level[None])[0][-1], starts, chunk)
    held = jax.vmap(prior_cost, (0, None))(Ts, prior)
    by_piece = nats_at(Ts, T_local_base, level, evidence, align, chunk)
    nats = jnp.sum(by_piece, axis=1)
    best = jnp.nanargmin(nats + held)
    scores = nats[best] + believed(by_piece, best, config.least_believed) * (nats - nats[best]) + held
    ramp_px = evidence.textures.level(level).ramp_px
    noise = align.noise.excess(scatter_px(Ts[best], level, evidence, align), ramp_px, evidence.grain)
    return Places(Ts, jnp.where(jnp.isfinite(scores), scores, jnp.inf), noise)


def _valley(
    T_local_base: Float[Array, "4 4"],
    level: Int[Array, ""] | int,
    evidence: Evidence,
    prior: Prior,
    align: AlignConfig,
    config: AlongRoadConfig,
) -> Float[Array, "6"]:
    """Which way the pose goes for each metre along the road, in its right tangent: sideways where the vehicle does not
    look along the road, with a nod where that hides a shift. Solves of few steps do not find back from beside it."""
    if not config.by_contours:
        loose = eqx.tree_at(lambda p: p.sigma, prior, prior.sigma.at[0].set(config.reach_m))
        column = assess(T_local_base, level, evidence, loose, align).covariance[:, 0]
        return jnp.where(jnp.isfinite(column), column / column[0], 0.0).at[0].set(1.0)
    views, texture = visible_views(T_local_base, evidence, align.border_px, align.path), evidence.textures.level(level)
    r, weight = ramp_values(T_local_base, views, texture, align.path)
    excess = align.noise.excess(scatter_px(T_local_base, level, evidence, align), texture.ramp_px, evidence.grain)
    gain = align.noise.gain(texture.ramp_px, evidence.grain) / (texture.ramp_px * excess) ** 2
    information = contour_information(T_local_base, views, gain * weight * LOSSES[align.loss].weight(r))
    sigma = prior.sigma.at[0].set(config.reach_m)
    known = information + terms_equations(prior.terms, T_local_base).hessian
    column = sigma * jnp.linalg.inv(sigma[:, None] * known * sigma + jnp.eye(6, dtype=sigma.dtype))[:, 0]
    return jnp.where(jnp.isfinite(column), column / column[0], 0.0).at[0].set(1.0)


@stored_program("align", "config", "chunk")
def weighed_along_road(
    T_local_base: Float[Array, "4 4"],
    evidence: Evidence,
    prior: Prior,
    align: AlignConfig,
    config: AlongRoadConfig,
    chunk: int | None,
) -> RoadPosterior:
    """The posterior over places along the road through the best pose of a search.

    Args:
        T_local_base: The best pose of a search, relative to the local origin.
        evidence: What the cameras saw, with the map as seen from there.
        prior: Gaussian prior.
        align: Robust loss and noise.
        config: Offsets and level.
        chunk: Poses side by side; None for what suits the device.
    """
    Ts, scores, noise = places_along(T_local_base, evidence, prior, align, config, chunk)
    index, filled = keep_distinct(Ts, scores, config.keep, config.apart)
    away = lie.log(lie.inverse(Ts[index[0]]) @ Ts)
    guessed = jax.vmap(prior_cost, (0, None))(Ts, prior)
    share = jax.nn.softmax(-((scores - guessed) / noise**2 + guessed))
    spread = jnp.einsum("k,ki,kj->ij", share, away, away)
    spread = jnp.where(jnp.all(jnp.isfinite(spread)), spread, 0.0)
    return RoadPosterior(
        Ts[index], jnp.where(filled, scores[index], jnp.inf), spread, Ts, -(scores - guessed) / noise**2, -guessed
    )


def widened(covariance: Float[Array, "6 6"], spread: Float[Array, "6 6"]) -> Float[Array, "6 6"]:
    """The covariance with as much of the spread added that its longitudinal sigma is at least that of the posterior."""
    known = covariance[0, 0] / jnp.maximum(spread[0, 0], 1e-12)
    return covariance + jnp.maximum(1.0 - known, 0.0) * spread


def beyond_reach(
    mean: Float[Array, "6"], moment: Float[Array, "6 6"], offsets_m: Float[Array, " n"], longest: float
) -> tuple[Float[Array, "6"], Float[Array, "6 6"]]:
    """Mean and second moment about it of a posterior that may go on beyond the places where it was measured.

    Where the masks say nothing, the measured mean is the middle of the places, with their spread: that much information
    is theirs and is taken off. Without that, a prediction in their middle would confirm itself.

    Args:
        mean: Of the posterior over the places, in the right tangent of the middle one.
        moment: Second moment about it.
        offsets_m: Where the places are along the road, evenly around 0.
        longest: Most that the variance grows.
    """
    of_places = jnp.maximum(jnp.mean(offsets_m**2), 1e-12)
    grown = 1.0 / jnp.maximum(1.0 - moment[0, 0] / of_places, 1.0 / longest)
    # The mean moves away from the middle as well, yet no farther than anyone looked.
    inside = jnp.max(jnp.abs(offsets_m)) / jnp.maximum(jnp.abs(mean[0]), 1e-12)
    return mean * jnp.minimum(grown, inside), moment * grown
