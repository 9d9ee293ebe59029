"""One frame aligned from a predicted pose: a few starts along the road, one view, one compiled function (room:
localization; JAX).

In: predicted pose and its prior, one frame, the trust in each map element. Out: TrackedFrame: the best pose, how far
other answers lie from it, and how well each element of the map is seen.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.alignment.along_road import AlongRoadConfig, beyond_reach, places_along
from semloc_jax.alignment.hypotheses import prior_cost, score
from semloc_jax.alignment.level_choice import telling
from semloc_jax.alignment.longitudinal import LongitudinalConfig
from semloc_jax.alignment.other_width import with_other_width
from semloc_jax.alignment.pieces import nats_at
from semloc_jax.alignment.pose import (
    AlignConfig,
    Evidence,
    Prior,
    SolveEnd,
    assess,
    assessed,
    descended,
    fit_at,
    in_chunks,
    total_weight,
    typical_px,
    visible_ramps,
)
from semloc_jax.alignment.proposals import displaced
from semloc_jax.alignment.single_frame import FrameInput
from semloc_jax.cameras import Rig
from semloc_jax.geometry import lie
from semloc_jax.residuals.alignment import CameraViews, camera_views
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.residuals.scoring import sums_by_index
from semloc_jax.residuals.view import ViewConfig, view
from semloc_jax.runtime.stored_program import stored_program
from semloc_jax.structs import PoseEstimate

ELEMENT_CAPACITY = 2048
"""Elements of a local map that statistics are kept for; the rest is used with full trust."""


@dataclass(frozen=True)
class TrackAlignConfig:
    """How a frame is aligned from a prediction. All values are ours."""

    view: ViewConfig = field(default_factory=lambda: ViewConfig(margin_share=0.03, most_alone=10.0))
    align: AlignConfig = field(default_factory=lambda: AlignConfig(levels=(1, 2, 3), max_steps=8))
    starts_m: tuple[float, ...] = (0.0, -0.3, 0.3, -0.6, 0.6)
    """Offsets along the road of the starts: dashes and far poles leave local minima some decimetres apart."""
    score_share: float = 0.5
    """Factor on the cost difference between two local minima [nats]: it overstates which of them is right."""
    valley: AlongRoadConfig = field(
        default_factory=lambda: AlongRoadConfig(reach_m=0.75, num_offsets=11, max_steps=4, by_contours=False)
    )
    """Where the valley along the road through the best pose is measured."""
    longest: float = 25.0
    """A valley that goes on beyond the places measured has at most this many times their variance (sigma 2.4 m)."""
    rank_level: int = 2
    """Level on which the elements are judged, and the coarsest one on which the starts are ranked."""
    search: LongitudinalConfig = field(default_factory=LongitudinalConfig)
    """The search along the road; no drive needed other values."""
    again_offsets: int = 13
    """Places of that search where a solved frame is solved again with another calibration: within 0.9 m of its pose
    they are closer together than those of a prediction that may be metres off, and it is solved from the best one."""


class ElementEvidence(NamedTuple):
    """How the frame sees each element of the local map, by index; zero where it is not in view."""

    visible_px: Float[Array, " element"]
    """Contour on usable pixels [px of weight]."""
    missed_px: Float[Array, " element"]
    """Robust cost of it: between 0 (all of it lies on a boundary of its class) and visible_px (none does)."""
    offset_px: Float[Array, " element"]
    """Weighted sum of signed distances of the part within reach [px^2]."""


class TrackedFrame(NamedTuple):
    """The answer of one frame."""

    estimate: PoseEstimate
    """Pose and quality of the best start, relative to the local origin."""
    score: Float[Array, ""]
    """Cost of the evidence against seeing the map by chance, and of the prior across, in attitude and height [nats]."""
    spread: Float[Array, "6 6"]
    """Second moment of all answers about the best one, in its right tangent, by their share of the posterior."""
    valley: Float[Array, "6 6"]
    """Second moment of the masks' own posterior over places along the road, about its mean."""
    in_view_px: Float[Array, ""]
    """Weighted contour length in view."""
    elements: ElementEvidence
    typical_px: Float[Array, ""]
    """How far the contours within reach lie from the boundaries of their class; see `pose.typical_px`."""
    moved_m: Float[Array, ""] = np.float32(0.0)
    """Correction along the road before the solve."""


