"""GeoJSON features and map elements: the property names both kinds of GeoJSON share (room: maps; host).

In: one parsed feature or one element. Out: the other. Properties: class; width, radius, radius_top, height [m]; style,
shape, normal (unit vector, east north up), true_ends (whether the first and last point end the paint, default both);
whatever else stands there is kept as attributes. The classes are the keys of FEATURE_CLASSES.
"""

import contextlib
import json
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import LARGEST_M, UPRIGHT_CLASSES, VIRTUAL, MapElement
from semloc_jax.storage import FARTHEST_M, write_text
from semloc_jax.structs import ElementClass

_LINE, _AREA, _ANY = frozenset({"LineString"}), frozenset({"Polygon"}), frozenset({"LineString", "Polygon"})

FEATURE_CLASSES: dict[str, tuple[ElementClass, str, frozenset[str]]] = {
    "lane_solid": (ElementClass.LANE_MARKING, "solid", _ANY),
    "lane_dashed": (ElementClass.LANE_MARKING, "dashed", _ANY),
    "lane_boundary": (ElementClass.LANE_MARKING, VIRTUAL, _LINE),
    "stop_line": (ElementClass.STOP_LINE, "", _ANY),
    "crosswalk": (ElementClass.CROSSWALK, "", _ANY),
    "arrow": (ElementClass.ROAD_MARK, "", _ANY),
    "road_mark": (ElementClass.ROAD_MARK, "", _ANY),
    "slot_line": (ElementClass.SLOT_LINE, "", _ANY),
    "parking_slot": (ElementClass.PARKING_SLOT, "", _AREA),
    "slot_number": (ElementClass.ROAD_MARK, VIRTUAL, _AREA),
    "speed_bump": (ElementClass.SPEED_BUMP, "", _ANY),
    "pole": (ElementClass.POLE, "", _LINE),
    "sign": (ElementClass.SIGN, "", _ANY),
    "traffic_light": (ElementClass.TRAFFIC_LIGHT, "", _LINE),
    "pillar": (ElementClass.PILLAR, "", _ANY),
    "cone": (ElementClass.CONE, "", _LINE),
    "curb": (ElementClass.CURB, "", _ANY),
    "guardrail": (ElementClass.GUARDRAIL, "", _LINE),
}
"""Class name in the file -> class, default style, geometries allowed."""

_CONE_TOP_SHARE = 0.2
"""Radius at the top of a traffic cone against that at its base, where the file does not say (our assumption)."""
_NUMBERS = ("width", "radius", "radius_top", "height")
_AT_ONCE = 64
"""Elements whose points are made and moved together."""
ToLocal = Callable[[np.ndarray], np.ndarray]


def elements_from_features(
    document: Mapping[str, Any], name: str, to_local: ToLocal | None = None
) -> tuple[tuple[MapElement, ...], dict[str, int], dict[str, str]]:
    """Returns the elements of a FeatureCollection, how many features of each unknown class were left out, and what is
    wrong with each feature that cannot be read, by its id.

    Args:
        document: parsed GeoJSON.
        name: map name for messages.
        to_local: maps file coordinates `[k 3]` to the map frame; None leaves them.
    """
    found: list[MapElement] = []
    waiting: list[MapElement] = []
    skipped: Counter[str] = Counter()
    faulty: dict[str, str] = {}
    for index, feature, points in _with_points(document["features"]):
        try:
            element = element_from_feature(feature, index, name, points=points)
        except SemlocError as error:
            faulty[feature_id(feature, index)] = str(error)
            continue
        if isinstance(element, str):
            skipped[element] += 1
        else:
            waiting.append(element)
        if len(waiting) == _AT_ONCE:
            found += _moved(waiting, to_local, faulty)
            waiting = []
    return (*found, *_moved(waiting, to_local, faulty)), dict(skipped), faulty


