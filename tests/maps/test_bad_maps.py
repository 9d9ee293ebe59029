"""Bad map files end in one line that says what was given, what was expected and what to do."""

import json

import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.maps import read_map

LINE = [[0, 0, 0], [5, 0, 0]]


def _lane(coordinates=None, geometry="LineString", **properties):
    properties = {"class": "lane_solid", "width": 0.1} | properties
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": geometry, "coordinates": coordinates or LINE},
    }


def _drive(*features, frame=None) -> str:
    return json.dumps({"type": "FeatureCollection", "frame": frame or {}, "features": list(features)})


def _way(nodes="<nd ref='1'/><nd ref='2'/>", tags="<tag k='type' v='line_thin'/>") -> str:
    return f"<way id='9'>{nodes}{tags}</way>"


NODES = "<node id='1' lat='48' lon='11'/><node id='2' lat='48.001' lon='11'/>"
LOST = _way(nodes="<nd ref='7'/>")
LOGICAL = _way(tags="<tag k='type' v='virtual'/>")
BOMB = '<?xml version="1.0"?><!DOCTYPE osm [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]><osm>&b;</osm>'

CASES = {
    "truncated.geojson": (_drive(_lane())[:-20], "not valid JSON"),
    "binary.geojson": ("\udcff\udcfe", "not valid JSON"),
    "list.geojson": ("[1, 2]", "expected a GeoJSON FeatureCollection"),
    "feature.geojson": (json.dumps(_lane()), "holds Feature; expected a GeoJSON FeatureCollection"),
    "nan.geojson": (_drive(_lane([[0, 0, float("nan")], [1, 0, 0]])), "NaN, infinite or huge coordinates"),
    "text.geojson": (_drive(_lane([["a", 0, 0], [1, 0, 0]])), "coordinates cannot be read"),
    "null.geojson": (_drive({"type": "Feature", "properties": {"class": "pole"}, "geometry": None}), "geometry None"),
    "point.geojson": (_drive(_lane([[0, 0, 0]])), "1 points; expected at least 2"),
    "wrong.geojson": (_drive(_lane([LINE], "MultiLineString")), "geometry MultiLineString; expected LineString"),
    "pole.geojson": (_drive(_lane([*LINE, [9, 0, 0]], **{"class": "pole"})), "3 points; expected two"),
    "width.geojson": (_drive(_lane(width=-0.1)), "width = '-0.1'; expected metres"),
    "radius.geojson": (_drive(_lane(radius="thick", **{"class": "pole"})), "radius = 'thick'; expected metres"),
    "huge.geojson": (_drive(_lane([[1e300, 0, 0], [1, 0, 0]])), "NaN, infinite or huge coordinates"),
    "odd.geojson": (_drive(_lane(geometry={})), "geometry {}; expected"),
    "normal.geojson": (_drive(_lane(normal=[0, 0, 0])), "expected three finite numbers"),
    "ends.geojson": (_drive(_lane(true_ends="no")), "expected two of true and false"),
    "naked.geojson": (_drive({"type": "Feature"}), "feature 0 has no properties"),
    "empty.geojson": (_drive(), "no element that a camera could see"),
    "logical.geojson": (_drive(_lane(**{"class": "lane_boundary"})), "no element that a camera could see"),
    "foreign.geojson": (_drive(_lane(**{"class": "tram"})), "left out: 1 tram"),
    "origin.geojson": (_drive(_lane(), frame={"origin_lat_deg": 480}), "expected origin_lat_deg"),
    "metres.geojson": (
        json.dumps({"type": "FeatureCollection", "features": [_lane([[412345.0, 5412345.0], [412346.0, 5412345.0]])]}),
        "expected longitude and latitude in degrees",
    ),
    "anchor.geojson": (
        json.dumps({"type": "FeatureCollection", "features": [_lane()], "origin": [48, 11]}),
        "expected numbers lat_deg",
    ),
    "bomb.osm": (BOMB, "declares a document type"),
    "truncated.osm": (f"<osm>{NODES}<way id='9'>", "not well-formed XML"),
    "empty.osm": ("", "not well-formed XML"),
    "bare.osm": ("<osm/>", "no element that a camera could see"),
    "kml.osm": ("<kml></kml>", "root element <kml>; expected <osm>"),
    "missing.osm": (f"<osm>{NODES}{LOST}</osm>", "way 9 refers to node 7"),
    "nowhere.osm": (f"<osm><node id='1'/><node id='2' lat='1' lon='2'/>{_way()}</osm>", "node 1 has neither lat, lon"),
    "nan.osm": (f"<osm>{NODES.replace('48.001', 'nan')}{_way()}</osm>", "node 2 has lat = 'nan'"),
    "swapped.osm": (f"<osm>{NODES.replace('48', '148')}{_way()}</osm>", "are they swapped"),
    "unnamed.osm": (f"<osm>{NODES.replace(' id=', ' nr=')}{_way()}</osm>", "a <node> without id"),
    "virtual.osm": (f"<osm>{NODES}{LOGICAL}</osm>", "no element that a camera"),
    "map.bin": ("", "unknown type '.bin'"),
}


@pytest.mark.parametrize("name", CASES)
def test_bad_map_gives_one_line(name, tmp_path):
    content, message = CASES[name]
    path = tmp_path / name
    path.write_bytes(content.encode("utf-8", "surrogateescape"))
    with pytest.raises(SemlocError) as caught:
        read_map(path)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300


def test_missing_file_and_folder(tmp_path):
    for path, why in ((tmp_path / "no.geojson", "no such file"), (tmp_path, "a folder without a map")):
        with pytest.raises(SemlocError, match=why):
            read_map(path)


def test_deeply_nested_json_is_refused(tmp_path):
    (tmp_path / "deep.geojson").write_text('{"type": "FeatureCollection", "features": [' + "[" * 200_000)
    with pytest.raises(SemlocError, match="not valid JSON"):
        read_map(tmp_path / "deep.geojson")
