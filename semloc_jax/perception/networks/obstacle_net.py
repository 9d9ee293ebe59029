"""Obstacles of a parking lot on an upright cylinder, by a network (room: perception; JAX and host).

In: a picture of `net_view`, uint8[h w 3]. Out: FoundObstacles: class, box, middle of the footprint on the road.
One head says of each cell of four pixels: a confidence for each class, where the middle of the box is, its sides, where
the thing stands, and whether its foot is seen. The elevation of each row goes in beside the colours: on the road it
tells the range, and with it how large things are.
It looks at the whole in little more than half the size, and at the strip around the horizon twice as large: there is
what is low and stands far off. So near and far things are of about one size, and the network need not know more.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from semloc_jax.cameras import Camera, CylindricalCamera
from semloc_jax.evaluation.average_precision import box_overlap
from semloc_jax.perception.cylinder_view import UP, CylinderView, resized
from semloc_jax.perception.networks.dense_net import STRIDE, DenseNet, DenseNetConfig
from semloc_jax.perception.networks.weights import load_weights, read_card
from semloc_jax.perception.obstacle_classes import OBSTACLES

SHIPPED = Path(__file__).with_name("obstacles.weights")
"""What lessons of `semloc learn obstacles` wrote, one after the other; its card says how and gives its limits."""
KINDS = tuple(OBSTACLES)
OUTPUTS = (*KINDS, "du", "dv", "log_width", "log_height", "foot_u", "foot_v", "has_foot")
"""Logit of each class; offset of the middle of the box [cells]; logarithms of its sides [`SIDE_PX`]; middle of the
footprint from the middle of the lower border [sides of the box]; logit of a foot that is seen."""
CONFIG = DenseNetConfig(
    num_outputs=len(OUTPUTS),
    num_inputs=4,
    num_channels=(24, 48, 72, 96),
    num_blocks=(1, 1, 2, 2),
    num_dense=2,
    is_end_dense=False,
)
SIDE_PX = 16.0
PX_PER_RAD = 192.0
"""The network knows sizes: pictures of other cameras are resampled to this scale."""
SIZE_PX = (672, 320)
"""Width and height: 100 deg to both sides, from 35 deg above the horizon to 44 deg below."""
HORIZON_V = 134.0
_SAME = 0.5
"""Boxes that share so much of their union are of one thing."""
_FAR_FOOT_PX = (42.0, 48.0)
"""Lower borders so far below the horizon are told by either: higher ones by the enlarged strip, lower ones by the
picture. From cameras 0.6 to 1 m over the road that is 3 to 4.5 m away."""
_HIGH = KINDS.index("pillar")


class ScaledRows(NamedTuple):
    """Some rows of a picture of `net_view`, in the size in which the network looks at them.

    Attributes:
        scale: so many times as large.
        rows: the first one, and the one behind the last.
    """

    scale: float
    rows: tuple[int, int]

    @property
    def horizon_v(self) -> float:
        """Row of the horizon in it."""
        return self.scale * (HORIZON_V - self.rows[0] + 0.5) - 0.5  # pixel centres are at whole numbers

    @property
    def height(self) -> int:
        """Of it [px]."""
        return round(self.scale * (self.rows[1] - self.rows[0]))

    def at(self, picture: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "i j 3"]:
        """The rows of a picture; what its width lacks for whole cells at every stride is black."""
        part, step = picture[self.rows[0] : self.rows[1]], round(CONFIG.step_px / self.scale)
        if part.shape[1] % step:
            part = cv2.copyMakeBorder(part, 0, 0, 0, -part.shape[1] % step, cv2.BORDER_CONSTANT)
        return resized(part, (round(self.scale * part.shape[1]), self.height))

    def back(self, found: "FoundObstacles") -> "FoundObstacles":
        """What was found in it, in pixels of the picture."""
        box, foot = ((uv + 0.5) / self.scale - 0.5 for uv in (found.box, found.foot_uv))
        return found._replace(box=box + [0, self.rows[0], 0, self.rows[0]], foot_uv=foot + [0, self.rows[0]])


NEAR = ScaledRows(4 / 7, (40, SIZE_PX[1]))
"""What is near is large, and pillars are. 26 deg above the horizon only they are left."""
FAR = ScaledRows(2.0, (120, 184))
"""Around the horizon; pillars reach out of it."""


class FoundObstacles(NamedTuple):
    """Obstacles of one picture, the surest first."""

    kind: Int[np.ndarray, " n"]
    """Place of the class in `KINDS`."""
    box: Float[np.ndarray, "n 4"]
    """Left, top, right and lower border [px]."""
    foot_uv: Float[np.ndarray, "n 2"]
    """Pixel of the road under the middle of the thing."""
    has_foot: Bool[np.ndarray, " n"]
    """Whether its lower end is seen."""
    confidence: Float[np.ndarray, " n"]

    def above(self, threshold: float) -> "FoundObstacles":
        """Those that are at least so sure."""
        return self.where(self.confidence >= threshold)

    def where(self, chosen: Bool[np.ndarray, " n"]) -> "FoundObstacles":
        """Those that are chosen."""
        return FoundObstacles(*(part[chosen] for part in self))


class ObstacleNet:
    """A trained network, compiled once for each size of pictures."""

    def __init__(self, network: DenseNet, threshold: float):
        """The network, and the confidence from which an obstacle counts."""
        self.network, self.threshold = network, threshold

    @classmethod
    def load(cls, path: str | Path = SHIPPED) -> "ObstacleNet":
        """The network that `semloc learn obstacles` wrote, by default the shipped one, with the threshold of its card.

        Raises:
            SemlocError: no such file, or another network.
        """
        card = read_card(path)
        network = load_weights(path, DenseNet.create(jax.random.key(0), CONFIG))
        return cls(network, float(card.get("threshold", 0.5)))

    def __call__(self, picture: UInt8[np.ndarray, "h w 3"], threshold: float | None = None) -> FoundObstacles:
        """The obstacles of a picture of `net_view`, blue green red.

        Args:
            picture: of any width.
            threshold: another one than that of the network.
        """
        least = self.threshold if threshold is None else threshold
        near, far = (look.back(decoded(self._said(look.at(picture), look.horizon_v), least)) for look in (NEAR, FAR))
        below_px = [found.box[:, 3] - HORIZON_V for found in (near, far)]
        near = _as_in_strip(near, far.where((far.kind == _HIGH) & (below_px[1] < _FAR_FOOT_PX[1])))
        of_near = near.where((near.kind == _HIGH) | (below_px[0] >= _FAR_FOOT_PX[0]))
        of_far = far.where((far.kind != _HIGH) & (below_px[1] < _FAR_FOOT_PX[1]))
        return _apart(FoundObstacles(*(np.concatenate(pair) for pair in zip(of_near, of_far, strict=True))))

    def _said(self, picture: UInt8[np.ndarray, "h w 3"], horizon_v: float) -> Float[np.ndarray, "i j n"]:
        # Prepared where it is looked at: bytes are copied, not floats.
        return np.asarray(_said(self.network, jnp.asarray(picture), jnp.asarray(horizon_v, jnp.float32)))


@eqx.filter_jit
def _said(network: DenseNet, picture: jax.Array, horizon_v: jax.Array) -> jax.Array:
    return network(prepared(picture, horizon_v))


def net_view(
    camera: Camera, T_base_cam: Float[np.ndarray, "4 4"], up_base: Sequence[float] | Float[np.ndarray, " 3"] = UP
) -> CylinderView:
    """The cylinder that the network looks at.

    Raises:
        SemlocError: the camera sees nothing around the horizon.
    """
    width, height = SIZE_PX
    cylinder = CylindricalCamera(PX_PER_RAD, 0.5 * (width - 1), HORIZON_V, width, height)
    return CylinderView.on(cylinder, camera, T_base_cam, up_base)


def prepared(picture: UInt8[Array | np.ndarray, "h w 3"], horizon_v: float | Float[Array, ""]) -> Float[Array, "h w 4"]:
    """Red, green, blue in -1 ... 1 and the tangent of the elevation, positive below the horizon; float32."""
    height, width, _ = picture.shape
    colours = jnp.asarray(picture)[..., ::-1] * jnp.float32(2.0 / 255.0) - jnp.float32(1.0)
    row = jnp.arange(height, dtype=jnp.float32)
    tangent = (row - jnp.asarray(horizon_v, jnp.float32)) / jnp.float32(PX_PER_RAD)
    return jnp.concatenate([colours, jnp.broadcast_to(tangent[:, None, None], (height, width, 1))], axis=-1)


def _as_in_strip(near: FoundObstacles, far: FoundObstacles) -> FoundObstacles:
    """Pillars with both sides, lower border and foot as the strip has them, where it shows the same one.

    Errors of a box are shares of its sides, and the whole is shown in two sevenths of the size of the strip.
    """
    box, foot, has_foot = near.box.copy(), near.foot_uv.copy(), near.has_foot.copy()
    for k in np.flatnonzero(near.kind == _HIGH) if len(far.box) else ():
        common = np.minimum(box[k, 2], far.box[:, 2]) - np.maximum(box[k, 0], far.box[:, 0])
        both = np.maximum(box[k, 2], far.box[:, 2]) - np.minimum(box[k, 0], far.box[:, 0])
        same = int((common / both).argmax())
        if common[same] > _SAME * both[same] and box[k, 3] - HORIZON_V < _FAR_FOOT_PX[1]:
            box[k, [0, 2, 3]] = far.box[same, [0, 2, 3]]
            foot[k], has_foot[k] = far.foot_uv[same], far.has_foot[same]
    return near._replace(box=box, foot_uv=foot, has_foot=has_foot)


def decoded(said: Float[np.ndarray, "h w n"], threshold: float) -> FoundObstacles:
    """The cells that are surer than their neighbours, and what they say; of boxes that overlap the surest stays."""
    num = len(KINDS)
    logit = np.ascontiguousarray(said[..., :num].max(axis=-1))
    least = np.log(max(threshold, 1e-9) / max(1.0 - threshold, 1e-9))
    v, u = np.nonzero((logit >= least) & (logit >= cv2.dilate(logit, np.ones((3, 3), np.uint8))))
    order = np.argsort(-logit[v, u], kind="stable")
    v, u = v[order], u[order]
    sure = 1.0 / (1.0 + np.exp(-logit[v, u].astype(np.float64)))
    cell, kind = said[v, u, num:].astype(np.float64), said[v, u, :num].argmax(axis=-1)
    middle = STRIDE * (np.column_stack([u, v]) + cell[:, :2]) + 0.5 * (STRIDE - 1)
    side = SIDE_PX * np.exp(np.clip(cell[:, 2:4], -4.0, 4.0))
    box = np.concatenate([middle - 0.5 * side, middle + 0.5 * side], axis=1)
    foot = np.column_stack([middle[:, 0], box[:, 3]]) + cell[:, 4:6] * side
    return _apart(FoundObstacles(kind, box, foot, cell[:, 6] > 0.0, sure))


def _apart(found: FoundObstacles) -> FoundObstacles:
    """The surest of those that are of one thing, the surest first."""
    kept: list[int] = []
    for k in np.argsort(-found.confidence, kind="stable"):
        if not kept or box_overlap(found.box[k], found.box[kept]).max() < _SAME:
            kept.append(int(k))
    return FoundObstacles(*(part[kept] for part in found))