def _with_points(features: Iterable[Any]) -> Iterator[tuple[int, Any, np.ndarray | None]]:
    """Yields the features with their places in the file, those of plain geometry with their points.

    What numpy does costs as much for ten numbers as for a thousand, so the points of some features are made together.
    """
    numbered = enumerate(features)
    while some := list(islice(numbered, _AT_ONCE)):
        rows = [_plain_positions(feature) for _, feature in some]
        made: dict[int, Iterator[np.ndarray]] = {
            size: _blocks([row for row in rows if row and len(row[0]) == size], size) for size in (2, 3)
        }
        for (index, feature), row in zip(some, rows, strict=True):
            yield index, feature, next(made[len(row[0])], None) if row else None


def _plain_positions(feature: Any) -> list[Any] | None:
    """Returns the positions of a line or a simple outline, without its last point, that all have one length; None for
    any other geometry, which is looked at on its own."""
    try:
        geometry = feature["geometry"]
        is_closed = geometry["type"] == "Polygon"
        row = geometry["coordinates"][0] if is_closed else geometry["coordinates"]
        if is_closed and row[0] == row[-1]:
            row = row[:-1]
        is_known = type(row) is list and geometry["type"] in ("Polygon", "LineString")
        is_plain = is_known and len(row) >= (3 if is_closed else 2) and len(set(map(len, row))) == 1
        return row if is_plain and len(row[0]) in (2, 3) else None
    except (TypeError, KeyError, IndexError, AttributeError):
        return None


def _blocks(rows: list[list[Any]], size: int) -> Iterator[np.ndarray]:
    """Yields the points of each row `[k 3]`, made at once; nothing where any of the numbers is none or too large."""
    flat = list(chain.from_iterable(chain.from_iterable(rows)))
    if not set(map(type, flat)) <= {float, int}:
        return
    try:
        table = np.array(flat, dtype=np.float64).reshape(-1, size)
    except OverflowError:  # a whole number of 400 digits
        return
    if not (table.size and table.max() < FARTHEST_M and table.min() > -FARTHEST_M):
        return
    points = table if size == 3 else np.column_stack([table, np.zeros(len(table))])
    end = 0
    for row in rows:
        start, end = end, end + len(row)
        yield points[start:end]


def _moved(elements: list[MapElement], to_local: ToLocal | None, faulty: dict[str, str]) -> Iterator[MapElement]:
    """Yields elements in the map frame, all moved at once; where one cannot be, one by one, and `faulty` names it."""
    if to_local is None or not elements:
        yield from elements
        return
    try:
        points = to_local(np.concatenate([element.points for element in elements]))
    except SemlocError as error:
        if len(elements) == 1:
            faulty[elements[0].id] = str(error)
            return
        for element in elements:
            yield from _moved([element], to_local, faulty)
        return
    ends = np.cumsum([len(element.points) for element in elements])
    flat = [not element.has_height for element in elements]
    points[np.repeat(flat, np.diff(ends, prepend=0)), 2] = 0.0
    points.setflags(write=False)
    for element, start, end in zip(elements, [0, *ends[:-1].tolist()], ends.tolist(), strict=True):
        object.__setattr__(element, "points", points[start:end])  # made here a moment ago: nobody holds it yet
        yield element


def feature_id(feature: Any, index: int) -> str:
    """Returns the id of a feature, its place in the file where it has none."""
    return str(feature.get("id", index) if isinstance(feature, Mapping) else index)


def write_features(path: str | Path, members: Mapping[str, Any], features: list[dict[str, Any]]) -> None:
    """Writes a FeatureCollection with some foreign members, one feature a line so that versions can be compared."""
    head = json.dumps({"type": "FeatureCollection", **members}, allow_nan=False)
    try:
        lines = ",\n".join(json.dumps(feature, allow_nan=False) for feature in features)
        write_text(path, f'{head[:-1]}, "features": [\n{lines}\n]}}\n')
    except OSError as error:
        raise SemlocError(f"cannot write map {path}: {error.strerror}; give a path in a folder that exists") from error
    except ValueError as error:
        raise SemlocError(
            f"cannot write map {path}: an attribute is NaN or infinite; JSON has no such numbers"
        ) from error


