"""Parking slots in few frames, from a network's marking points (room: mapping; host).

In: frames with images, a MarkingNet, masks of what hides the road. Out: the slots of the last frames, as from masks.
Points become the dividers that begin at them; from there on one rule of geometry serves masks and network alike.
"""

import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.datasets import Drive, Frame
from semloc_jax.datasets.base import IMAGE
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.gathered_points import FAINTEST, PointLook, agreed_points
from semloc_jax.mapping.looking import Gatherer, Look
from semloc_jax.mapping.point_dividers import by_their_rows, in_view, open_to, painted_dividers
from semloc_jax.mapping.slot_sights import SlotFrame, SlotObserver, SlotSightConfig, own_way
from semloc_jax.mapping.slots import Divider
from semloc_jax.maps import MapElement
from semloc_jax.perception.networks.marking_net import METRES_PER_PX, MarkingNet
from semloc_jax.perception.surround import SurroundView

_SIZE_M = 12.0
"""Side of the top view: beyond 5 m beside the car paint is smeared. Ours."""


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
        self._points: dict[int, PointLook] = {}
        self.view = SurroundView.around(drive.rig.select(masks.cameras), _SIZE_M, METRES_PER_PX)

    def at(self, frame: Frame, index: int, Ts_odom_base: Float[np.ndarray, "n 4 4"]) -> SlotFrame:
        """The slots of a frame; see `SlotObserver.at`."""
        self._frame = frame
        return super().at(frame, index, Ts_odom_base)

    def _lines(self, gatherer: Gatherer, T: np.ndarray) -> tuple[list[MapElement], list[Divider]]:
        """No lines; the dividers that begin at the marking points of the last frames."""
        recent = {looks[0].frame: looks for looks in self._recent}
        self._points = {frame: look for frame, look in self._points.items() if frame in recent}
        frame, looks = next(reversed(recent.items()))
        self._points[frame] = self._look(looks, T)
        places, inward = agreed_points(list(self._points.values()), self.net.threshold)
        inward = by_their_rows(places, inward, self.config.slots)
        kept = open_to(own_way(T), places, inward)
        return [], painted_dividers(places[kept], inward[kept], float(T[2, 3]), self.config.slots)

    def _look(self, looks: list[Look], T: np.ndarray) -> PointLook:
        """The marking points of the newest frame, and what it shows: what is in the top view and not hidden."""
        picture = self.view.stitch([self._frame.image(name) for name in self.masks.cameras])
        found = self.net(picture, METRES_PER_PX, FAINTEST)
        size_px = picture.shape[1::-1]
        inside = in_view(found.uv, size_px)
        base, ahead = self._in_base(found.uv[inside], found.yaw_rad[inside])
        R, t = T[:2, :2], T[:2, 3]

        def shows(places: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
            return in_view(self.view.pixels((places - t) @ R), size_px) & SlotFrame([], looks).shows(places)

        return PointLook(base @ R.T + t, ahead @ R.T, found.confidence[inside], shows)

    def _in_base(
        self, uv: Float[np.ndarray, "n 2"], yaw_rad: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
        """Places [m] and unit directions of points of the top view."""
        bev, T = self.view.bev, self.view.T_base_bev
        p_bev = (uv - [float(bev.cx), float(bev.cy)]) / float(bev.fx)
        turn = np.stack([np.cos(yaw_rad), np.sin(yaw_rad)], axis=1)
        return p_bev @ T[:2, :2].T + T[:2, 3], turn @ T[:2, :2].T
