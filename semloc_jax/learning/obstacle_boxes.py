"""The network for obstacles learns from random views on a cylinder (room: learning; JAX and host).

In: seeds. Out: batches with what is to be said of each cell, and the loss.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from semloc_jax.learning.sureness import focal_loss
from semloc_jax.perception.networks.dense_net import STRIDE
from semloc_jax.perception.networks.obstacle_net import FAR, KINDS, NEAR, PX_PER_RAD, SIDE_PX, ScaledRows, prepared
from semloc_jax.simulation.cylinder_views.picture import CylinderSample, Geometry, SeenThing, cylinder_sample

LEAST_PX = (4.0, 8.0)
"""Nothing is asked of what is narrower or lower [px]."""
MOST_M = 10.0
"""Nor of what stands farther off."""
_LEAST_SHOWN = 0.3
"""Nor of what is hidden but for this share."""
_SPREAD, _SPREAD_CELLS = 0.1, (0.5, 4.0)
"""Standard deviation of the heat around a middle: share of the sides of the box, within these limits [cells]."""
_TELLS = 0.3
"""Cells with so much heat tell the box too."""
_BOX, _FOOT, _HAS_FOOT = 1.0, 1.0, 0.2
"""Weights of the parts of the loss beside the confidence; ours."""
_ABOUT_THINGS = 0.65
"""Share of windows that are cut about a thing."""
LOW_M = {NEAR: (0.6, 5.5), FAR: (2.3, 13.0)}
"""Where in the two looks what is low stands: a metre or more beyond where the other one tells it."""


class ObstacleBatch(NamedTuple):
    """Pictures and what is to be said of their cells."""

    picture: Float[Array | np.ndarray, "b h w 4"]
    heat: Float[Array | np.ndarray, "b i j k"]
    """For each class 1 in the cell of a middle, less around it."""
    asked: Float[Array | np.ndarray, "b i j"]
    """0 where nothing may be asked."""
    told: Float[Array | np.ndarray, "b i j 7"]
    """Outputs beside the classes, of the cells that tell."""
    share: Float[Array | np.ndarray, "b i j"]
    """How much each of them counts; over one thing they sum to 1."""


class CylinderPool:
    """Random views as one of the looks shows them, drawn once, and cut, mirrored and lit anew ever after."""

    def __init__(self, look: ScaledRows, num: int, width_px: int, seed: int) -> None:
        """Draw them.

        Args:
            look: which of the two.
            num: of them.
            width_px: their width; they are as high as the look is.
            seed: picture k is drawn by (seed, k) and the look alone.
        """
        geometry = look_geometry(look, width_px)
        self.samples = [cylinder_sample(np.random.default_rng((seed, k)), geometry) for k in range(num)]

    def batch(self, rng: np.random.Generator, num: int, width_px: int) -> ObstacleBatch:
        """Windows of some of them, as wide as given, of all rows."""
        chosen = [self.samples[k] for k in rng.integers(len(self.samples), size=num)]
        cuts = (cut(rng, sample, (width_px, len(sample.picture))) for sample in chosen)
        return batch_of([lit_anew(rng, sample) for sample in cuts])


def look_geometry(look: ScaledRows, width_px: int) -> Geometry:
    """Of random views as one of the looks shows them, so wide."""
    return Geometry(PX_PER_RAD * look.scale, width_px, look.height, look.horizon_v, look.scale, LOW_M[look])


def batch_of(samples: Sequence[CylinderSample]) -> ObstacleBatch:
    """The batch of some pictures of one size."""
    parts = [targets(sample) for sample in samples]
    pictures = np.stack([np.asarray(prepared(sample.picture, sample.centre_v)) for sample in samples])
    return ObstacleBatch(pictures, *(np.stack([part[k] for part in parts]) for k in range(4)))


def cut(rng: np.random.Generator, sample: CylinderSample, size_px: tuple[int, int]) -> CylinderSample:
    """A window of a view, mirrored or not; most show the middle of a thing."""
    room = np.array([sample.picture.shape[1] - size_px[0], sample.picture.shape[0] - size_px[1]])
    corner = rng.integers(room + 1)
    # One that does not fit into the window is no reason to cut one here.
    asked = [t for t in sample.things if is_asked(t, sample.enlarged) and t.box[3] - t.box[1] <= size_px[1]]
    if asked and rng.random() < _ABOUT_THINGS:
        box = asked[int(rng.integers(len(asked)))].box
        corner = np.rint(0.5 * (box[:2] + box[2:]) - np.array(size_px) * rng.uniform(0.05, 0.95, 2)).astype(int)
    left, top = np.clip(corner, 0, room)
    top = top // STRIDE * STRIDE
    is_mirrored = bool(rng.integers(2))
    picture = sample.picture[top : top + size_px[1], left : left + size_px[0]]
    things = [_moved(thing, np.array([left, top]), size_px) for thing in sample.things]
    if is_mirrored:
        picture, things = picture[:, ::-1], [_mirrored(thing, size_px[0]) for thing in things if thing is not None]
    seen = [thing for thing in things if thing is not None]
    return sample._replace(picture=picture, things=seen, centre_v=sample.centre_v - top)


def _moved(thing: SeenThing, corner: np.ndarray, size_px: tuple[int, int]) -> SeenThing | None:
    """What a window shows of a thing."""
    box = thing.box - np.tile(corner, 2)
    inside = np.concatenate([np.maximum(box[:2], -0.5), np.minimum(box[2:], np.array(size_px) - 0.5)])
    if (inside[2:] - inside[:2]).min() < 1.0:
        return None
    share = float(np.prod(inside[2:] - inside[:2]) / np.prod(box[2:] - box[:2]))
    has_foot = thing.has_foot and bool(inside[3] > box[3] - 1e-6)
    return thing._replace(box=inside, foot_uv=thing.foot_uv - corner, shown=share * thing.shown, has_foot=has_foot)


def _mirrored(thing: SeenThing, width: int) -> SeenThing:
    left, top, right, low = thing.box
    foot = np.array([width - 1 - thing.foot_uv[0], thing.foot_uv[1]])
    return thing._replace(box=np.array([width - 1 - right, top, width - 1 - left, low]), foot_uv=foot)


def lit_anew(rng: np.random.Generator, sample: CylinderSample) -> CylinderSample:
    """The picture with another exposure, tint and noise."""
    gain = rng.uniform(0.75, 1.25) * (1.0 + 0.04 * rng.standard_normal(3))
    picture = sample.picture * gain.astype(np.float32) + np.float32(rng.uniform(-8.0, 8.0))
    if rng.random() < 0.3:
        picture = cv2.GaussianBlur(picture, None, rng.uniform(0.4, 1.0))
    picture += np.float32(rng.uniform(0.0, 4.0)) * rng.standard_normal(picture.shape, np.float32)
    return sample._replace(picture=np.clip(picture, 0.0, 255.0).astype(np.uint8))


def is_asked(thing: SeenThing, enlarged: float = 1.0) -> bool:
    """Whether a thing has to be found, in a picture so many times as large as that of `net_view`."""
    side = (thing.box[2:] - thing.box[:2]) / enlarged
    return bool((side >= LEAST_PX).all() and thing.range_m <= MOST_M and thing.shown >= _LEAST_SHOWN)


def targets(sample: CylinderSample) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """heat [i j k], asked [i j], told [i j 7] and share [i j] of one picture."""
    rows, columns = (side // STRIDE for side in sample.picture.shape[:2])
    heat, asked = np.zeros((rows, columns, len(KINDS)), np.float32), np.ones((rows, columns), np.float32)
    told, share = np.zeros((rows, columns, 7), np.float32), np.zeros((rows, columns), np.float32)
    row, column = np.mgrid[:rows, :columns]
    # Small things last: where two are in one cell, the larger one is still told beside it.
    for thing in sorted(sample.things, key=lambda t: -float(np.prod(t.box[2:] - t.box[:2]))):
        box = (thing.box - 0.5 * (STRIDE - 1)) / STRIDE  # [cells], the centre of the first is 0
        if not is_asked(thing, sample.enlarged):
            inside = (column >= box[0] - 0.5) & (column <= box[2] + 0.5) & (row >= box[1] - 0.5) & (row <= box[3] + 0.5)
            asked[inside & (share == 0.0)] = 0.0
            continue
        middle, side = 0.5 * (box[:2] + box[2:]), box[2:] - box[:2]
        sigma = np.clip(_SPREAD * side, *_SPREAD_CELLS)
        near = np.exp(-0.5 * (((column - middle[0]) / sigma[0]) ** 2 + ((row - middle[1]) / sigma[1]) ** 2))
        u, v = np.clip(np.rint(middle).astype(int), 0, [columns - 1, rows - 1])
        is_middle = (row == v) & (column == u)
        own = heat[..., KINDS.index(thing.kind)]
        np.maximum(own, np.where(is_middle, 1.0, np.minimum(near, 0.95)), out=own, casting="unsafe")
        tells = (near > _TELLS) | is_middle
        share[tells] = (near[tells] / near[tells].sum()).astype(np.float32)
        asked[tells] = 1.0
        foot = (thing.foot_uv - [0.5 * (thing.box[0] + thing.box[2]), thing.box[3]]) / (thing.box[2:] - thing.box[:2])
        told[tells, 0], told[tells, 1] = middle[0] - column[tells], middle[1] - row[tells]
        told[tells, 2:4] = np.log((thing.box[2:] - thing.box[:2]) / SIDE_PX)
        told[tells, 4:] = [*np.clip(foot, -3.0, 3.0), float(thing.has_foot)]
    return heat, asked, told, share


def obstacle_loss(network: Callable[[Array], Array], batch: ObstacleBatch) -> Float[Array, ""]:
    """Focal loss of the classes (Law and Deng 2018); errors of boxes and feet as shares of the sides of the box."""
    said, num_kinds = jax.vmap(network)(jnp.asarray(batch.picture)), len(KINDS)
    logit, more = said[..., :num_kinds], said[..., num_kinds:]
    num = jnp.maximum((batch.heat == 1.0).sum(), 1).astype(said.dtype)
    sureness = focal_loss(logit, jnp.asarray(batch.heat)) * batch.asked[..., None]
    side = SIDE_PX / STRIDE * jnp.exp(batch.told[..., 2:4])  # [cells]
    off = jnp.abs(more[..., :2] - batch.told[..., :2]) / side + jnp.abs(more[..., 2:4] - batch.told[..., 2:4])
    foot = jnp.abs(more[..., 4:6] - batch.told[..., 4:6]).sum(axis=-1) * batch.told[..., 6]
    has_foot = jax.nn.softplus(more[..., 6]) - batch.told[..., 6] * more[..., 6]
    per_thing = batch.share * (_BOX * off.sum(axis=-1) + _FOOT * foot + _HAS_FOOT * has_foot)
    return (sureness.sum() + per_thing.sum()) / num
