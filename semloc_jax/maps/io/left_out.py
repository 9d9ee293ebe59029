"""What a map file holds besides visible elements: lanes, areas, links, references (room: maps; host).

In: the path of a map. Out: counts by kind, for the loss report of a conversion; none for formats without topology.
"""

from collections import Counter
from pathlib import Path

from semloc_jax.maps.io import apollo
from semloc_jax.maps.io.osm import OsmFile, read_osm
from semloc_jax.maps.io.text_format import stream_fields
from semloc_jax.maps.io.xml_stream import stream_elements

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
