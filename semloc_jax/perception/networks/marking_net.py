"""Marking points of parking slots in a top view, by a network (room: perception; JAX and host).

In: a top view uint8[h w 3]. Out: MarkingPoints: where dividers have their mouths, which way they run.
One head says of each cell of four pixels: confidence, where in it, direction into the slot, and L or T.
"""

from pathlib import Path
from typing import NamedTuple

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.perception.networks.dense_net import STRIDE, DenseNet, DenseNetConfig
from semloc_jax.perception.networks.levelling import levelled
from semloc_jax.perception.networks.weights import load_weights, read_card

SHIPPED = Path(__file__).with_name("slots.weights")
"""What `semloc learn slots lot_seed4 rendered_garage` wrote; its card says how, its figures and its limits."""
METRES_PER_PX = 0.05
"""The network knows lengths: pictures of other scales are resampled."""
OUTPUTS = ("confidence", "du", "dv", "cos", "sin", "corner")
"""What is said of each cell: logit; offset from its centre [cells]; direction; logit of L against T."""
CONFIG = DenseNetConfig(num_outputs=len(OUTPUTS), num_channels=(24, 48, 72, 96), num_blocks=(1, 1, 2, 2), num_dense=2)
_AROUND_M = 1.0
"""Half of the square whose mean and spread the brightness is told by: light and colour of the ground drop out."""
RIM_SHARE = 0.05
"""A point so near to the rim of the picture does not count, as in DMPR (Huang 2019): the divider that gives its
direction is not in the picture."""
_APART_M = 0.6
"""Of points nearer to each other the surest stays."""


class MarkingPoints(NamedTuple):
    """Points of one picture, the surest first."""

    uv: Float[np.ndarray, "n 2"]
    """Pixels of the picture."""
    yaw_rad: Float[np.ndarray, " n"]
    """Direction into the slot, from u towards v."""
    is_corner: Bool[np.ndarray, " n"]
    """L: a slot on one side only."""
    confidence: Float[np.ndarray, " n"]

    def above(self, threshold: float) -> "MarkingPoints":
        """Those that are at least so sure."""
        return MarkingPoints(*(part[self.confidence >= threshold] for part in self))


class MarkingNet:
    """A trained network, compiled once for each size of pictures."""

    def __init__(self, network: DenseNet, threshold: float):
        """The network, and the confidence from which a point counts."""
        self.network, self.threshold = network, threshold

    @classmethod
    def load(cls, path: str | Path = SHIPPED) -> "MarkingNet":
        """The network that `semloc learn slots` wrote, by default the shipped one; its threshold stands in its card.

        Raises:
            SemlocError: no such file, or another network.
        """
        card = read_card(path)
        network = load_weights(path, DenseNet.create(jax.random.key(0), CONFIG))
        return cls(network, float(card.get("threshold", 0.5)))

    def __call__(
        self, picture: UInt8[np.ndarray, "h w 3"], metres_per_px: float, threshold: float | None = None
    ) -> MarkingPoints:
        """The points of a top view, blue green red.

        Args:
            picture: the top view.
            metres_per_px: size of its pixels.
            threshold: another one than that of the network.
        """
        scale = metres_per_px / METRES_PER_PX
        size = tuple(max(round(side * scale / CONFIG.step_px), 1) * CONFIG.step_px for side in picture.shape[1::-1])
        small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR)
        said = np.asarray(_said(self.network, jnp.asarray(levelled_view(small))))
        found = decoded(said, self.threshold if threshold is None else threshold)
        stretch = np.array([picture.shape[1] / size[0], picture.shape[0] / size[1]])
        return found._replace(uv=(found.uv + 0.5) * stretch - 0.5)


@eqx.filter_jit
def _said(network: DenseNet, picture: jax.Array) -> jax.Array:
    return network(picture)


def levelled_view(picture: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
    """Red, green and blue by their mean and spread around each pixel, float32 in -1 ... 1."""
    x = picture[..., ::-1].astype(np.float32) / np.float32(255.0)
    return levelled(x, 2 * round(_AROUND_M / METRES_PER_PX) + 1)


def decoded(said: Float[np.ndarray, "h w n"], threshold: float) -> MarkingPoints:
    """The cells that are surer than their neighbours, and what they say."""
    sure = 0.5 * (1.0 + np.tanh(0.5 * said[..., 0].astype(np.float64)))
    peak = (sure >= threshold) & (sure >= cv2.dilate(sure, np.ones((3, 3), np.uint8)) - 1e-12)
    v, u = np.nonzero(peak)
    order = np.argsort(-sure[v, u], kind="stable")
    v, u = v[order], u[order]
    cell = said[v, u].astype(np.float64)
    uv = STRIDE * (np.column_stack([u, v]) + cell[:, 1:3]) + 0.5 * (STRIDE - 1)
    kept: list[int] = []
    for k, place in enumerate(uv):
        if all(np.hypot(*(place - uv[j])) * METRES_PER_PX > _APART_M for j in kept):
            kept.append(k)
    yaw = np.arctan2(cell[:, 4], cell[:, 3])
    return MarkingPoints(uv[kept], yaw[kept], cell[kept, 5] > 0.0, sure[v, u][kept])
