"""Parking slots over many frames (room: mapping; host).

In: sights of slots. Out: SlotTrack: type, size and occupancy of a slot that is followed.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Float

from semloc_jax.mapping.object_tracks import ObjectTrack, ObjectTrackConfig, wrapped
from semloc_jax.mapping.slot_sights import Slot
from semloc_jax.mapping.slots import PARALLEL

_LAST = 9
"""Sights that tell whether a slot is taken now."""
_SHARED = 0.3
"""Two slots that share more of the smaller one are not both there: a divider was missed, or the depth is a guess."""


@dataclass
class SlotTrack(ObjectTrack):
    """One slot that is followed: its place is the middle of the entrance, its direction points into it."""

    @property
    def kind(self) -> str:
        """The type that most sights state."""
        kinds = [slot.kind for slot, _ in self.sights]
        return max(set(kinds), key=kinds.count)

    @property
    def width_m(self) -> float:
        """Median of the sights."""
        return float(np.median([slot.width_m for slot, _ in self.sights]))

    @property
    def depth_m(self) -> float:
        """Median of the sights."""
        return float(np.median([slot.depth_m for slot, _ in self.sights]))

    @property
    def occupied(self) -> bool | None:
        """What most of the last sights say, those into the slot where there are any; None where none could see."""
        known = [slot for slot, _ in self.sights if slot.occupied is not None]
        said = [slot.occupied for slot in ([slot for slot in known if slot.is_faced] or known)[-_LAST:]]
        return None if not said else sum(said) * 2 > len(said)

    def corners(self) -> Float[np.ndarray, "2 2"]:
        """Both ends of the entrance in odom [m]."""
        return self._rectangle(self.width_m)[:2]

    def outline(self) -> Float[np.ndarray, "4 2"]:
        """Corners in odom [m], both ends of the entrance first."""
        return self._rectangle(self.width_m)

    def excludes(self, other: "SlotTrack") -> bool:
        """Whether both slots share more than their rims."""
        one, two = (shapely.Polygon(track._rectangle(track._across_m())) for track in (self, other))
        return bool(one.intersection(two).area > _SHARED * min(one.area, two.area))

    def _across_m(self) -> float:
        """From side to side: less than the entrance where the slot is at an angle to it."""
        return float(np.median([slot.width_m * np.cos(slot.skew_rad) for slot, _ in self.sights]))

    def _rectangle(self, width_m: float) -> Float[np.ndarray, "4 2"]:
        along = np.array([np.sin(self.pose[2]), -np.cos(self.pose[2])])
        ends = self.pose[:2] + 0.5 * width_m * np.array([along, -along])
        return np.concatenate([ends, ends[::-1] - self.depth_m * np.array([along[1], -along[0]])])

    def may_be(self, sight: Slot, config: ObjectTrackConfig) -> bool:
        """Whether the sight points the same way and is of the same kind: along the aisle or not."""
        is_turned = abs(wrapped(sight.pose[2] - self.pose[2])) > np.deg2rad(config.same_deg)
        return not is_turned and (sight.kind == PARALLEL) == (self.kind == PARALLEL)
