"""What map files hold besides visible elements: lanes, areas, links, references (room: maps; host).

In: the path of a map. Out: directed centre lines of lanes in the frame of `read_map`, none for formats that know paint
only (GeoJSON, GeoPackage, the compact form); counts by kind, for the loss report of a conversion.
"""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from semloc_jax.geometry.polyline import arc_length
from semloc_jax.maps.curves import without_repeats
from semloc_jax.maps.elements import GeoOrigin
from semloc_jax.maps.io import apollo
from semloc_jax.maps.io.argoverse2 import find_archive, is_argoverse2, lane_bounds
from semloc_jax.maps.io.json_stream import JsonFile
from semloc_jax.maps.io.lanelet2 import lanelet_bounds
from semloc_jax.maps.io.ngii import is_ngii, link_lines
from semloc_jax.maps.io.nuscenes import is_nuscenes, lane_lines
from semloc_jax.maps.io.opendrive import driving_lane_bounds
from semloc_jax.maps.io.osm import OsmFile, read_osm
from semloc_jax.maps.io.text_format import stream_fields
from semloc_jax.maps.io.xml_stream import stream_elements

_SPACING_M = 0.5
"""Places at which a line is put half-way between two bounds; they follow curves of 10 m radius to 3 mm."""

Bounds = tuple[np.ndarray, np.ndarray]
"""Left and right bound of a lane in its direction of travel, `[k 3]` and `[j 3]`."""


def read_lane_centers(path: str | Path, origin: GeoOrigin | None) -> list[np.ndarray]:
    """Returns the centre lines of all lanes for vehicles, each `float64[k 3]` in its direction of travel [m].

    Args:
        path: a map that `read_map` reads.
        origin: that of the map that `read_map` made of it.

    Raises:
        SemlocError: the file is broken.
    """
    path = Path(path)
    if path.is_dir():
        path = find_archive(path) or path
    between = (_center(*bounds) for bounds in _bounds(path, origin))
    return [center for center in (*between, *_drawn(path, origin)) if len(center) > 1]


def _bounds(path: Path, origin: GeoOrigin | None) -> Iterator[Bounds]:
    suffix = path.suffix.lower()
    if suffix in (".osm", ".xml"):
        yield from lanelet_bounds(path)
    elif suffix == ".xodr":
        yield from driving_lane_bounds(path, origin)
    elif suffix == ".json" and is_argoverse2(document := JsonFile(path)):
        yield from lane_bounds(document, path.name)
    elif suffix in apollo.SUFFIXES:
        yield from apollo.lane_bounds(path, origin)


def _drawn(path: Path, origin: GeoOrigin | None) -> Iterator[np.ndarray]:
    """Yields the centre lines of formats that hold them as lines."""
    if is_ngii(path):
        yield from link_lines(path, origin)
    elif path.suffix.lower() == ".json" and is_nuscenes(document := JsonFile(path)):
        yield from lane_lines(document, path.name)


def _center(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Returns the line half-way between two bounds: each step pairs equal shares of their lengths."""
    left, right = (without_repeats(np.asarray(side, dtype=np.float64)) for side in (left, right))
    if min(len(left), len(right)) < 2:
        return np.zeros((0, 3))
    along = [arc_length(side) for side in (left, right)]
    count = max(2, int(max(part[-1] for part in along) / _SPACING_M) + 1)
    share = np.linspace(0.0, 1.0, count)
    pair = [
        np.column_stack([np.interp(share * part[-1], part, side[:, axis]) for axis in range(3)])
        for part, side in zip(along, (left, right), strict=True)
    ]
    return without_repeats(0.5 * (pair[0] + pair[1]))


_OF_OPENDRIVE = {
    "link": "links of roads and lanes",
    "junction": "junctions",
    "controller": "controllers of signals",
    "signalReference": "references to signals of other roads",
    "objectReference": "references to objects of other roads",
    "validity": "lanes that a signal or an object is valid for",
    "dependency": "dependencies of signals",
    "tunnel": "tunnels",
    "bridge": "bridges",
    "CRG": "curved regular grids of the surface",
}
_OF_APOLLO = {
    "lane": "centre lines and links of lanes",
    "road": "roads",
    "junction": "junctions",
    "pnc_junction": "planning junctions",
    "overlap": "overlaps",
}


def left_out(path: str | Path) -> dict[str, int]:
    """Returns the number of things of each kind in a file that a map of visible elements does not keep.

    Raises:
        SemlocError: the file is broken.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if path.is_dir():
        return {}
    if suffix in (".osm", ".xml"):
        return _of_lanelet2(read_osm(path))
    if suffix == ".xodr":
        whole = stream_elements(path, "OpenDRIVE", frozenset({"road", "junction", "controller"}))
        found = Counter(_OF_OPENDRIVE[part.tag] for item in whole for part in item.iter() if part.tag in _OF_OPENDRIVE)
        return dict(found)
    if suffix in apollo.SUFFIXES:
        return dict(Counter(_OF_APOLLO[kind] for kind, _ in stream_fields(path) if kind in _OF_APOLLO))
    return {}


def _of_lanelet2(osm: OsmFile) -> dict[str, int]:
    """Regulatory elements are kept as an attribute of the ways that they name; their other references are lost."""
    found: Counter[str] = Counter()
    for relation in osm.relations.values():
        kind = relation.tags.get("type", "without type")
        if kind != "regulatory_element":
            found[f"{kind} relations"] += 1
            continue
        ways = [ref for member, ref, _ in relation.references if member == "way" and ref in osm.ways]
        if not ways:
            found["regulatory elements that name no way"] += 1
        else:
            found["references of regulatory elements to lanelets and others"] += len(relation.references) - len(ways)
            found["tags of regulatory elements"] += len(relation.tags.keys() - {"type", "subtype"})
    return {kind: count for kind, count in found.items() if count}
