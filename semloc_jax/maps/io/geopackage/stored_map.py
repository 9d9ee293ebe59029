"""A map that stays in its file: a query reads its elements only (room: maps; host).

In: a connection to our own GeoPackage. Out: StoredMap, a SemanticMap whose queries cost what lies around the place.
"""

import itertools
import json
import math
import sqlite3
from collections import OrderedDict
from collections.abc import Iterable, Iterator
from functools import cached_property

import numpy as np
import shapely

from semloc_jax.errors import SemlocError
from semloc_jax.maps.around_place import TiledGround, plan_geometry
from semloc_jax.maps.assumed_dashes import joined_dashes
from semloc_jax.maps.elements import GeoOrigin, MapElement, Place
from semloc_jax.maps.ground import GroundModel
from semloc_jax.maps.heights import lifted
from semloc_jax.maps.io.features import FEATURE_CLASSES
from semloc_jax.maps.io.geopackage import schema
from semloc_jax.maps.io.geopackage.geometry import from_blob
from semloc_jax.maps.semantic_map import (
    LocalMap,
    SemanticMap,
    clip_element,
    reaches_ahead,
    require_place,
)
from semloc_jax.maps.soundness import fault_of, faults_of, tell
from semloc_jax.storage import FARTHEST_M
from semloc_jax.structs import ElementClass

_MOST_CACHED = 50_000
_AT_ONCE = 500
_HIGHEST_FID = 20_000_000

_COLUMNS = (
    "fid, geom, id, class, style, shape, closed, width, radius, radius_top, height, normal_x, normal_y, normal_z, "
    "true_start, true_end, has_height, attributes"
)
_WITHIN = (
    f"SELECT id, minx, maxx, miny, maxy FROM {schema.INDEX} WHERE maxx >= ? AND minx <= ? AND maxy >= ? AND miny <= ?"
)


