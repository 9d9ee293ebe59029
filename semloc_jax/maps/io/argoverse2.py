"""Argoverse 2 vector maps: `log_map_archive_*.json` (room: maps; host).

In: the archive, its `map` folder or the folder of a log. Out: SemanticMap in the city frame, in which the poses of the
logs are given, or in the ENU frame of an origin; and the drivable areas. The format states kinds of marks, but neither
widths nor dashes: see Argoverse2Style.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.geometry.geodesy import enu_from_projected
from semloc_jax.maps.curves import without_repeats
from semloc_jax.maps.elements import VIRTUAL, GeoOrigin, MapElement
from semloc_jax.maps.io.paint import assuming, strokes
from semloc_jax.maps.semantic_map import SemanticMap
from semloc_jax.structs import ElementClass

_CITIES = {
    "ATX": (30.27464237939507, -97.7404457407424, "EPSG:32614"),
    "DTW": (42.29993066912924, -83.17555750783717, "EPSG:32617"),
    "MIA": (25.77452579915163, -80.19656914449405, "EPSG:32617"),
    "PAO": (37.416065, -122.13571963362166, "EPSG:32610"),
    "PIT": (40.44177902989321, -80.01294377242584, "EPSG:32617"),
    "WDC": (38.889377, -77.0355047439081, "EPSG:32618"),
}
"""Zero of each city frame: latitude, longitude, and the UTM grid its axes are parallel to (av2-api)."""
_COLOURS = frozenset({"white", "yellow", "blue"})
_SAME_M = 0.01
_CAR_LANES = frozenset({"VEHICLE", "BUS"})


@dataclass(frozen=True)
class Argoverse2Style:
    """Sizes that the format leaves open, after American practice (MUTCD: 10 ft bars, 30 ft gaps); our choice."""

    width_m: float = 0.12
    double_gap_m: float = 0.12
    dash_m: float = 3.05
    gap_m: float = 9.15


def is_argoverse2(document: Any) -> bool:
    """Returns whether a parsed JSON document is a vector map of Argoverse 2."""
    return isinstance(document, Mapping) and isinstance(document.get("lane_segments"), Mapping)


def find_archive(folder: Path) -> Path | None:
    """Returns the vector map in the folder of a log or in its `map` folder, if there is one."""
    found = sorted([*folder.glob("log_map_archive_*.json"), *folder.glob("map/log_map_archive_*.json")])
    return found[0] if found else None


def map_from_argoverse2(
    document: Mapping[str, Any], name: str, origin: GeoOrigin | None = None, style: Argoverse2Style | None = None
) -> SemanticMap:
    """Returns the map in a parsed archive: painted lane boundaries once each, crosswalks, and unpainted boundaries.

    Args:
        document: the archive, whole or as a JsonFile.
        name: name of its file, which holds the city.
        origin: place of an ENU frame; None keeps the city frame.
        style: widths and dashes that the format leaves open.

    Raises:
        SemlocError: missing or broken parts, or an origin for an unknown city.
    """
    elements = [*_markings(document, name, style or Argoverse2Style()), *_crosswalks(document, name)]
    if origin is None:
        return SemanticMap(tuple(elements), None, name, frame=_frame(name))
    zero, crs = _city(name)
    moved = (element.with_points(enu_from_projected(element.points + zero, crs, origin)) for element in elements)
    return SemanticMap(tuple(moved), origin, name, frame=f"ENU, from {_frame(name)}")


def lane_bounds(document: Mapping[str, Any], name: str) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yields the left and the right boundary of each lane for cars in its direction of travel, `[k 3]` [m]."""
    for key, lane in _items(document, "lane_segments", name):
        if str(lane.get("lane_type", "VEHICLE")).upper() in _CAR_LANES:
            where = f"map {name}: lane segment {str(key)[:40]}"
            left, right = (_points(lane, f"{side}_lane_boundary", where) for side in ("left", "right"))
            yield left, right


