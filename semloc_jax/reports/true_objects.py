"""The true obstacles and slots of a drive, and whether occupancy is told right (room: reports; host).

In: a drive with a true map and true poses. Out: ObjectErrors, SlotErrors.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from semloc_jax.datasets import Drive
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import Metric
from semloc_jax.mapping.slot_tracks import SlotTrack
from semloc_jax.maps import read_map
from semloc_jax.perception.obstacle_classes import OBSTACLES
from semloc_jax.reports.map_slots import entrance_pose
from semloc_jax.reports.object_errors import ObjectErrors, TrueThings
from semloc_jax.storage import json_document, reading
from semloc_jax.structs import ElementClass


def obstacle_errors(drive: Drive) -> ObjectErrors:
    """The true obstacles of a drive, where it has a map as GeoJSON and true poses.

    Ground locks and signs are no elements of maps to localize in: they are points of the file, with their class.
    """
    places: list[np.ndarray] = []
    kinds: list[str] = []
    if drive.truth is not None and drive.map_path is not None and drive.map_path.suffix in (".geojson", ".json"):
        where = f"map {drive.map_path.name}"
        with reading(where):
            document = json_document(drive.map_path.read_bytes(), where)
        for feature in document.get("features", ()):
            kind = feature.get("properties", {}).get("class") if isinstance(feature, Mapping) else None
            if kind in OBSTACLES:
                kinds.append(kind)
                places.append(_middle(feature, where))
    poses = np.column_stack([np.array(places).reshape(-1, 2), np.zeros(len(places))])
    return ObjectErrors(drive, TrueThings(poses, tuple(kinds)))


def _middle(feature: Mapping[str, Any], where: str) -> np.ndarray:
    """Middle of the footprint: a point, the foot of an axis, or an outline."""
    try:
        geometry = feature["geometry"]
        places = np.asarray(geometry["coordinates"], float)
        if geometry["type"] == "Polygon":
            return places[0, :-1, :2].mean(axis=0)
        return places[:2] if geometry["type"] == "Point" else places[0, :2]
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise SemlocError(
            f"{where}: obstacle {feature.get('id')!r}: expected a Point, a LineString or a Polygon with numbers"
        ) from error


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
        found = np.array([entrance_pose(e.points[:4, :2]) for e in slots]).reshape(-1, 3)
        return cls(drive, found, [e.attributes.get("occupied") for e in slots])

    def final_more(self, pairs: Sequence[tuple[SlotTrack, int]]) -> list[Metric]:
        """Share of the tracks whose occupancy is right."""
        right = [
            bool(track.occupied) == bool(self.taken[k])
            for track, k in pairs
            if track.occupied is not None and self.taken[k] is not None
        ]
        return [Metric("final.occupancy_right", float(np.mean(right)), "share", "higher")] if right else []
