"""How far what a network says is from what the map says (room: learning; JAX).

In: what it says of cells, labels with their own sigmas. Out: a loss.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.perception.networks.eyes import REACH_PX, Said, read_out

_NEAR_PX, _LEAST_WEIGHT = 8.0, 0.05
"""What lies within this distance of a border decides a pose; what is farther weighs little."""
_INSIDE_WEIGHT = 2.0
"""Of the loss of being inside: where a class is has to be known before how far its border is."""
_FEW_CELLS = 200.0
"""Fewer cells inside, or near a border, than this count for less: a post far away shall not outweigh a crosswalk."""


_ONE_SIGMA = 0.683
"""Of the errors, so many are within one standard deviation."""
_LEAST_PX = 1e-3
"""Errors count as no smaller."""


class Batch(NamedTuple):
    """Crops of images with their labels; b crops, cells are half as many as pixels on each side."""

    picture: Float[Array, "b h w c"]
    signed_px: Float[Array, "b _h _w k"]
    sigma_px: Float[Array, "b _h _w k"]
    weight: Float[Array, "b _h _w"]
    """0 where nothing is known."""
    kept: Float[Array, "b _h _w k"]
    """1 where distance and sigma are not to change: they are what the eyes told before, known or not."""


def eyes_loss(network: eqx.Module, batch: Batch) -> Array:
    """Of the distances to borders, of their sigmas, and a balanced loss of being inside.

    The sigma of an error is the network's and the label's together: what the label does not know the network need not.
    Of distances the absolute error asks for the median: where a dash is there in most images, its distance.
    """
    said = read_out(jax.vmap(network)(batch.picture))
    # A map tells its classes and not what hides it, which eyes tell last.
    said = jax.tree.map(lambda plane: plane[..., : batch.signed_px.shape[-1]], said)
    return jnp.mean(distance_loss(said, batch) + _INSIDE_WEIGHT * inside_loss(said, batch))


def distance_loss(said: Said, batch: Batch) -> Float[Array, " k"]:
    """Of the distances, for each class: cells about its borders weigh as much as all those that have none near.

    A pillar is in one crop of twenty and there has a hundredth of the cells of the floor: counted cell by cell, saying
    that it is far everywhere costs nothing.
    """
    is_near = jnp.abs(batch.signed_px) < REACH_PX
    known = jnp.maximum(batch.weight[..., None], batch.kept)
    near = known * is_near * jnp.maximum(jnp.exp(-jnp.abs(batch.signed_px) / _NEAR_PX), _LEAST_WEIGHT)
    far = known * ~is_near
    told = jnp.where(batch.kept > 0.0, change(said, batch), border_loss(said, batch))
    beyond = beyond_nll(said, batch)
    of_near = jnp.sum(near * told, (0, 1, 2)) / (jnp.sum(near, (0, 1, 2)) + _FEW_CELLS)
    return of_near + jnp.sum(far * beyond, (0, 1, 2)) / jnp.maximum(jnp.sum(far, (0, 1, 2)), 1.0)


def border_loss(said: Said, batch: Batch) -> Float[Array, "b _h _w k"]:
    """Of each cell and class: of the distance, and that 68 % of the errors lie within their sigmas.

    No likelihood: gross errors, a mark that was missed or a border of something else, would widen every sigma, and what
    is unsure, which is what is missed, would hardly be learned: the slope would be one over the sigma. It is one over
    its root (Seitzer et al. 2022), however large the error.
    """
    off = jnp.abs(said.signed_px - batch.signed_px)
    sigma = jnp.sqrt(jnp.exp(2.0 * said.log_sigma) + batch.sigma_px**2)
    beyond = jnp.log(jnp.maximum(jax.lax.stop_gradient(off), _LEAST_PX) / sigma)
    of_sigma = jnp.maximum(_ONE_SIGMA * beyond, (_ONE_SIGMA - 1.0) * beyond)
    return off / jnp.sqrt(jax.lax.stop_gradient(sigma)) + of_sigma


def change(said: Said, batch: Batch) -> Float[Array, "b _h _w k"]:
    """How far what is said has moved from what was said before: the divergence of Laplace's distributions [nats].

    Were that taken for a label with its sigma, the likeliest sigma would be none at all.
    """
    before, off = batch.sigma_px / jnp.sqrt(2.0), jnp.abs(said.signed_px - batch.signed_px)
    now = jnp.exp(said.log_sigma) / jnp.sqrt(2.0)
    return jnp.log(now / before) + (off + before * jnp.exp(-off / before)) / now - 1.0


def beyond_nll(said: Said, batch: Batch) -> Float[Array, "b _h _w k"]:
    """Of no border within reach: that the distance is larger than the label, which is clipped there.

    It falls to zero and not below. Were the label taken for a distance, each such cell would be told exactly, its sigma
    would shrink without end, and a class that is rare would be told far everywhere, and be sure of it.
    """
    side = jnp.where(batch.signed_px < 0.0, -1.0, 1.0)
    past = side * (said.signed_px - batch.signed_px) / _scale(said, batch)
    # Both sides of Laplace's distribution; each is finite, with finite slope, where the other one holds.
    over = -jnp.log1p(-0.5 * jnp.exp(-jnp.maximum(past, 0.0)))
    return jnp.where(past > 0.0, over, jnp.log(2.0) - past)


def _scale(said: Said, batch: Batch) -> Array:
    """Mean absolute error of Laplace's distribution with both sigmas."""
    return jnp.sqrt((jnp.exp(2.0 * said.log_sigma) + batch.sigma_px**2) / 2.0)


def inside_loss(said: Said, batch: Batch) -> Float[Array, " k"]:
    """Of being inside, for each class: cells inside and cells outside count the same in sum, so that what is rare is
    found before it is told well. A label near its border is as unsure as its sigma says."""
    share = jax.scipy.stats.norm.cdf(-batch.signed_px / batch.sigma_px)
    known = batch.weight[..., None] * (1.0 - batch.kept)
    near = known * (0.1 + jnp.exp(-jnp.abs(batch.signed_px) / _NEAR_PX))

    def mean(weight: Array, loss: Array) -> Array:
        return jnp.sum(weight * loss, (0, 1, 2)) / (jnp.sum(weight, (0, 1, 2)) + _FEW_CELLS)

    missed, invented = -jax.nn.log_sigmoid(said.logit), -jax.nn.log_sigmoid(-said.logit)
    return mean(known * share, missed) + mean(near * (1.0 - share), invented)