def _markings(document: Mapping[str, Any], name: str, style: Argoverse2Style) -> Iterator[MapElement]:
    """Yields each lane boundary once: two neighbouring lanes both list the one between them."""
    seen: set[tuple[int, ...]] = set()
    for key, lane in _items(document, "lane_segments", name):
        where = f"map {name}: lane segment {str(key)[:40]}"
        for side in ("left", "right"):
            points = without_repeats(_points(lane, f"{side}_lane_boundary", where))
            kind = str(lane.get(f"{side}_lane_mark_type", "NONE")).lower()
            cells = np.rint(points / _SAME_M).astype(np.int64)
            place = min(tuple(cells.ravel().tolist()), tuple(cells[::-1].ravel().tolist()))
            if len(points) < 2 or place in seen:
                continue
            seen.add(place)
            words = _stroke_words(kind)
            told = {"argoverse2": kind, "lane": str(lane.get("lane_type", ""))}
            colours = _COLOURS.intersection(kind.split("_"))
            told |= {"color": min(colours)} if colours else {}
            line = MapElement(f"{key}_{side}", ElementClass.LANE_MARKING, points, attributes=told)
            if not words:
                yield MapElement(line.id, line.label, points, style=VIRTUAL, attributes=told)
                continue
            sizes = (style.width_m, style.double_gap_m, style.dash_m, style.gap_m)
            yield from strokes(assuming(line, "width"), words, *sizes)


def _stroke_words(kind: str) -> list[str]:
    """Returns solid or dashed for each stroke of a mark type such as SOLID_DASHED_YELLOW, in small letters."""
    words = [{"dash": "dashed"}.get(word, word) for word in kind.split("_")]
    found = [word for word in words if word in ("solid", "dashed")]
    return found * 2 if "double" in words and len(found) == 1 else found


def _crosswalks(document: Mapping[str, Any], name: str) -> Iterator[MapElement]:
    for key, crossing in _items(document, "pedestrian_crossings", name):
        where = f"map {name}: pedestrian crossing {str(key)[:40]}"
        one, other = (_points(crossing, edge, where) for edge in ("edge1", "edge2"))
        if np.linalg.norm(one[-1] - other[0]) > np.linalg.norm(one[-1] - other[-1]):
            other = other[::-1]
        outline = without_repeats(np.vstack([one, other]), closed=True)
        if len(outline) > 2:
            yield MapElement(f"crosswalk_{key}", ElementClass.CROSSWALK, outline, closed=True)


def _items(document: Mapping[str, Any], key: str, name: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yields the name and the content of each thing of a kind, one after another: a city is not held in memory."""
    table = document.get(key, {})
    for item_key, item in table.items() if isinstance(table, Mapping) else (("", None),):
        if not isinstance(item, Mapping):
            raise SemlocError(f"map {name}: {key} is no table of objects; expected an Argoverse 2 vector map")
        yield str(item_key), item


def _points(item: Mapping[str, Any], key: str, where: str) -> np.ndarray:
    """Returns a list of {x, y, z} as `float64[k 3]`."""
    try:
        points = np.array([[p["x"], p["y"], p["z"]] for p in item[key]], dtype=np.float64).reshape(-1, 3)
    except (KeyError, TypeError, ValueError) as error:
        raise SemlocError(f"{where}: {key} cannot be read; expected a list of x, y, z in metres") from error
    if len(points) < 2 or not (np.abs(points) < 1e7).all():
        raise SemlocError(f"{where}: {key} has {len(points)} points or no finite ones; expected two or more, in metres")
    return points


def _frame(name: str) -> str:
    found = _city_name(name)
    return f"Argoverse 2 city frame {found}" if found else "Argoverse 2 city frame"


def _city_name(name: str) -> str:
    found = re.search(r"_([A-Z]{3})_city", name)
    return found.group(1) if found else ""


def _city(name: str) -> tuple[np.ndarray, str]:
    """Returns the zero of the city frame in its UTM grid `float64[3]`, and the grid."""
    import pyproj

    city = _city_name(name)
    if city not in _CITIES:
        raise SemlocError(
            f"map {name}: its name holds no known city ({', '.join(_CITIES)}), so its place on the earth is "
            "unknown; leave the origin out"
        )
    lat, lon, crs = _CITIES[city]
    return np.array([*pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(lon, lat), 0.0]), crs