@stored_program("config")
def align_predicted(
    T_predicted: Float[Array, "4 4"],
    prior: Prior,
    frame: FrameInput,
    trust: Float[Array, " element"],
    sigma_along_m: Float[Array, ""],
    is_searched: Bool[Array, ""],
    config: TrackAlignConfig,
) -> TrackedFrame:
    """The pose of a frame near a prediction.

    Args:
        T_predicted: Where the vehicle should be, relative to the local origin.
        prior: What holds directions that the masks do not.
        frame: Samples, cost maps, cameras.
        trust: Weight of each map element, 1 for those nothing speaks against.
        sigma_along_m: Standard deviation of the prediction along the road.
        is_searched: Whether the position along the road is searched first, see `longitudinal.is_searched`.
        config: View, levels, starts.
    """
    parts = prior, frame, trust, config
    T_start, moved_m = jax.lax.cond(
        is_searched,
        lambda: moved_along(T_predicted, sigma_along_m, *parts),
        lambda: (T_predicted, jnp.zeros((), T_predicted.dtype)),
    )
    return _aligned(T_start, *parts)._replace(moved_m=moved_m)


class WithRig(NamedTuple):
    """The answers of one frame with other calibrations; NaN for those that were not asked for."""

    Ts_local_base: Float[Array, "rig 4 4"]
    """Relative to the local origin."""
    scores: Float[Array, " rig"]
    """As `TrackedFrame.score` [nats]."""


@stored_program("config")
def align_with_rigs(
    T_predicted: Float[Array, "4 4"],
    prior: Prior,
    frame: FrameInput,
    trust: Float[Array, " element"],
    sigma_along_m: Float[Array, ""],
    rigs: Rig,
    wider_m: Float[Array, " rig"],
    asked: Int[Array, " rig"],
    num_asked: Int[Array, ""],
    config: TrackAlignConfig,
) -> WithRig:
    """The same frame solved with other calibrations in one call, each after a search along the road.

    Args:
        T_predicted, prior, frame, trust, sigma_along_m, config: As `align_predicted`; the rig of the frame is not used.
        rigs: The calibrations; every leaf of the rig has a leading axis.
        wider_m: By how much the road is taken to be wider with each of them than the map has it.
        asked: Which of them, those that are asked for first.
        num_asked: How many of these: the others cost nothing.
    """
    again = replace(config, starts_m=(0.0,), search=replace(config.search, num_offsets=config.again_offsets))

    def one(n: Array, found: WithRig) -> WithRig:
        rig = jax.tree.map(lambda leaf: jnp.asarray(leaf)[asked[n]], rigs)
        own = frame._replace(rig=rig, samples=with_other_width(frame.samples, T_predicted, wider_m[asked[n]]))
        # What is seen of the map is chosen anew from there: a longer lens farther back shows what its own one shows.
        T_start, _ = moved_along(T_predicted, sigma_along_m, prior, own, trust, again)
        answer = _aligned(T_start, prior, own, trust, again)
        Ts = found.Ts_local_base.at[asked[n]].set(answer.estimate.T_local_base)
        return WithRig(Ts, found.scores.at[asked[n]].set(answer.score))

    none = jnp.full(asked.shape, jnp.nan, T_predicted.dtype)
    return jax.lax.fori_loop(0, num_asked, one, WithRig(none[:, None, None] + T_predicted, none))


