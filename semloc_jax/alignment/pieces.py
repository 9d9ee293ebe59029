"""What a pose costs by pieces of contour, each of which the masks may have missed (room: alignment; pure JAX).

In: poses, evidence. Out: nats of each pose. A piece is as much contour as makes one independent observation.
Contour that lies on no boundary was either missed (worn, hidden, not found by the segmenter) or speaks against the
pose. The likelihood of one observation is P exp(-nats) / p0 + 1 - P, with P how often the masks of this frame show what
the map has and p0 how often a piece fits by chance: what is missed costs -log(1 - P) and no more. Without that bound, a
post that the segmenter never finds costs more than many good observations hold, until the pose has moved so far that
it is out of view. `evidence_null` weighs modes by the same likelihood.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.alignment.pose import AlignConfig, Evidence, in_chunks
from semloc_jax.alignment.proposals import displaced
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.residuals.scoring import sums_by_piece

_USUAL_RATE = 0.6
"""How often masks show what the map has, before the frame is looked at; as for `evidence_null.NullConfig`."""
_RATE_STRENGTH = 6.0
"""Number of observations that `_USUAL_RATE` counts; as there."""
_ROUNDS = 4
"""Of estimating the rates at one pose. Ours."""
_BY_CHANCE = (0.02, 0.5)
"""Least and largest share of pieces that fit at a random pose: few random poses tell no smaller one. Ours."""
_MOST_AT_ONCE = 1 << 20
"""Numbers of an array that is made and summed in one go: 4 MB, see `runtime.allocator`."""
_LEAST_OBSERVATIONS = 0.5
"""Of a channel of which less is visible, what is seen does not stand for the rest. Ours."""
_ELSEWHERE = tuple(
    (along_m, side * across_m, -side * math.radians(yaw_deg))
    for side in (-1.0, 1.0)
    for along_m, across_m, yaw_deg in ((-4.0, 0.8, 4.0), (3.0, 1.6, 9.0), (-2.0, 2.6, 0.0), (5.0, 4.0, -15.0))
)
"""Poses (x, y [m], heading [rad]) about a good one that are surely wrong: they tell what fits by chance. Ours."""


class PieceCosts(NamedTuple):
    """How poses see each piece."""

    nats: Float[Array, "*pose piece"]
    """Robust cost of one observation of the piece."""
    observations: Float[Array, "*pose piece"]
    """How much of one observation is visible, 0 to 1."""


def pieces_of(evidence: Evidence, config: AlignConfig) -> tuple[Int[Array, " n"], Int[Array, " n"]]:
    """The piece of every sample, in the order of `alignment_residual`, and the channel of every piece."""
    length_px = jnp.asarray(config.noise.correlation_px * evidence.grain)
    piece = [jax.vmap(_runs, (0, 0, None))(view.edge, view.weight, length_px) for view in evidence.views]
    counts = [part.size for part in piece]
    first = [sum(counts[:k]) for k in range(len(counts))]
    flat = [
        (part + jnp.arange(part.shape[0])[:, None] * part.shape[1] + start).reshape(-1)
        for part, start in zip(piece, first, strict=True)
    ]
    piece_of = jnp.concatenate(flat)
    channel = jnp.concatenate([view.channel.reshape(-1) for view in evidence.views])
    return piece_of, jax.ops.segment_max(channel, piece_of, len(piece_of))


def _runs(edge: Int[Array, " p"], weight: Float[Array, " p"], length_px: Float[Array, ""]) -> Int[Array, " p"]:
    """Number of the piece of each sample of one camera: consecutive samples of one edge, of one length."""
    changes = jnp.concatenate([jnp.ones(1, bool), edge[1:] != edge[:-1]])
    before_px = jnp.cumsum(weight) - weight
    since_px = before_px - jax.lax.cummax(jnp.where(changes, before_px, 0.0))
    part = jnp.floor(since_px / length_px).astype(jnp.int32)
    goes_on = jnp.concatenate([jnp.zeros(1, bool), part[1:] == part[:-1]]) & ~changes
    return jnp.cumsum(~goes_on) - 1


def piece_costs(
    T_local_base: Float[Array, "4 4"],
    level: Int[Array, ""] | int,
    evidence: Evidence,
    piece_of: Int[Array, " n"],
    config: AlignConfig,
) -> PieceCosts:
    """The pieces as one pose sees them on one level of the cost maps."""
    texture, loss = evidence.textures.level(level), LOSSES[config.loss]
    known = texture, evidence.usable, loss, config.border_px, config.path
    seen_px, summed = sums_by_piece(T_local_base, evidence.views, piece_of, *known)
    length_px = jnp.asarray(config.noise.correlation_px * evidence.grain)
    of_one = config.noise.gain(texture.ramp_px, evidence.grain) * length_px
    return PieceCosts(of_one * summed / jnp.maximum(seen_px, 1e-6), jnp.minimum(seen_px / length_px, 1.0))


class Chances(NamedTuple):
    """What the masks of one frame are like."""

    detection: Float[Array, " channel"]
    """How often they show what the map has."""
    by_chance: Float[Array, " channel"]
    """Mean of exp(-nats) of a piece that is held against them at a random pose."""


def nats_at(
    Ts_local_base: Float[Array, "pose 4 4"],
    T_good: Float[Array, "4 4"],
    level: Int[Array, ""] | int,
    evidence: Evidence,
    config: AlignConfig,
    chunk: int | None = 1,
) -> Float[Array, "pose piece"]:
    """Cost [nats] of poses by piece, against seeing the map by chance.

    Args:
        Ts_local_base: Poses that are compared; the best of them tells what the masks are like.
        T_good: About this one, poses that are surely wrong tell what fits by chance.
        level: Of the cost maps.
        evidence: What the cameras saw.
        config: Robust loss and noise.
        chunk: Poses side by side; None for what suits the device.
    """
    at_poses, at_random, _, channel = _looked_at(Ts_local_base, T_good, level, evidence, config, chunk)
    return compared(at_poses, at_random, channel, evidence.textures.num_channels)


def nats_of_groups(
    Ts_local_base: Float[Array, "pose 4 4"],
    T_good: Float[Array, "4 4"],
    level: Int[Array, ""] | int,
    evidence: Evidence,
    groups: Float[Array, "group n"],
    slides: Bool[Array, " group"],
    config: AlignConfig,
) -> Float[Array, "group pose"]:
    """Cost [nats] of poses by parts of the map against the good pose, each as if it were all that the map has.

    Args:
        groups: 1 for the samples that belong to each group, in the order of `alignment_residual`, else 0. A piece
            belongs to the groups that most of its samples are in.
        slides: Whether a group may go out of sight as it is slid along itself: what lies on one side, a few bars under
            parked cars, may. Such a one is compared by what both poses see (`against_first`); of all lines or all posts
            what is seen stands for what is not, as in `nats_at`, and tells sooner.

    The other arguments as `nats_at`.
    """
    poses = jnp.concatenate([T_good[None], Ts_local_base])
    at_poses, at_random, piece_of, channel = _looked_at(poses, T_good, level, evidence, config, None)
    num_samples = jax.ops.segment_sum(jnp.ones_like(groups[0]), piece_of, len(piece_of))

    kept = 2.0 * jax.vmap(lambda group: jax.ops.segment_sum(group, piece_of, len(piece_of)))(groups) > num_samples

    def of_groups(
        at_poses: PieceCosts, at_random: PieceCosts, channel: Array, kept: Bool[Array, "group piece"]
    ) -> Float[Array, "group pose"]:
        def of_one(group: tuple[Bool[Array, " piece"], Bool[Array, ""]]) -> Float[Array, " pose"]:
            kept, may_slide = group
            own = [PieceCosts(c.nats, jnp.where(kept, c.observations, 0.0)) for c in (at_poses, at_random)]
            known = (*own, channel, evidence.textures.num_channels)

            def all_of_it() -> Float[Array, " pose"]:
                nats = jnp.sum(compared(*known), axis=1)
                return nats[1:] - nats[0]

            return jax.lax.cond(may_slide, lambda: against_first(*known), all_of_it)

        return jax.lax.map(of_one, (kept, slides))

    return _of_seen(of_groups, evidence, at_poses, at_random, channel, kept)


_FEW = 4
"""Pieces of a camera are fewer than a quarter of its samples as a rule: usual contours have several samples a piece."""


def _of_seen(
    work: Callable[..., Array], evidence: Evidence, at_poses: PieceCosts, at_random: PieceCosts, *columns: Array
) -> Array:
    """`work` with as many pieces as there are as a rule, which come first, else with all there is room for: a
    comparison takes an exponential and a logarithm of each pose and piece.

    Args:
        work: A function of the arguments that come after the next, with any number of pieces; those without
            observations say nothing.
        evidence: Whose views the pieces are of.
        at_poses: Costs of the poses.
        at_random: Of poses that are surely wrong.
        columns: What else is known, with pieces along the last axis.
    """
    capacity = evidence.views[0].weight.shape[1]
    few, known = max(capacity // _FEW, 1), (at_poses, at_random, *columns)

    def by_camera(leaf: Array) -> Array:
        return leaf.reshape(*leaf.shape[:-1], -1, capacity)

    def with_few() -> Array:
        first = jax.tree.map(lambda leaf: by_camera(leaf)[..., :few], known)
        return work(*jax.tree.map(lambda leaf: leaf.reshape(*leaf.shape[:-2], -1), first))

    beyond = [by_camera(costs.observations)[..., few:] > 0 for costs in (at_poses, at_random)]
    return jax.lax.cond(jnp.any(beyond[0]) | jnp.any(beyond[1]), lambda: work(*known), with_few)


def against_first(
    costs: PieceCosts, at_random: PieceCosts, channel: Int[Array, " piece"], num_channels: int
) -> Float[Array, " pose"]:
    """Cost [nats] of every pose but the first, against the first, by what both see.

    A few bars of slots that are slid along themselves, under parked cars, fit as well as before in what is left of
    them: taken for all of them, that would be better than the first pose, which also sees those that masks have missed.

    Args:
        costs: Of the poses, `[pose piece]`.
        at_random: Of poses that are surely wrong.
        channel: Of every piece.
        num_channels: Of the masks.
    """
    nats = _against_chance(costs, channel, _masks_at_best(costs, at_random, channel, num_channels))
    both = jnp.minimum(costs.observations[1:], costs.observations[0])
    return jnp.sum((nats[1:] - nats[0]) * both, axis=1)


def _looked_at(
    Ts_local_base: Array, T_good: Array, level: Array | int, evidence: Evidence, config: AlignConfig, chunk: int | None
) -> tuple[PieceCosts, PieceCosts, Array, Array]:
    """Costs at the poses and at random ones; the piece of every sample, the channel of every piece."""
    piece_of, channel = pieces_of(evidence, config)
    elsewhere = displaced(T_good, jnp.asarray(_ELSEWHERE, T_good.dtype))
    poses = jnp.concatenate([Ts_local_base, elsewhere])
    costs = in_chunks(lambda T: piece_costs(T, level, evidence, piece_of, config), poses, chunk)
    num = len(Ts_local_base)
    at_poses, at_random = (jax.tree.map(lambda leaf, k=part: leaf[k], costs) for part in (slice(num), slice(num, None)))
    return at_poses, at_random, piece_of, channel


def chances(at_best: PieceCosts, at_random: PieceCosts, channel: Int[Array, " piece"], num_channels: int) -> Chances:
    """What the masks of a frame are like, told by a good pose and by random ones.

    Args:
        at_best: Costs of one pose.
        at_random: Of poses that are surely wrong.
        channel: Of every piece.
        num_channels: Of the masks.
    """

    by_channel = partial(_by_channel, channel=channel, num_channels=num_channels)
    matched = by_channel(jnp.sum(jnp.exp(-at_random.nats) * at_random.observations, axis=0))
    looked_at = by_channel(jnp.sum(at_random.observations, axis=0))
    by_chance = jnp.clip(matched / jnp.maximum(looked_at, 1e-6), *_BY_CHANCE)
    total = by_channel(at_best.observations)

    def better(_: Array, rate: Float[Array, " channel"]) -> Float[Array, " channel"]:
        odds = (jnp.log(rate / (1 - rate)) - jnp.log(by_chance))[channel] - at_best.nats
        found = by_channel(jax.nn.sigmoid(odds) * at_best.observations)
        return (found + _USUAL_RATE * _RATE_STRENGTH) / (total + _RATE_STRENGTH)

    # A loop, not a chain: it is compiled once.
    return Chances(jax.lax.fori_loop(0, _ROUNDS, better, jnp.full_like(total, _USUAL_RATE)), by_chance)


def _by_channel(
    values: Float[Array, "*pose piece"], channel: Int[Array, " piece"], num_channels: int
) -> Float[Array, "*pose channel"]:
    """Sums over the pieces of each channel: all at once, or, where that would be a large block, which the system clears
    anew for every call, one channel after another."""
    channels = jnp.arange(num_channels)
    if num_channels * values.size <= _MOST_AT_ONCE:
        return jnp.sum(jnp.where(channel == channels[:, None], values[..., None, :], 0.0), axis=-1)
    of_each = jax.lax.map(lambda k: jnp.sum(jnp.where(channel == k, values, 0.0), axis=-1), channels)
    return jnp.moveaxis(of_each, 0, -1)


def nats_by_piece(costs: PieceCosts, channel: Int[Array, " piece"], masks: Chances) -> Float[Array, "pose piece"]:
    """Cost [nats] of every pose by piece, against seeing the map by chance.

    What one pose sees of a channel stands for as much of it as the pose does that sees most: none gains or loses by
    looking away.
    """
    nats = _against_chance(costs, channel, masks) * costs.observations
    num_channels = masks.detection.shape[0]
    visible = _by_channel(costs.observations, channel, num_channels)
    stands_for = jnp.max(visible, axis=0) / jnp.maximum(visible, _LEAST_OBSERVATIONS)
    return nats * stands_for[:, channel]


def _against_chance(costs: PieceCosts, channel: Int[Array, " piece"], masks: Chances) -> Float[Array, "pose piece"]:
    """Cost [nats] of one observation of each piece, against seeing it by chance."""
    rate, by_chance = masks.detection[channel], masks.by_chance[channel]
    return -jnp.log((1 - rate) + rate * jnp.exp(-costs.nats) / by_chance)


def believed(nats: Float[Array, "pose piece"], best: Int[Array, ""], least: float) -> Float[Array, " pose"]:
    """How far the nats of one pose over each other one may be believed, `least` to 1.

    In full where many pieces say the same; less where few of them, or a small majority, decide. `posterior.temper` does
    it for parts of the image.
    """
    difference = nats - nats[best]
    total = jnp.sum(difference, axis=1)
    num = jnp.maximum(jnp.sum(difference != 0, axis=1), 2)
    about = jnp.where(difference != 0, difference - (total / num)[:, None], 0.0)
    variance = num * jnp.sum(about**2, axis=1) / (num - 1)
    return jnp.clip(2.0 * jnp.abs(total) / jnp.maximum(variance, 1e-9), least, 1.0)


def compared(
    costs: PieceCosts, at_random: PieceCosts, channel: Int[Array, " piece"], num_channels: int
) -> Float[Array, "pose piece"]:
    """Cost [nats] of every pose by piece, against seeing the map by chance; the best one tells what masks are like."""
    return nats_by_piece(costs, channel, _masks_at_best(costs, at_random, channel, num_channels))


def _masks_at_best(
    costs: PieceCosts, at_random: PieceCosts, channel: Int[Array, " piece"], num_channels: int
) -> Chances:
    simple = jnp.sum(costs.nats * costs.observations, axis=1) / jnp.maximum(jnp.sum(costs.observations, axis=1), 1.0)
    best = jnp.nanargmin(simple)
    return chances(jax.tree.map(lambda leaf: leaf[best], costs), at_random, channel, num_channels)