def element_from_feature(
    feature: Any, index: int, name: str, to_local: ToLocal | None = None, points: np.ndarray | None = None
) -> MapElement | str:
    """Returns the element of one feature, or the reason why it is skipped (an unknown class).

    Args:
        feature: parsed GeoJSON feature.
        index: its place in the file, for messages and missing ids.
        name: map name for messages.
        to_local: maps file coordinates `[k 3]` to the map frame; None leaves them.
        points: those of a plain geometry where they are made already; None takes them from the feature.

    Raises:
        SemlocError: wrong geometry, non-finite coordinates or numbers.
    """
    if not isinstance(feature, Mapping) or not isinstance(feature.get("properties"), Mapping):
        raise SemlocError(f"map {name}: feature {index} has no properties; expected a GeoJSON Feature with a `class`")
    properties = feature["properties"]
    where = f"map {name}: feature {feature.get('id', index)}"
    class_name = str(properties.get("class", "without class"))
    if class_name not in FEATURE_CLASSES:
        return class_name
    label, style, allowed = FEATURE_CLASSES[class_name]
    geometry = feature.get("geometry")
    if points is None or geometry["type"] not in allowed:
        points, closed, has_height = _coordinates(geometry, allowed, f"{where} ({class_name})")
    else:
        closed = geometry["type"] == "Polygon"
        has_height = len((geometry["coordinates"][0] if closed else geometry["coordinates"])[0]) == 3
    if to_local is not None:
        points = to_local(points)
        points = points if has_height else points * [1.0, 1.0, 0.0]
    if label in UPRIGHT_CLASSES and len(points) != 2:
        raise SemlocError(f"{where} ({class_name}): {len(points)} points; expected two, the base and the top")
    width, radius, radius_top, height = (_number(properties.get(key), key, where) for key in _NUMBERS)
    if "radius_top" not in properties:
        radius_top = _usual_radius_top(label, radius)
    return MapElement(
        id=str(feature.get("id", f"{class_name}_{index}")),
        label=label,
        points=points,
        closed=closed,
        width_m=width if not closed else 0.0,
        radius_m=radius,
        radius_top_m=radius_top,
        height_m=height,
        style=style if style == VIRTUAL else str(properties.get("style", style)),
        shape=str(properties.get("shape", properties.get("kind", ""))) if label in _SHAPED else "",
        normal=_normal(properties.get("normal"), where),
        true_ends=_true_ends(properties.get("true_ends"), where),
        has_height=has_height,
        attributes=_kept(properties, class_name),
    )


def _kept(properties: Mapping[str, Any], class_name: str) -> dict[str, Any]:
    """Properties with names that all elements share: a parser makes them anew for each feature."""
    kept = {sys.intern(str(key)): value for key, value in properties.items()}
    kept["class"] = sys.intern(class_name)
    return kept


def feature_from_element(element: MapElement, to_file: Callable[[np.ndarray], np.ndarray]) -> dict[str, Any]:
    """Returns the GeoJSON feature of an element; `to_file` maps its points `[k 3]` to file coordinates."""
    properties = dict(element.attributes)
    properties["class"] = feature_class(element)
    values = (element.width_m, element.radius_m, element.radius_top_m, element.height_m)
    usual = (0.0, 0.0, _usual_radius_top(element.label, element.radius_m), 0.0)
    for key, value, default in zip(_NUMBERS, values, usual, strict=True):
        if value != default or (key in properties and not element.closed):
            properties[key] = value
    usual_style = FEATURE_CLASSES[properties["class"]][1]
    if usual_style != VIRTUAL and ("style" in properties or element.style != usual_style):
        properties["style"] = element.style
    if element.true_ends != (True, True):
        properties["true_ends"] = list(element.true_ends)
    if element.label in _SHAPED and element.shape != properties.get("kind", ""):
        properties["shape"] = element.shape
    if element.normal is not None and not np.allclose(element.normal, properties.get("normal", 0.0), atol=1e-4):
        properties["normal"] = [float(v) for v in element.normal]
    coordinates = to_file(element.points)[:, : 3 if element.has_height else 2].tolist()
    if element.closed:
        geometry = {"type": "Polygon", "coordinates": [[*coordinates, coordinates[0]]]}
    else:
        geometry = {"type": "LineString", "coordinates": coordinates}
    return {"type": "Feature", "id": element.id, "properties": properties, "geometry": geometry}