def moved_along(
    T_predicted: Float[Array, "4 4"],
    sigma_m: Float[Array, ""],
    prior: Prior,
    frame: FrameInput,
    trust: Float[Array, " element"],
    config: TrackAlignConfig,
) -> tuple[Float[Array, "4 4"], Float[Array, ""]]:
    """A predicted pose moved to where stop lines, dash ends, poles and signs fit best, and by how much [m]; `sigma_m`:
    standard deviation of the prediction along the road."""
    search = config.search
    evidence, _ = trusted_evidence(T_predicted, frame, trust, config.view)
    reach_m = jnp.clip(search.reach_sigmas * sigma_m, search.basin_m, search.max_reach_m)
    offsets_m = jnp.linspace(-reach_m, reach_m, search.num_offsets, dtype=T_predicted.dtype)
    moved = displaced(T_predicted, jnp.zeros((search.num_offsets, 3), T_predicted.dtype).at[:, 0].set(offsets_m))
    free = eqx.tree_at(lambda p: p.sigma, prior, prior.sigma.at[0].set(jnp.inf))
    held = jax.vmap(prior_cost, (0, None))(moved, free)
    costs = jnp.sum(nats_at(moved, T_predicted, search.level, evidence, config.align, None), axis=1) + held
    # The prior of a solve is loose; which of several dashes is meant, the prediction itself helps to tell.
    best_m = offsets_m[jnp.argmin(config.score_share * costs + 0.5 * (offsets_m / sigma_m) ** 2)]
    return T_predicted.at[:3, 3].add(best_m * T_predicted[:3, 0]), best_m


def _aligned(
    T_predicted: Float[Array, "4 4"],
    prior: Prior,
    frame: FrameInput,
    trust: Float[Array, " element"],
    config: TrackAlignConfig,
) -> TrackedFrame:
    """The pose near `T_predicted`, from which the map is seen."""
    evidence, element = trusted_evidence(T_predicted, frame, trust, config.view)
    along = jnp.zeros((len(config.starts_m), 3), T_predicted.dtype)
    starts = displaced(T_predicted, along.at[:, 0].set(jnp.asarray(config.starts_m, T_predicted.dtype)))

    level = telling(frame.textures.ramp_px, config.align.noise.noise_px * frame.grain, config.rank_level)

    def one(T_start: Array) -> tuple[SolveEnd, Array]:
        end = descended(T_start, evidence, prior, config.align)
        return end, score(end.T_local_base, level, evidence, prior, config.align)

    ends, scores = in_chunks(one, starts, None)
    scores = jnp.where(jnp.isfinite(scores), scores, jnp.inf)
    best = jax.tree.map(lambda leaf: leaf[jnp.argmin(scores)], ends)
    chosen = assessed(best, assess(best.T_local_base, best.level, evidence, prior, config.align))
    judged = fit_at(chosen.T_local_base, level, evidence, config.align)
    chosen = eqx.tree_at(lambda e: (e.cost, e.inlier_ratio), chosen, (judged.cost, judged.inlier_ratio))
    steps = lie.log(lie.inverse(chosen.T_local_base) @ ends.T_local_base)
    spread = _spread(ends.T_local_base, scores, steps, prior, config.score_share)
    mean, valley, nats = valley_along(chosen.T_local_base, evidence, prior, config)
    chosen = eqx.tree_at(lambda e: e.T_local_base, chosen, chosen.T_local_base @ lie.exp(mean))
    seen = element_evidence(chosen.T_local_base, evidence, element, config)
    return TrackedFrame(
        estimate=chosen,
        score=nats,
        spread=spread,
        valley=valley,
        in_view_px=total_weight(evidence.views),
        elements=seen,
        typical_px=typical_px(chosen.T_local_base, config.rank_level, evidence, config.align),
    )


def _spread(
    Ts: Float[Array, "start 4 4"],
    scores: Float[Array, " start"],
    steps: Float[Array, "start 6"],
    prior: Prior,
    share: float,
) -> Float[Array, "6 6"]:
    """Second moment of the answers about the best one; the prior counts in full, the masks by a share."""
    held = jax.vmap(prior_cost, (0, None))(Ts, prior)
    weight = jax.nn.softmax(-jnp.where(jnp.isfinite(scores), share * (scores - held) + held, jnp.inf))
    finite = jnp.where(jnp.isfinite(steps), steps, 0.0)
    return jnp.einsum("s,si,sj->ij", weight, finite, finite)


