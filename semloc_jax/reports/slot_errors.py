"""The true slots of a drive and whether occupancy is told right (room: reports; host).

In: a drive with a true map and true poses. Out: SlotErrors.
"""

from collections.abc import Sequence

import numpy as np

from semloc_jax.datasets import Drive
from semloc_jax.evaluation import Metric
from semloc_jax.mapping.slot_tracks import SlotTrack
from semloc_jax.maps import read_map
from semloc_jax.reports.object_errors import ObjectErrors, TrueThings
from semloc_jax.structs import ElementClass

_SAME_RAD = 0.35


class SlotErrors(ObjectErrors):
    """Errors of slots: the middle of the entrance, and the direction into it."""

    def __init__(self, drive: Drive | None, true_poses: np.ndarray, taken: Sequence[bool | None] = ()):
        """The true slots, float64[n 3]: middle of the entrance [m] and direction into the slot in the map; whether a
        vehicle stands in each, None where the map does not say."""
        super().__init__(drive, TrueThings(true_poses, ("",) * len(true_poses), _SAME_RAD))
        self.taken = tuple(taken)

    @classmethod
    def of(cls, drive: Drive) -> "SlotErrors":
        """The true slots of a drive, where it has a map and true poses."""
        if drive.truth is None or drive.map_path is None:
            return cls(None, np.zeros((0, 3)))
        slots = [e for e in read_map(drive.map_path).elements if e.label == ElementClass.PARKING_SLOT]
        found, taken = [], [e.attributes.get("occupied") for e in slots]
        for corners in (e.points[:4, :2] for e in slots):
            inward = 0.5 * (corners[3] - corners[0] + corners[2] - corners[1])
            found.append([*(0.5 * (corners[0] + corners[1])), np.arctan2(inward[1], inward[0])])
        return cls(drive, np.array(found).reshape(-1, 3), taken)

    def final_more(self, pairs: Sequence[tuple[SlotTrack, int]]) -> list[Metric]:
        """Share of the tracks whose occupancy is right."""
        right = [
            bool(track.occupied) == bool(self.taken[k])
            for track, k in pairs
            if track.occupied is not None and self.taken[k] is not None
        ]
        return [Metric("final.occupancy_right", float(np.mean(right)), "share", "higher")] if right else []
