"""The semantic vector map and the part of it around a place (room: maps; host).

In: map elements. Out: SemanticMap, which answers `query` with a LocalMap and knows the road under every place.
"""

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.maps.around_place import PlanIndex, TiledGround
from semloc_jax.maps.assumed_dashes import joined_dashes
from semloc_jax.maps.curves import clip_to_circle, without_repeats
from semloc_jax.maps.elements import LARGEST_M, UPRIGHT_CLASSES, GeoOrigin, MapElement, Place
from semloc_jax.maps.ground import GroundModel, RoadSpread
from semloc_jax.maps.heights import lifted
from semloc_jax.storage import FARTHEST_M
from semloc_jax.structs import ElementClass

_AT_ONCE = 64
_WHOLE_GROUND = 10_000
"""Elements whose road is held as a whole: some million points for 100,000."""
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class LocalMap:
    """The part of a map within a radius of a place.

    Attributes:
        elements: elements in the map frame [m]; lines are cut at the radius; `true_ends` marks the cuts.
        origin_map: `float64[3]` in the map frame: origin of `frame`, the frame of all that goes to JAX.
        ground: the road surface of the whole map.
        radius_m: search radius.
    """

    elements: tuple[MapElement, ...]
    origin_map: np.ndarray
    ground: GroundModel
    radius_m: float = float("inf")

    @cached_property
    def frame(self) -> LocalFrame:
        """Moves poses and points between the map and what goes to JAX."""
        return LocalFrame(self.origin_map)


@dataclass(frozen=True)
class SemanticMap:
    """A vector map in a local metric frame.

    Attributes:
        elements: every element; ids are unique.
        origin: WGS84 place of the frame, None where the source does not state it.
        name: where it came from, for messages.
        skipped: what the reader left out, by reason or class, with counts.
        frame: the coordinate system in words, where the format has a name for it.
        faulty: elements that the reader left out because they cannot be meant: what is wrong, by their id.
    """

    elements: tuple[MapElement, ...]
    origin: GeoOrigin | None = None
    name: str = "map"
    skipped: Mapping[str, int] = field(default_factory=dict)
    frame: str = ""
    faulty: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "elements", tuple(self.elements))
        for start in range(0, len(self.elements), _AT_ONCE):
            _require_numbers(self.elements[start : start + _AT_ONCE], self.name)
        if len(self._row_of_id) < len(self.elements):
            repeated = next(e.id for row, e in enumerate(self.elements) if self._row_of_id[e.id] != row)
            # Such files exist, and `inspect` is there to say what is wrong with them.
            _LOG.warning(
                "map %s: two elements have the id '%s'; answers by id name the last one; rename one",
                self.name,
                repeated[:60],
            )
        require_place(self.origin, self.name)

    @cached_property
    def ground(self) -> GroundModel:
        """The road surface of the map; of a large one only around the places that are asked for."""
        if len(self.elements) > _WHOLE_GROUND:
            return TiledGround(self._within)
        return GroundModel.from_elements(self.elements)

    def _within(self, center: np.ndarray, radius_m: float) -> list[MapElement]:
        return [self.elements[row] for row in self._plans.near(center, radius_m)]

    @cached_property
    def labels(self) -> frozenset[ElementClass]:
        """The classes that the map holds."""
        return frozenset(element.label for element in self.elements)

    def walk(self) -> Iterator[MapElement]:
        """Yields every element in its order; a map that stays in its file does not keep them."""
        return iter(self.elements)

    @property
    def is_visible(self) -> bool:
        """Whether there is anything that a camera could see."""
        return any(not element.is_logical for element in self.elements)

    @property
    def num_elements(self) -> int:
        """Number of rows that `rows_of` may name."""
        return len(self.elements)

    @cached_property
    def _row_of_id(self) -> dict[str, int]:
        return {element.id: row for row, element in enumerate(self.elements)}

    def rows_of(self, ids: Iterable[str]) -> np.ndarray:
        """Returns the row of each element that a query found, `int64[k]`."""
        return np.array([self._row_of_id[key] for key in ids], dtype=np.int64)

    def element_at(self, row: int) -> MapElement:
        """Returns the element of a row."""
        return self.elements[row]

    @cached_property
    def extent(self) -> np.ndarray:
        """Bounding box in the map frame, `float64[2 3]`: minimum and maximum [m]."""
        points = np.vstack([element.points for element in self.elements])
        return np.stack([points.min(axis=0), points.max(axis=0)])

    @cached_property
    def _is_mixed(self) -> bool:
        """Whether some elements have heights and some have not."""
        return len({element.has_height for element in self.elements}) == 2

    @cached_property
    def _plans(self) -> PlanIndex:
        return PlanIndex(self.elements)

    def query(self, center_map: Place, radius_m: float, heading_rad: float | None = None) -> LocalMap:
        """Returns the elements that come within `radius_m` of a place, with lines cut at that radius.

        Elements without heights in a map that has some lie on the plane of the road at the place.

        Args:
            center_map: place in the map frame, `[2]` or `[3]` [m]; without a height the road's is taken.
            radius_m: search radius in the horizontal plane.
            heading_rad: where the vehicle looks; if given, elements farther behind than half the radius are left out.

        Raises:
            SemlocError: the place is not finite, the radius is not positive, or the map is empty.
        """
        center = self._checked_center(center_map, radius_m)
        if not self.elements:
            raise SemlocError(f"map {self.name} has no elements; expected at least one marking, pole or sign")
        found: list[MapElement] = []
        for index in self._plans.near(center, radius_m):
            found.extend(clip_element(self.elements[index], center[:2], radius_m))
        if heading_rad is not None:
            found = [element for element in found if reaches_ahead(element, center[:2], heading_rad, -0.5 * radius_m)]
        found = joined_dashes(found)
        if self._is_mixed:
            found = [*lifted(found, self.ground, center)]
        return LocalMap(tuple(found), self._local_origin(center, radius_m), self.ground, radius_m)

    def with_elements(self, elements: Iterable[MapElement]) -> "SemanticMap":
        """Returns a map in memory with other elements and the same place, name and frame."""
        return SemanticMap(tuple(elements), self.origin, self.name, self.skipped, self.frame, self.faulty)

    def whole(self) -> LocalMap:
        """Returns the whole map as a LocalMap with its origin in the middle of the extent."""
        if not self.elements:
            raise SemlocError(f"map {self.name} has no elements; expected at least one marking, pole or sign")
        return LocalMap(self.elements, np.round(self.extent.mean(axis=0)), self.ground)

    def road_pose(self, x: float, y: float, yaw: float, near_z_m: float | None = None) -> np.ndarray:
        """Returns `T_map_base` `[4 4]` of a vehicle on the road at (x, y) [m] with heading yaw [rad].

        Args:
            x: position in the map frame [m].
            y: position in the map frame [m].
            yaw: heading [rad].
            near_z_m: about how high the road is, for maps with decks or bridges; None takes all levels.
        """
        return self.ground.road_pose(x, y, yaw, near_z_m=near_z_m)

    def road_poses(self, xy: Sequence[Place], yaw: float) -> list[np.ndarray | None]:
        """Returns `road_pose` at places `[n 2]` of one heading in one go; None where the map has no road."""
        return self.ground.road_poses(xy, yaw)

    def road_spread(self, T_map_base: np.ndarray) -> RoadSpread:
        """Returns how far the road is from a plane around a vehicle; see `GroundModel.road_spread`."""
        x, y, z = (float(value) for value in T_map_base[:3, 3])
        return self.ground.road_spread(x, y, float(np.arctan2(T_map_base[1, 0], T_map_base[0, 0])), near_z_m=z)

    def road_under(
        self, x: float, y: float, yaw: float, near_z_m: float | None = None
    ) -> tuple[np.ndarray, RoadSpread]:
        """Returns `road_pose` and `road_spread` of a place in one go; arguments as `road_pose`."""
        return self.ground.road_under(x, y, yaw, near_z_m)

    @staticmethod
    def _checked_center(center_map: Place, radius_m: float) -> np.ndarray:
        center = np.asarray(center_map, dtype=np.float64).reshape(-1)
        if center.size not in (2, 3) or not np.isfinite(center).all() or not radius_m > 0:
            raise SemlocError(
                f"map query at {center} within {radius_m} m; expected 2 or 3 finite numbers and radius > 0"
            )
        return center

    def _local_origin(self, center: np.ndarray, radius_m: float) -> np.ndarray:
        """Returns whole metres near the centre, `[3]`, so that local coordinates stay exact in decimal files."""
        if center.size == 3:
            return np.round(center)
        near = self.ground.heights_near(center, radius_m)
        return np.round(np.append(center, np.median(near) if len(near) else self.extent[:, 2].mean()))


