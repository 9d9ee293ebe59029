"""Mutated maps of every format: a map or one line that says why not, in bounded time and memory."""

import json

import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.maps import SemanticMap, inspect_map, read_map, write_drive_geojson, write_map
from tests.maps.io.mutations import COUNTS, break_often, stops_hangs
from tests.maps.io.test_opendrive import PLAIN, ROAD
from tests.maps.io.town import town

OBJECTS = """<object type="parkingSpace" id="4" s="2.5" t="0">
<repeat distance="3.5" tStart="3" tEnd="3" length="20" s="5"/><outlines><outline id="0" closed="true">
<cornerLocal u="3" v="0" z="0" id="0"/><cornerLocal u="0" v="5" z="0" id="1"/>
<cornerRoad s="4" t="9" dz="0" id="2"/><cornerLocal u="3" v="0" z="0" id="3"/></outline></outlines><markings>
<marking width="0.1" lineLength="1" spaceLength="0.5" startOffset="0" stopOffset="0"><cornerReference id="0"/>
<cornerReference id="1"/><cornerReference id="3"/></marking></markings></object>"""


def _write(folder, suffix: str):
    """One small valid map of a format."""
    path = folder / f"valid{suffix}"
    small = SemanticMap(town(1).elements[::9], town(1).origin, "small")
    if suffix == ".drive.geojson":
        write_drive_geojson(small, path)
    elif suffix == ".xodr":
        header = "<geoReference>+proj=utm +zone=32 +datum=WGS84</geoReference>"
        shape = '<spiral curvStart="0.001" curvEnd="0.02"/>'
        place = {"x": 499980.0, "y": 5.4e6, "header": header, "shape": shape, "mark": "broken", "objects": OBJECTS}
        path.write_text(ROAD.format(**PLAIN | place))
    elif suffix == ".json":
        line = [{"x": 10.0 * k, "y": 2.0, "z": 1.0} for k in range(4)]
        lane = {"left_lane_boundary": line, "left_lane_mark_type": "DASHED_WHITE", "right_lane_boundary": line}
        crossing = {"edge1": line[:2], "edge2": line[2:]}
        path.write_text(json.dumps({"lane_segments": {"1": lane}, "pedestrian_crossings": {"2": crossing}}))
    else:
        write_map(small, path)
    return path


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("suffix", [".geojson", ".drive.geojson", ".osm", ".gpkg", ".smap", ".xodr", ".json"])
def test_a_broken_map_is_read_or_refused_in_one_line(tmp_path, suffix, count):
    original = _write(tmp_path, suffix)
    assert read_map(original).elements
    path = tmp_path / f"broken{suffix}"

    def use(content):
        path.write_bytes(content)
        found = read_map(path)
        inspect_map(SemanticMap(found.elements[:50], found.origin))

    assert break_often(original.read_bytes(), count, use) > 0.1 * count


BOMB = '<?xml version="1.0"?><!DOCTYPE {root} [<!ENTITY a "{ha}"><!ENTITY b "&a;&a;&a;&a;">]><{root}>&b;</{root}>'


@pytest.mark.parametrize(("name", "root"), [("bomb.xodr", "OpenDRIVE"), ("bomb.osm", "osm")])
def test_entity_bombs_and_deep_trees_are_refused(tmp_path, name, root):
    path = tmp_path / name
    path.write_text(BOMB.format(root=root, ha="ha" * 1000))
    with pytest.raises(SemlocError, match="declares a document type"):
        read_map(path)
    path.write_text(f'<{root}><road id="1">' + "<a>" * 100_000)
    with pytest.raises(SemlocError, match="nested deeper|not well-formed"):
        read_map(path)


@pytest.mark.parametrize(
    "values",
    [
        {"length": 1.9e5, "shape": '<arc curvature="0.001"/>'},
        {"length": 9.9e4, "shape": '<paramPoly3 aU="0" bU="1" cU="9" dU="9" aV="0" bV="1" cV="-9" dV="9"/>'},
        {"length": 9.9e4, "mark": "broken", "width": 1e-9},
        {"objects": OBJECTS.replace('v="5"', 'v="9e8"')},
        {"length": 9.9e4, "lateral": '<superelevation s="0" a="0" b="0" c="9" d="9"/>'},
    ],
)
def test_roads_made_to_take_long_do_not(tmp_path, values):
    path = tmp_path / "long.xodr"
    path.write_text(ROAD.format(**PLAIN | values))
    with stops_hangs():
        try:
            read_map(path)
        except SemlocError as error:
            assert "road 1" in str(error)
