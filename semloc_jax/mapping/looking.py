"""A drive looked at frame by frame: what each place of the road around the vehicle shows (room: mapping; host).

In: frames, masks, poses. Out: Look: one camera of one frame, its places on the road and the ids seen there.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.evidence_grid import EvidenceGrid
from semloc_jax.mapping.road_heights import RoadHeights
from semloc_jax.mapping.road_profile import RoadProfile
from semloc_jax.mapping.road_table import RoadTable
from semloc_jax.mapping.sightings import RayTable, Sightings
from semloc_jax.mapping.vectorize import Layer
from semloc_jax.perception import ClassTable
from semloc_jax.perception.surround import PAINT, UPRIGHT_WORDS
from semloc_jax.storage import making
from semloc_jax.structs import ElementClass

_HEIGHTS_REACH_M = 25.0
_RIM_PX = 2
"""Masks of what hides the road are this much larger than drawn: their rims wobble."""
_VEHICLE_CELL_M = 0.1
ON_ROAD = PAINT | {ElementClass.CURB}
"""What is drawn from above: paint, and curbs, which stand in the road by a hand's breadth."""


@dataclass(frozen=True)
class RoadLookConfig:
    """How the road is looked at. All values are ours.

    Args:
        range_m: reach on the road around the vehicle.
        spacing_m: distance of the places that are looked at, and side of the cells in which looks are gathered: in
            finer cells each would be looked at in some frames only.
    """

    range_m: float = 18.0
    spacing_m: float = 0.025


@dataclass(frozen=True)
class Look:
    """One camera of one frame.

    Attributes:
        frame: index of the pose.
        table: the places that the camera shows.
        heights: of the road around the vehicle.
        ids: `uint8[n]`, mask id at each place of the table.
        hidden: `bool[n]`, whether something stands between the camera and the place, or its rim might.
        is_vehicle: `bool[n]`, whether that is another road user.
        T_map_base: pose of the vehicle.
        mask: `uint8[h w]` the mask itself.
    """

    frame: int
    table: RoadTable
    heights: RoadHeights
    ids: UInt8[np.ndarray, " n"]
    hidden: Bool[np.ndarray, " n"]
    is_vehicle: Bool[np.ndarray, " n"]
    T_map_base: Float[np.ndarray, "4 4"]
    mask: UInt8[np.ndarray, "h w"]

    @property
    def xy_map(self) -> Float[np.ndarray, "n 2"]:
        """The places on the road in the map [m]."""
        T, (x, y) = self.T_map_base, self.table.on_road(self.heights).T
        return np.stack([T[k, 0] * x + T[k, 1] * y + T[k, 3] for k in (0, 1)], axis=1)

    def rows_of(self, xy_map: Float[np.ndarray, "n 2"]) -> np.ndarray:
        """Row of the table that shows each place of the map, -1 for those not shown."""
        T = self.T_map_base
        xy_base = np.linalg.solve(T[:2, :2], (xy_map - T[:2, 3]).T).T
        return self.table.rows_of(xy_base, self.heights)


class Looker:
    """Looks at the road with all cameras of a drive; the tables of the cameras are made once."""

    def __init__(self, drive: Drive, masks: MaskSource, config: RoadLookConfig | None = None, step_m: float = 0.0):
        """Make the tables; `step_m`: way from frame to frame, see `RoadTable.of`."""
        self.masks = masks
        self.config = config or RoadLookConfig()
        rig = masks.seen_by(drive.rig.select(masks.cameras))
        poses = np.asarray(rig.T_base_cam, dtype=np.float64)
        self.tables = [
            RoadTable.of(camera, T, self.config.range_m, self.config.spacing_m, step_m)
            for camera, T in zip(rig.cameras, poses, strict=True)
        ]
        if not any(len(table.pixel) for table in self.tables):
            raise SemlocError(
                f"drive {drive.name}: no camera shows the road within {self.config.range_m:g} m of the vehicle; check "
                "where the cameras are mounted (semloc check-calib)"
            )
        self._rig, self._poses = rig, poses
        self._hides = hiding_ids(masks.table)
        self._is_vehicle = np.isin(np.arange(256), masks.table.dynamic_ids)

    @cached_property
    def rays(self) -> list[RayTable]:
        """Directions of the pixels of every camera."""
        return [RayTable.of(camera, T) for camera, T in zip(self._rig.cameras, self._poses, strict=True)]

    def looks(
        self, frame: Frame, index: int, Ts_map_base: Float[np.ndarray, "n 4 4"], profile: RoadProfile | None = None
    ) -> Iterator[Look]:
        """Yields the look of every camera at one frame.

        Args:
            frame: the frame.
            index: its place among the poses.
            Ts_map_base: pose of every frame.
            profile: of the road beside them, where it is not as flat as the lane.
        """
        heights = RoadHeights.of(Ts_map_base, index, _HEIGHTS_REACH_M, profile)
        rim = np.ones((2 * _RIM_PX + 1, 2 * _RIM_PX + 1), np.uint8)
        for table, mask in zip(self.tables, self.masks.masks(frame), strict=True):
            hidden = cv2.dilate(self._hides[mask].astype(np.uint8), rim).ravel()[table.pixel] > 0
            ids = mask.ravel()[table.pixel]
            yield Look(index, table, heights, ids, hidden, self._is_vehicle[ids], Ts_map_base[index], mask)


