"""OpenDRIVE 1.4-1.8 maps (room: maps; host).

In: an .xodr file. Out: SemanticMap of its paint, curbs, signs, lights, poles and parking spaces.
The file is read road by road. With a <geoReference> that can be true the map lies in the ENU frame of its origin, else
it keeps the metres of the file.
"""

import logging
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import GeoOrigin, MapElement
from semloc_jax.maps.io.opendrive.georeference import Georeference
from semloc_jax.maps.io.opendrive.marks import OpenDriveStyle, mark_elements
from semloc_jax.maps.io.opendrive.objects import object_elements
from semloc_jax.maps.io.opendrive.road import Road
from semloc_jax.maps.io.opendrive.signals import signal_elements
from semloc_jax.maps.io.xml_stream import stream_elements
from semloc_jax.maps.semantic_map import SemanticMap

__all__ = ["OpenDriveStyle", "Road", "driving_lane_bounds", "read_opendrive", "read_roads"]

_log = logging.getLogger(__name__)
_MOST_ELEMENTS = 1_000_000
_LONGEST_NETWORK_M = 2e7


def read_opendrive(
    path: str | Path, origin: GeoOrigin | None = None, style: OpenDriveStyle | None = None
) -> SemanticMap:
    """Returns the map of an OpenDRIVE file.

    Args:
        path: the .xodr file.
        origin: place of the local frame, for files with a geoReference; None takes the middle of the map.
        style: widths and dashes that the file leaves open.

    Raises:
        SemlocError: broken XML, numbers that no road has, or an origin for a file without a place on the earth.
    """
    path = Path(path)
    where = f"map {path.name}"
    style = style or OpenDriveStyle()
    header: Element | None = None
    skipped: Counter[str] = Counter()
    elements: list[MapElement] = []
    length_m = 0.0
    for xml in stream_elements(path, "OpenDRIVE", frozenset({"header", "road"})):
        if xml.tag == "header":
            header = xml
            continue
        road = Road.from_xml(xml, path.name)
        length_m += road.length
        for part in (mark_elements(road, style), object_elements(road, style, lambda kind: skipped.update([kind]))):
            elements += islice(part, _MOST_ELEMENTS)
        elements += signal_elements(road, style)
        if len(elements) > _MOST_ELEMENTS or length_m > _LONGEST_NETWORK_M:
            raise SemlocError(f"{where}: more than a million elements or 20,000 km of road; cut it into parts")
    reference = Georeference.from_header(header, where)
    return _place(_with_own_ids(elements), reference, origin, where, path.name, dict(skipped))


def read_roads(path: str | Path) -> list[Road]:
    """Returns the roads of an OpenDRIVE file in the frame of the file, with their lanes and borders.

    Raises:
        SemlocError: broken XML, or numbers that no road has.
    """
    path = Path(path)
    return [Road.from_xml(xml, path.name) for xml in stream_elements(path, "OpenDRIVE", frozenset({"road"}))]


def driving_lane_bounds(path: str | Path, origin: GeoOrigin | None) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yields the left and the right border of each driving lane in its direction of travel, `[k 3]` [m].

    Args:
        path: the .xodr file.
        origin: that of its map; None keeps the metres of the file.
    """
    path = Path(path)
    reference: Georeference | None = None
    if origin is not None:
        header = next(iter(stream_elements(path, "OpenDRIVE", frozenset({"header"}))), None)
        reference = Georeference.from_header(header, f"map {path.name}")
    for road in read_roads(path):
        for left, right in road.driving_lanes():
            if reference is not None:
                left, right = (reference.to_enu(side, origin) for side in (left, right))
            yield left, right


def _place(
    elements: list[MapElement],
    reference: Georeference,
    origin: GeoOrigin | None,
    where: str,
    name: str,
    skipped: dict[str, int],
) -> SemanticMap:
    """Returns the map in the ENU frame of an origin; unchanged where its place on the earth is unknown."""
    if origin is not None:
        reference.require(where)
    stacked = np.vstack([np.zeros((0, 3)), *(element.points for element in elements)])
    own_place = reference.place(stacked, where)
    if own_place is None or not elements:
        return SemanticMap(tuple(elements), None, name, skipped)
    origin = origin or own_place
    moved = reference.to_enu(stacked, origin)
    bounds = np.cumsum([len(element.points) for element in elements])[:-1]
    parts = zip(elements, np.split(moved, bounds), strict=True)
    return SemanticMap(tuple(element.with_points(points) for element, points in parts), origin, name, skipped)


def _with_own_ids(elements: list[MapElement]) -> list[MapElement]:
    """Returns the elements with ids made unique: files repeat the ids of signals and objects."""
    seen: Counter[str] = Counter()
    found = []
    for element in elements:
        seen[element.id] += 1
        count = seen[element.id]
        found.append(element if count == 1 else replace(element, id=f"{element.id}~{count}"))
    return found