def valley_along(
    T_local_base: Float[Array, "4 4"], evidence: Evidence, prior: Prior, config: TrackAlignConfig
) -> tuple[Float[Array, "6"], Float[Array, "6 6"], Float[Array, ""]]:
    """Mean of the masks' posterior along the road through a pose, in its right tangent, second moment about it, and
    the cost of the best place [nats].

    Every place is solved in all other directions: a nod of the vehicle makes up for a shift along the road. What is
    left is often a valley of decimetres with a minimum at every rounding of a pixel. A solve stops in the one next to
    its prediction, and its curvature says centimetres: fused, the prediction would confirm itself.
    """
    free = eqx.tree_at(lambda p: p.sigma, prior, prior.sigma.at[0].set(jnp.inf))  # 0 would lock it
    Ts, scores, noise = places_along(T_local_base, evidence, free, config.align, config.valley, None)
    steps = lie.log(lie.inverse(T_local_base) @ Ts)
    usable = jnp.isfinite(scores) & jnp.all(jnp.isfinite(steps), axis=1)
    held = jax.vmap(prior_cost, (0, None))(Ts, free)
    share = jax.nn.softmax(jnp.where(usable, -((scores - held) / noise**2 + held), -1e9))
    share, steps = jnp.where(usable, share, 0.0), jnp.where(usable[:, None], steps, 0.0)
    mean = share @ steps
    valley = jnp.einsum("s,si,sj->ij", share, steps - mean, steps - mean)
    return *beyond_reach(mean, valley, steps[:, 0], config.longest), jnp.min(scores)


@stored_program("config")
def profile_beside(
    T_predicted: Float[Array, "4 4"],
    moves: Float[Array, "n 3"],
    prior: Prior,
    frame: FrameInput,
    trust: Float[Array, " element"],
    config: TrackAlignConfig,
    level: Int[Array, ""] | int,
) -> Float[Array, " n"]:
    """Cost [nats] of the predicted pose after each move (forward [m], left [m], turned [rad]), against seeing the map
    by chance; one level, no refinement."""
    evidence, _ = trusted_evidence(T_predicted, frame, trust, config.view)
    moved = displaced(T_predicted, moves.astype(T_predicted.dtype))
    held = jax.vmap(prior_cost, (0, None))(moved, prior)
    return jnp.sum(nats_at(moved, T_predicted, level, evidence, config.align, None), axis=1) + held


def trusted_evidence(
    T_local_base: Float[Array, "4 4"], frame: FrameInput, trust: Float[Array, " element"], config: ViewConfig
) -> tuple[Evidence, tuple[Array, ...]]:
    """The evidence of a frame as seen from a pose, each element weighted by its trust; and the element of each sample
    of each group of cameras, in the order of the views."""
    samples = view(frame.samples, T_local_base, frame.rig, frame.channel_of_label, config, frame.grain)
    known = (samples.element >= 0) & (samples.element < trust.shape[0])
    index = jnp.clip(samples.element, 0, trust.shape[0] - 1)
    weight = samples.weight * jnp.where(known, trust[index], 1.0).astype(samples.weight.dtype)
    samples = eqx.tree_at(lambda s: s.weight, samples, weight)
    views: tuple[CameraViews, ...] = camera_views(frame.rig, samples)
    element = tuple(jnp.where(known, samples.element, -1)[v.index] for v in views)
    return Evidence(views, frame.textures, frame.usable, frame.grain), element


def element_evidence(
    T_local_base: Float[Array, "4 4"], evidence: Evidence, element: tuple[Array, ...], config: TrackAlignConfig
) -> ElementEvidence:
    """How a pose explains each element, from the level of `config.rank_level`."""
    loss = LOSSES[config.align.loss]
    r, weight = visible_ramps(T_local_base, config.rank_level, evidence, config.align)
    owner = jnp.concatenate([part.reshape(-1) for part in element])
    owner = jnp.where(owner >= 0, owner, ELEMENT_CAPACITY)

    missed_px = weight * loss.rho(r) / loss.worst
    offset_px = weight * loss.weight(r) * r * evidence.textures.ramp_px[config.rank_level]
    terms = jnp.stack([weight, missed_px, offset_px])
    return ElementEvidence(*sums_by_index(terms, owner, ELEMENT_CAPACITY + 1, config.align.path)[:, :-1])