class Gatherer:
    """The evidence of a drive from above: paint by layer, and how often other vehicles hide a place."""

    def __init__(self, table: ClassTable, cell_m: float):
        self.layers, self.layer_of_id = paint_layers(table)
        self.paint = EvidenceGrid(cell_m)
        self.vehicles = EvidenceGrid(_VEHICLE_CELL_M)
        self.sightings = Sightings(table)

    def add(self, look: Look, rays: RayTable | None = None) -> None:
        """Adds one look; with the directions of its pixels also what stands upright."""
        if rays is not None:
            self.sightings.add(look.mask, rays, look.frame, look.T_map_base)
        xy_map = look.xy_map
        self.paint.add(xy_map, look.table.weight, self.layer_of_id[look.ids], ~look.hidden)
        some = slice(None, None, 7)
        usable = look.is_vehicle[some] | ~look.hidden[some]
        self.vehicles.add(xy_map[some], look.table.weight[some], look.is_vehicle[some].astype(np.int64) - 1, usable)

    def store(self, path: Path) -> None:
        """Writes what was gathered since the last part to `path` and takes it out of memory; it still counts."""
        with making(path) as part:
            part.mkdir()
            self.paint.store(part / "paint.npz")
            self.vehicles.store(part / "vehicles.npz")
            self.sightings.store(part / "sightings.npz")
        self.attach(path)

    def attach(self, path: Path) -> None:
        """Takes a part in that `store` wrote."""
        self.paint.attach(path / "paint.npz")
        self.vehicles.attach(path / "vehicles.npz")
        self.sightings.attach(path / "sightings.npz")


def paint_layers(table: ClassTable) -> tuple[list[Layer], np.ndarray]:
    """What masks show of paint and curbs: layers, and the plane of the grid of each mask id, -1 for none, `int64[256]`.

    Raises:
        SemlocError: the masks show no paint.
    """
    layers, plane_of_id, count = [], np.full(256, -1, np.int64), 0
    for channel in table.channels:
        labels = [label for label in channel.classes if label in ON_ROAD]
        if not labels:
            continue
        dashed = [i for i in channel.mask_ids if "dash" in table.id_names.get(i, "")]
        groups = [group for group in ([i for i in channel.mask_ids if i not in dashed], dashed) if group]
        planes = tuple(range(count, count + len(groups)))
        for plane, group in zip(planes, groups, strict=True):
            plane_of_id[group] = plane
        is_told = bool(dashed) and len(groups) == 2
        layers.append(Layer(labels[0], planes, planes[-1:] if is_told else (), is_told))
        count += len(groups)
    if not any(layer.label in PAINT for layer in layers):
        names = ", ".join(channel.name for channel in table.channels)
        raise SemlocError(
            f"class table {table.name}: shows no paint on the road (channels: {names}); a map is made of paint: give "
            "masks with lane markings, slot lines or the like"
        )
    return layers, plane_of_id


def hiding_ids(table: ClassTable) -> np.ndarray:
    """Which ids hide the road: the own car, other road users, everything upright, ignored pixels; `bool[256]`."""
    hides = np.isin(np.arange(256), table.unusable_ids)
    for channel in table.channels:
        if not set(channel.classes) & ON_ROAD:
            hides[list(channel.mask_ids)] = True
    for number, name in table.id_names.items():
        hides[number] |= any(word in name for word in (*UPRIGHT_WORDS, "unlabeled"))
    return hides
