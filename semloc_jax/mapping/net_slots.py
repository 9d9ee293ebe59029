"""Parking slots in single frames, from a network's marking points (room: mapping; host).

In: frames with images, a MarkingNet, masks of what hides the road. Out: the slots that each frame shows, as from masks.
Points become the dividers that begin at them; from there on one rule of geometry serves masks and network alike.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.datasets import Drive, Frame
from semloc_jax.datasets.base import IMAGE
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.looking import Gatherer
from semloc_jax.mapping.slot_sights import SlotFrame, SlotObserver, SlotSightConfig
from semloc_jax.mapping.slots import Divider, SlotConfig
from semloc_jax.maps import MapElement
from semloc_jax.perception.networks.marking_net import METRES_PER_PX, RIM_SHARE, MarkingNet
from semloc_jax.perception.surround import SurroundView

_SIZE_M = 12.0
"""Side of the top view: beyond 5 m beside the car paint is smeared. Ours."""
_PAINT_M = 0.12
"""Width of painted lines: a marking point is the middle of the paint, an entrance is its outer edge."""
_SAME_WAY_DEG, _ROW_M = 30.0, 0.4
"""Points of one row point the same way but for the error of the network, and lie on one line so nearly."""
_UPRIGHT_DEG = 20.0
"""Dividers so near to a right angle to their row are at one."""


class NetSlotObserver(SlotObserver):
    """Finds the slots of one frame after the other by their marking points."""

    def __init__(self, drive: Drive, masks: MaskSource, net: MarkingNet, config: SlotSightConfig | None = None):
        """The drive, masks of what hides the road and of who parks, the network.

        Raises:
            SemlocError: a camera has no images.
        """
        super().__init__(drive, masks, config)
        missing = [name for name in masks.cameras if not all(frame.has(IMAGE, name) for frame in drive.frames)]
        if missing:
            raise SemlocError(
                f"drive {drive.name}: camera {missing[0]} has no images, which the network looks at; use --front masks"
            )
        self.net, self._frame = net, drive.frames[0]
        self.view = SurroundView.around(drive.rig.select(masks.cameras), _SIZE_M, METRES_PER_PX)

    def at(self, frame: Frame, index: int, Ts_odom_base: Float[np.ndarray, "n 4 4"]) -> SlotFrame:
        """The slots of a frame; see `SlotObserver.at`."""
        self._frame = frame
        return super().at(frame, index, Ts_odom_base)

    def _lines(self, gatherer: Gatherer, T: np.ndarray) -> tuple[list[MapElement], list[Divider]]:
        """No lines; the dividers that begin at the marking points of the frame."""
        picture = self.view.stitch([self._frame.image(name) for name in self.masks.cameras])
        found = self.net(picture, METRES_PER_PX)
        inside = in_view(found.uv, picture.shape[1::-1])
        base, ahead = self._in_base(found.uv[inside], found.yaw_rad[inside])
        R = T[:2, :2]
        return [], painted_dividers(base @ R.T + T[:2, 3], ahead @ R.T, float(T[2, 3]), self.config.slots)

    def _in_base(
        self, uv: Float[np.ndarray, "n 2"], yaw_rad: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
        """Places [m] and unit directions of points of the top view."""
        bev, T = self.view.bev, self.view.T_base_bev
        p_bev = (uv - [float(bev.cx), float(bev.cy)]) / float(bev.fx)
        turn = np.stack([np.cos(yaw_rad), np.sin(yaw_rad)], axis=1)
        return p_bev @ T[:2, :2].T + T[:2, 3], turn @ T[:2, :2].T


def in_view(uv: Float[np.ndarray, "n 2"], side_px: Sequence[int]) -> Bool[np.ndarray, " n"]:
    """Which points of a top view are so far from its rim that they count; width and height."""
    side = np.asarray(side_px)
    return ((uv > RIM_SHARE * side) & (uv < (1.0 - RIM_SHARE) * side - 1)).all(axis=1)


def painted_dividers(
    places: Float[np.ndarray, "n 2"], inward: Float[np.ndarray, "n 2"], z_m: float, config: SlotConfig
) -> list[Divider]:
    """As `dividers_of`, from the outer edge of the paint on."""
    return [replace(d, mouth=d.mouth - 0.5 * _PAINT_M * d.inward) for d in dividers_of(places, inward, z_m, config)]


def dividers_of(
    places: Float[np.ndarray, "n 2"], inward: Float[np.ndarray, "n 2"], z_m: float, config: SlotConfig
) -> list[Divider]:
    """The dividers that begin at marking points, with the direction of their row.

    A network tells where a divider begins, not how long it is: those whose neighbours are all as far away as those of
    slots along the aisle are taken for short ones.

    Args:
        places: of the points [m].
        inward: unit directions into the slots.
        z_m: height of the road.
        config: what makes a slot.
    """
    rows = [_row_of(k, places, inward, config) for k in range(len(places))]
    dividers = []
    for k, (place, row) in enumerate(zip(places, rows, strict=True)):
        away_m = np.linalg.norm(places[row] - place, axis=1)
        is_along = len(row) > 1 and bool(away_m[away_m > 0.0].min() >= config.parallel_m[0])
        length_m = float(np.mean(config.parallel_divider_m if is_along else config.depth_m))
        dividers.append(Divider(f"point_{k}", place, _direction(places[row], inward[row]), length_m, is_along, z_m))
    return dividers


def _row_of(k: int, places: np.ndarray, inward: np.ndarray, config: SlotConfig) -> Sequence[int]:
    """The points of the row of one: they point the same way and lie across it."""
    same = inward @ inward[k] > np.cos(np.deg2rad(_SAME_WAY_DEG))
    mean = inward[same].mean(axis=0)
    mean /= np.linalg.norm(mean)
    off_m = np.abs((places - places[k]) @ mean)
    away_m = np.linalg.norm(places - places[k], axis=1)
    sharpest = np.cos(np.deg2rad(config.least_angle_deg))
    return np.flatnonzero(same & (off_m < _ROW_M + sharpest * away_m)).tolist()


def _direction(places: np.ndarray, inward: np.ndarray) -> Float[np.ndarray, " 2"]:
    """Direction of the dividers of a row: across it where they are nearly so, else the mean of what is said."""
    mean = inward.mean(axis=0)
    mean = mean / np.linalg.norm(mean)
    if len(places) < 2:
        return mean
    row = np.linalg.svd(places - places.mean(axis=0), full_matrices=False)[2][0]
    across = np.array([-row[1], row[0]])
    across = across if across @ mean > 0 else -across
    return across if across @ mean > np.cos(np.deg2rad(_UPRIGHT_DEG)) else mean
