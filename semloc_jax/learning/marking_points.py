"""The network for marking points of slots learns from random top views (room: learning; JAX and host).

In: seeds. Out: batches with what is to be said of each cell, the loss, recall and precision on pictures never seen.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from semloc_jax.learning.sureness import focal_loss
from semloc_jax.perception.networks.dense_net import STRIDE
from semloc_jax.perception.networks.marking_net import METRES_PER_PX, MarkingPoints, levelled_view
from semloc_jax.simulation.top_views.picture import TopViewSample, top_view_sample

_SPREAD_CELLS = 1.0
"""Cells so near to a point are hardly wrong when they say that they have it."""
_OFFSET, _DIRECTION, _CORNER = 1.0, 1.0, 0.2
"""Weights of the parts of the loss beside the confidence; ours."""


class MarkingBatch(NamedTuple):
    """Pictures and what is to be said of their cells."""

    picture: Float[Array | np.ndarray, "b h w 3"]
    heat: Float[Array | np.ndarray, "b i j"]
    """1 in the cell of a point, less around it."""
    asked: Float[Array | np.ndarray, "b i j"]
    """0 where nothing may be asked."""
    told: Float[Array | np.ndarray, "b i j 5"]
    """Offset, direction and corner of the cells of points."""


class TopViewPool:
    """Random top views that are drawn once, and taken turned by right angles and mirrored ever after."""

    def __init__(self, num: int, size_px: int, seed: int) -> None:
        """Draw them.

        Args:
            num: of them.
            size_px: their side.
            seed: picture k is drawn by (seed, k) alone.
        """
        self.samples = [top_view_sample(np.random.default_rng((seed, k)), size_px, METRES_PER_PX) for k in range(num)]

    def batch(self, rng: np.random.Generator, num: int) -> MarkingBatch:
        """Some of them, each in one of its eight positions."""
        chosen = [self.samples[k] for k in rng.integers(len(self.samples), size=num)]
        turned = [moved(sample, int(rng.integers(4)), bool(rng.integers(2))) for sample in chosen]
        return batch_of(turned)


def batch_of(samples: Sequence[TopViewSample]) -> MarkingBatch:
    """The batch of some pictures of one size."""
    parts = [targets(sample) for sample in samples]
    pictures = np.stack([levelled_view(sample.picture) for sample in samples])
    return MarkingBatch(pictures, *(np.stack([part[k] for part in parts]) for k in range(3)))


def moved(sample: TopViewSample, quarters: int, is_mirrored: bool) -> TopViewSample:
    """The picture turned by right angles, from v towards u, after it was mirrored in u."""
    size_m = len(sample.picture) * METRES_PER_PX
    picture, unasked = sample.picture, sample.unasked
    uv, yaw = np.array([point.uv_m for point in sample.points]).reshape(-1, 2), [p.yaw_rad for p in sample.points]
    yaw = np.array(yaw)
    if is_mirrored:
        picture, unasked = picture[:, ::-1], unasked[:, ::-1]
        uv, yaw = uv * [-1.0, 1.0] + [size_m, 0.0], np.pi - yaw
    picture, unasked = np.rot90(picture, quarters), np.rot90(unasked, quarters)
    for _ in range(quarters):
        uv, yaw = np.column_stack([uv[:, 1], size_m - uv[:, 0]]), yaw - 0.5 * np.pi
    points = [p._replace(uv_m=place, yaw_rad=float(a)) for p, place, a in zip(sample.points, uv, yaw, strict=True)]
    return TopViewSample(np.ascontiguousarray(picture), points, unasked)


def targets(sample: TopViewSample) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """heat [i j], asked [i j] and told [i j 5] of one picture."""
    num = len(sample.picture) // STRIDE
    heat, told = np.zeros((num, num), np.float32), np.zeros((num, num, 5), np.float32)
    unasked = sample.unasked.reshape(num, STRIDE, num, STRIDE).any(axis=(1, 3))
    row, column = np.mgrid[:num, :num]
    for point in sample.points:
        at = (point.uv_m / METRES_PER_PX - 0.5 * STRIDE) / STRIDE  # [cells], the centre of the first is 0
        u, v = np.clip(np.rint(at).astype(int), 0, num - 1)
        near = np.exp(-0.5 * ((column - at[0]) ** 2 + (row - at[1]) ** 2) / _SPREAD_CELLS**2)
        heat = np.maximum(heat, np.where((row == v) & (column == u), 1.0, np.minimum(near, 0.95)).astype(np.float32))
        turn = [np.cos(point.yaw_rad), np.sin(point.yaw_rad)]
        told[v, u] = [*(at - [u, v]), *turn, float(point.is_corner)]
    return heat, (~unasked | (heat == 1.0)).astype(np.float32), told


def marking_loss(network: Callable[[Array], Array], batch: MarkingBatch) -> Float[Array, ""]:
    """Focal loss of the confidence (Law and Deng 2018), absolute and squared errors of the cells that have a point."""
    said = jax.vmap(network)(jnp.asarray(batch.picture))
    has = (batch.heat == 1.0).astype(said.dtype)
    num = jnp.maximum(has.sum(), 1.0)
    sureness = focal_loss(said[..., 0], jnp.asarray(batch.heat)) * batch.asked
    off = jnp.abs(said[..., 1:3] - batch.told[..., :2]).sum(axis=-1)
    turned = ((said[..., 3:5] - batch.told[..., 2:4]) ** 2).sum(axis=-1)
    corner = jax.nn.softplus(said[..., 5]) - batch.told[..., 4] * said[..., 5]
    per_point = has * (_OFFSET * off + _DIRECTION * turned + _CORNER * corner)
    return (sureness + per_point).sum() / num


class PointScore(NamedTuple):
    """Counts and errors over some pictures."""

    num_true: int
    num_found: int
    num_right: int
    off_m: tuple[float, ...]
    off_rad: tuple[float, ...]

    @property
    def recall(self) -> float:
        """Share of the points that were found."""
        return self.num_right / max(self.num_true, 1)

    @property
    def precision(self) -> float:
        """Share of what was found that is there."""
        return self.num_right / max(self.num_found, 1)

    def plus(self, other: "PointScore") -> "PointScore":
        """Of both."""
        return PointScore(*(mine + theirs for mine, theirs in zip(self, other, strict=True)))


NOTHING = PointScore(0, 0, 0, (), ())
SAME_M, SAME_RAD = 0.167, np.deg2rad(30.0)
"""A point is found where one is so near and runs so: 10 px of the ps2.0 set of top views."""


def score(
    found: MarkingPoints, true_uv_m: np.ndarray, true_yaw: np.ndarray, metres_per_px: float, unasked: np.ndarray
) -> PointScore:
    """One picture: each true point takes the surest of the points near it.

    Args:
        found: surest first.
        true_uv_m: float64[n 2], from the upper left corner [m].
        true_yaw: float64[n], direction into the slot; NaN where it is not told.
        metres_per_px: of the picture.
        unasked: bool[h w] of the picture: points found there count for nothing.
    """
    open_points, right, off_m, off_rad, counted = set(range(len(true_uv_m))), 0, [], [], 0
    for uv, yaw in zip(found.uv, found.yaw_rad, strict=True):
        place = (uv + 0.5) * metres_per_px
        away = {j: float(np.hypot(*(place - true_uv_m[j]))) for j in open_points}
        turn = {j: abs(float((yaw - true_yaw[j] + np.pi) % (2.0 * np.pi) - np.pi)) for j in open_points}
        near = [j for j in open_points if away[j] < SAME_M and not turn[j] > SAME_RAD]
        if near:
            best = min(near, key=lambda j: away[j])
            open_points.remove(best)
            right, counted = right + 1, counted + 1
            off_m.append(away[best])
            off_rad.append(turn[best])
            continue
        u, v = np.clip(np.rint(uv).astype(int), 0, np.array(unasked.shape[::-1]) - 1)
        counted += not unasked[v, u]
    return PointScore(len(true_uv_m), counted, right, tuple(off_m), tuple(off_rad))