def feature_class(element: MapElement) -> str:
    """Returns the class name of an element in GeoJSON."""
    known = str(element.attributes.get("class"))  # of another format it may be a list, which no table takes
    if element.style == VIRTUAL and element.label == ElementClass.LANE_MARKING:
        return "lane_boundary"
    if known in FEATURE_CLASSES and known != "lane_boundary" and FEATURE_CLASSES[known][0] == element.label:
        return known
    if element.label == ElementClass.LANE_MARKING:
        return "lane_dashed" if element.style == "dashed" else "lane_solid"
    return element.label.name.lower()


_SHAPED = frozenset({ElementClass.SIGN, ElementClass.ROAD_MARK})


def _coordinates(geometry: Any, allowed: frozenset[str], where: str) -> tuple[np.ndarray, bool, bool]:
    """Returns the points `[k 3]` of a geometry (outer ring without repeat), whether closed, whether with heights."""
    kind = geometry.get("type") if isinstance(geometry, Mapping) else None
    if not isinstance(kind, str) or kind not in allowed:
        raise SemlocError(f"{where}: geometry {kind}; expected {' or '.join(sorted(allowed))}")
    closed = kind == "Polygon"
    try:
        raw = geometry["coordinates"][0] if closed else geometry["coordinates"]
        points, has_height = _points_of(raw)
    except (KeyError, IndexError, TypeError, ValueError, OverflowError) as error:
        raise SemlocError(f"{where}: coordinates cannot be read; expected lists of [x, y, z] numbers") from error
    if closed and len(points) > 1 and np.array_equal(points[0], points[-1]):
        points = points[:-1]
    if len(points) < (3 if closed else 2):
        raise SemlocError(f"{where}: {len(points)} points; expected at least {3 if closed else 2}")
    if not (points.max() < FARTHEST_M and points.min() > -FARTHEST_M):
        raise SemlocError(f"{where}: NaN, infinite or huge coordinates; expected metres or degrees on the earth")
    return points, closed, has_height


def _points_of(raw: Any) -> tuple[np.ndarray, bool]:
    """Returns the points of a list of positions `[k 3]`, and whether all have heights."""
    with contextlib.suppress(TypeError, ValueError):  # positions of several lengths
        points = np.array(raw, dtype=np.float64)
        if points.ndim == 2 and points.shape[1] in (2, 3):
            has_height = points.shape[1] == 3
            return points if has_height else np.column_stack([points, np.zeros(len(points))]), has_height
    has_height = all(len(p) > 2 for p in raw)
    return np.array([[p[0], p[1], p[2] if has_height else 0.0] for p in raw], dtype=np.float64), has_height


def _usual_radius_top(label: ElementClass, radius_m: float) -> float:
    return _CONE_TOP_SHARE * radius_m if label == ElementClass.CONE else radius_m


def _number(value: Any, key: str, where: str) -> float:
    if value is None:
        return 0.0
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = float("nan")
    if not 0.0 <= number < LARGEST_M:
        raise SemlocError(f"{where}: {key} = {str(value)[:40]!r}; expected metres from 0 to {LARGEST_M:.0f}")
    return number


def _true_ends(value: Any, where: str) -> tuple[bool, bool]:
    if value is None:
        return (True, True)
    if not (isinstance(value, list) and len(value) == 2 and all(isinstance(end, bool) for end in value)):
        raise SemlocError(f"{where}: true_ends = {value!r}; expected two of true and false, for the start and the end")
    return (value[0], value[1])


def _normal(value: Any, where: str) -> np.ndarray | None:
    if value is None:
        return None
    try:
        normal = np.array(value, dtype=np.float64)
        size = float(np.abs(normal).max(initial=0.0))
    except (TypeError, ValueError, OverflowError):
        normal, size = np.zeros(0), 0.0
    if normal.shape != (3,) or not 0.0 < size < LARGEST_M:
        raise SemlocError(f"{where}: normal = {str(value)[:60]}; expected three finite numbers that are not all zero")
    return normal / np.linalg.norm(normal)