def _require_numbers(elements: Sequence[MapElement], name: str) -> None:
    """Raises where an element has coordinates or sizes that nothing on a road has."""
    sizes = np.array([(e.width_m, e.radius_m, e.radius_top_m, e.height_m) for e in elements], dtype=np.float64)
    is_near = np.abs(np.concatenate([e.points for e in elements])) < FARTHEST_M
    if is_near.all() and ((sizes >= 0.0) & (sizes < LARGEST_M)).all():
        return
    for element, own in zip(elements, sizes, strict=True):
        where = f"map {name}: element '{element.id[:60]}'"
        if not (np.abs(element.points) < FARTHEST_M).all():
            raise SemlocError(f"{where} has NaN, infinite or huge coordinates; repair it")
        if not ((own >= 0.0) & (own < LARGEST_M)).all():
            raise SemlocError(f"{where} has sizes {tuple(own.tolist())}; expected 0 to {LARGEST_M:.0f} m")


def require_place(origin: GeoOrigin | None, name: str) -> None:
    """Raises where an origin is no place on the earth."""
    if origin is None:
        return
    if not (abs(origin.lat_deg) <= 90.0 and abs(origin.lon_deg) <= 360.0 and abs(origin.alt_m) < 1e5):
        raise SemlocError(f"map {name}: origin {tuple(origin)}; expected latitude, longitude and height on the earth")


def clip_element(element: MapElement, center: np.ndarray, radius_m: float) -> list[MapElement]:
    """Returns the parts of a line inside the radius; areas and upright things stay whole."""
    if element.closed or element.label in UPRIGHT_CLASSES or len(element.points) < 2:
        return [element]
    parts = clip_to_circle(without_repeats(element.points), center, radius_m)
    start, end = element.true_ends
    return [element.with_points(points, (start and first, end and last)) for points, first, last in parts]


def reaches_ahead(element: MapElement, center: np.ndarray, heading_rad: float, limit_m: float) -> bool:
    direction = np.array([np.cos(heading_rad), np.sin(heading_rad)])
    return bool(np.max((element.points[:, :2] - center) @ direction) >= limit_m)