class StoredMap(SemanticMap):
    """A map in a GeoPackage. What was read stays in memory, up to 50,000 elements, the oldest goes first.

    The cost of everything but `elements` grows with what lies around the queried places, not with the file.
    """

    def __init__(self, connection: schema.GuardedConnection, file_name: str):
        members = dict(connection.ask("SELECT key, value FROM semloc_map"))
        try:
            origin = json.loads(members["origin"])
            values = {
                "name": str(json.loads(members["name"])),
                "origin": GeoOrigin(*map(float, origin)) if origin is not None else None,
                "frame": str(json.loads(members["frame"])),
                "skipped": {str(key): int(count) for key, count in json.loads(members["skipped"]).items()},
            }
        except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
            raise SemlocError(f"map {file_name}: its table semloc_map is incomplete ({error})") from error
        require_place(values["origin"], file_name)
        for key, value in values.items():
            object.__setattr__(self, key, value)
        object.__setattr__(self, "_connection", connection)
        object.__setattr__(self, "_file_name", file_name)
        object.__setattr__(self, "_cache", OrderedDict())
        object.__setattr__(self, "_row_of_id", {})
        object.__setattr__(self, "faulty", {})

    @cached_property
    def elements(self) -> tuple[MapElement, ...]:
        """Every element of the file that is none of `faulty`, in its order: reads all of it."""
        return tuple(self.walk())

    def walk(self) -> Iterator[MapElement]:
        """Yields every element that is none of `faulty`, in the order of the file, and keeps none."""
        rows = self._rows(f"SELECT {_COLUMNS} FROM elements ORDER BY fid", ())
        while some := [_element(row, self._file_name) for row in itertools.islice(rows, _AT_ONCE)]:
            faults = faults_of(some)
            for row, fault in faults.items():
                self._leave_out(some[row], fault)
            yield from (element for row, element in enumerate(some) if row not in faults)

    @cached_property
    def labels(self) -> frozenset[ElementClass]:
        """The classes that the map holds."""
        names = [name for (name,) in self._ask("SELECT DISTINCT class FROM elements", ())]
        return frozenset(FEATURE_CLASSES[name][0] for name in names if name in FEATURE_CLASSES)

    @cached_property
    def num_elements(self) -> int:
        """Number of rows that `rows_of` may name: the largest number of an element."""
        first, last = self._ask("SELECT coalesce(min(fid), 1), coalesce(max(fid), 0) FROM elements", ())[0]
        if first < 1 or last > _HIGHEST_FID:
            raise SemlocError(
                f"map {self._file_name}: its elements are numbered from {first} to {last}; expected 1 to "
                f"{_HIGHEST_FID}: convert it to another .gpkg"
            )
        return int(last)

    def rows_of(self, ids: Iterable[str]) -> np.ndarray:
        """Returns the places in the file of elements that a query found, `int64[k]`."""
        return np.array([self._row_of_id[key] for key in ids], dtype=np.int64)

    def element_at(self, row: int) -> MapElement:
        """Returns the element at a place in the file."""
        item = self._items([row + 1])[0]
        if item is None:
            raise SemlocError(f"map {self._file_name}: element {row + 1} is left out; see `faulty`")
        return item[0]

    @cached_property
    def ground(self) -> GroundModel:
        """The road surface, fitted to the elements around each queried place."""
        return TiledGround(self.within)

    @cached_property
    def extent(self) -> np.ndarray:
        """Bounding box in the map frame seen from above, `float64[2 3]`, heights 0 [m]."""
        query = f"SELECT min(minx), min(miny), 0.0, max(maxx), max(maxy), 0.0 FROM {schema.INDEX}"
        (row,) = self._ask(query, ())
        return np.array([value or 0.0 for value in row], dtype=np.float64).reshape(2, 3)

    @property
    def is_visible(self) -> bool:
        """Whether there is anything that a camera could see."""
        query = "SELECT EXISTS (SELECT 1 FROM elements WHERE style != 'virtual' AND class != 'parking_slot')"
        return bool(self._ask(query, ())[0][0])

    def query(self, center_map: Place, radius_m: float, heading_rad: float | None = None) -> LocalMap:
        """Returns the elements that come within `radius_m` of a place; see `SemanticMap.query`."""
        center = self._checked_center(center_map, radius_m)
        x, y = center[:2]
        rows = self._ask(_WITHIN, (x - radius_m, x + radius_m, y - radius_m, y + radius_m))
        boxes = np.array(rows, dtype=np.float64).reshape(-1, 5)
        boxes = boxes[np.argsort(boxes[:, 0])]
        items = self._items(boxes[:, 0].astype(np.int64).tolist())
        boxes = boxes[np.array([item is not None for item in items], dtype=bool)]
        items = [item for item in items if item is not None]
        near = shapely.dwithin(np.array([item[1] for item in items], dtype=object), shapely.Point(x, y), radius_m)
        reach = np.maximum(np.abs(boxes[:, 1:3] - x).max(axis=1), 0.0) ** 2
        reach += np.maximum(np.abs(boxes[:, 3:5] - y).max(axis=1), 0.0) ** 2
        found: list[MapElement] = []
        for (element, _), is_near, is_inside in zip(items, near, reach <= radius_m**2, strict=True):
            if is_near:
                found += [element] if is_inside else clip_element(element, center[:2], radius_m)
        if heading_rad is not None:
            found = [element for element in found if reaches_ahead(element, center[:2], heading_rad, -0.5 * radius_m)]
        found = joined_dashes(found)
        if len({element.has_height for element in found}) == 2:
            found = [*lifted(found, self.ground, center)]
        return LocalMap(tuple(found), self._origin_of(found, center), self.ground, radius_m)

    def within(self, center: np.ndarray, radius_m: float) -> list[MapElement]:
        """Returns the elements whose boxes come within a square about a place `[2]`, uncut."""
        x, y = center[:2]
        rows = self._ask(_WITHIN, (x - radius_m, x + radius_m, y - radius_m, y + radius_m))
        return [item[0] for item in self._items(sorted(int(row[0]) for row in rows)) if item is not None]

    def _items(self, fids: list[int]) -> list[tuple[MapElement, shapely.Geometry] | None]:
        """Returns elements and their plan by number, from memory where they were read before; None for faulty ones."""
        missing = [fid for fid in fids if fid not in self._cache]
        for start in range(0, len(missing), _AT_ONCE):
            some = missing[start : start + _AT_ONCE]
            marks = ", ".join("?" * len(some))
            for row in self._ask(f"SELECT {_COLUMNS} FROM elements WHERE fid IN ({marks})", some):
                element = self._sound(row)
                self._cache[row[0]] = None if element is None else (element, plan_geometry(element))
                if element is not None:
                    self._row_of_id[element.id] = row[0] - 1
        lost = [fid for fid in fids if fid not in self._cache]
        if lost:
            raise SemlocError(f"map {self._file_name}: its R-tree names element {lost[0]}, which is not there")
        items = [self._cache[fid] for fid in fids]
        for fid in fids:
            self._cache.move_to_end(fid)
        while len(self._cache) > max(_MOST_CACHED, len(fids)):
            self._cache.popitem(last=False)
        return items

    def _sound(self, row: tuple) -> MapElement | None:
        """Returns the element of a row; None, with one line of notice, where it cannot be meant."""
        element = _element(row, self._file_name)
        fault = fault_of(element)
        if fault is None:
            return element
        self._leave_out(element, fault)
        return None

    def _leave_out(self, element: MapElement, fault: str) -> None:
        if element.id not in self.faulty:
            self.faulty[element.id] = fault
            tell({element.id: fault}, self._file_name)

    def _origin_of(self, found: list[MapElement], center: np.ndarray) -> np.ndarray:
        """Returns whole metres near the centre, `[3]`, at the height of what lies around it."""
        if center.size == 3 or not found:
            return np.round(np.append(center, 0.0)[:3])
        return np.round(np.append(center, np.median([element.points[0, 2] for element in found])))

    def _ask(self, query: str, values: Iterable[object]) -> list[tuple]:
        return list(self._rows(query, values))

    def _rows(self, query: str, values: Iterable[object]) -> Iterator[tuple]:
        try:
            yield from self._connection.walk(query, values)
        except (sqlite3.Error, UnicodeDecodeError) as error:
            why = " ".join(str(error).split())[:160]
            raise SemlocError(f"map {self._file_name}: cannot be read ({why}); is the file complete?") from error


def _element(row: tuple, name: str) -> MapElement:
    """Returns the element of one row."""
    where = f"map {name}: element {row[0]}"
    class_name = row[3]
    if class_name not in FEATURE_CLASSES:
        raise SemlocError(f"{where}: class '{str(class_name)[:40]}'; expected one of {', '.join(FEATURE_CLASSES)}")
    points, closed, _ = from_blob(row[1], where)
    try:
        numbers = [float(value) for value in row[7:11]]
        normal = None if row[11] is None else np.array(row[11:14], dtype=np.float64)
        attributes = json.loads(row[17])
        if (
            not isinstance(attributes, dict)
            or not all(map(math.isfinite, numbers))
            or not (points.max() < FARTHEST_M and points.min() > -FARTHEST_M)
        ):
            raise ValueError("numbers that no element has")
    except (TypeError, ValueError, RecursionError) as error:
        raise SemlocError(f"{where}: cannot be read ({error})") from error
    return MapElement(
        id=str(row[2]),
        label=FEATURE_CLASSES[class_name][0],
        points=points,
        closed=closed or bool(row[6]),
        width_m=numbers[0],
        radius_m=numbers[1],
        radius_top_m=numbers[2],
        height_m=numbers[3],
        style=str(row[4]),
        shape=str(row[5]),
        normal=normal,
        true_ends=(bool(row[14]), bool(row[15])),
        has_height=bool(row[16]),
        attributes=attributes,
    )
