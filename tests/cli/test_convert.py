"""`semloc convert`: every format into every other, and what is lost on the way."""

import itertools
import json

import numpy as np
import pytest

from semloc_jax.cli.main import FAILED, LOST, OK, main
from semloc_jax.maps import GeoOrigin, MapElement, SemanticMap, compare, read_map, write_drive_geojson
from semloc_jax.structs import ElementClass
from tests.maps.io.test_opendrive import PLAIN, ROAD


@pytest.fixture
def small_map(tmp_path):
    line = np.array([[0.0, 0.0, 0.0], [25.0, 0.4, 0.1], [50.0, 0.0, 0.0]])
    plate = np.array([[9.0, 0.3, 2.0], [9.0, -0.3, 2.0], [9.0, 0.0, 2.5]])
    elements = (
        MapElement("line", ElementClass.LANE_MARKING, line, width_m=0.15, style="solid", attributes={"color": "white"}),
        MapElement("pole", ElementClass.POLE, line[:1] + [[0, 4, 0], [0, 4, 5]], radius_m=0.1, radius_top_m=0.1),
        MapElement("sign", ElementClass.SIGN, plate, closed=True, shape="triangle", normal=np.array([-1.0, 0.0, 0.0])),
    )
    road = SemanticMap(elements, GeoOrigin(48.0, 11.0, 500.0), "small")
    path = tmp_path / "small.geojson"
    write_drive_geojson(road, path)
    return path


@pytest.mark.parametrize("pair", [*itertools.product(["geojson", "gpkg", "osm"], repeat=2)], ids=" to ".join)
def test_from_every_format_to_every_other_within_a_tenth_of_a_millimetre(small_map, tmp_path, capsys, pair):
    first, second = tmp_path / f"first.{pair[0]}", tmp_path / f"second.{pair[1]}"
    assert main(["convert", str(small_map), str(first)]) == OK
    assert main(["convert", str(first), str(second)]) == OK
    losses = compare(read_map(small_map), read_map(second))
    assert not losses.lost and not losses.added and losses.shift_m < 2e-4
    assert losses.changed == {} and losses.notes == ()
    assert "3 elements" in capsys.readouterr().out


def test_an_exact_way_is_called_exact_and_a_lossy_one_is_not(small_map, tmp_path, capsys):
    assert main(["convert", str(small_map), str(tmp_path / "m.gpkg"), "--strict"]) == OK
    assert "comes back exactly" in capsys.readouterr().out
    assert main(["convert", str(small_map), str(tmp_path / "m.smap"), "--strict"]) == LOST
    said = capsys.readouterr().out
    assert "ids are not kept" in said and "changed: attributes of 3" in said and "points are exact" in said


def test_an_element_that_cannot_be_meant_is_named_and_is_a_loss(small_map, tmp_path, capsys):
    content = json.loads(small_map.read_text())
    line = next(item for item in content["features"] if item["geometry"]["type"] == "LineString")
    far = json.loads(json.dumps(line))
    far["id"], far["properties"]["id"], far["geometry"]["coordinates"][1][0] = "far", "far", 4.0e6
    content["features"].append(far)
    (tmp_path / "far.geojson").write_text(json.dumps(content))
    assert main(["convert", str(tmp_path / "far.geojson"), str(tmp_path / "m.gpkg")]) == OK
    assert "left out: far (" in capsys.readouterr().out
    assert main(["convert", str(tmp_path / "far.geojson"), str(tmp_path / "m.gpkg"), "--strict"]) == LOST


def test_what_the_rounding_of_degrees_moves_is_no_loss(small_map, tmp_path, capsys):
    """Lanelet2 holds latitude and longitude: points come back within micrometres."""
    assert main(["convert", str(small_map), str(tmp_path / "m.osm"), "--strict"]) == OK
    assert "points move by at most" in capsys.readouterr().out


def test_classes_and_the_layout_of_geojson_can_be_chosen(small_map, tmp_path, capsys):
    out = tmp_path / "m.geojson"
    assert main(["convert", str(small_map), str(out), "--only", "pole,sign", "--geojson", "drive"]) == OK
    assert {e.id for e in read_map(out).elements} == {"pole", "sign"}
    assert '"frame"' in out.read_text()
    assert main(["convert", str(small_map), str(out)]) == OK
    assert '"frame"' not in out.read_text() and '"origin"' in out.read_text()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["m.shp"], "cannot write '.shp'; expected .geojson"),
        (["m.gpkg", "--only", "tram"], "no class 'tram'"),
        (["m.gpkg", "--only", "cone"], "the map has none of these; it has lane_marking, pole, sign"),
        (["m.gpkg", "--origin", "500,2"], "expected latitude,longitude"),
        (["m.gpkg", "--origin", "here"], "expected latitude,longitude"),
        (["nowhere/m.gpkg"], "cannot write map"),
        (["nowhere/m.osm"], "cannot write map"),
        (["nowhere/m.smap"], "cannot write map"),
    ],
)
def test_what_cannot_be_done_is_refused_in_one_line(small_map, tmp_path, capsys, words, message):
    assert main(["convert", str(small_map), str(tmp_path / words[0]), *words[1:]]) == FAILED
    said = capsys.readouterr().err
    assert message in said and len(said.splitlines()) == 1


def test_the_map_itself_is_never_overwritten(small_map, capsys):
    before = small_map.read_bytes()
    assert main(["convert", str(small_map), str(small_map)]) == FAILED
    assert small_map.read_bytes() == before


def test_what_is_no_paint_is_named_and_regulatory_elements_come_back(tmp_path, capsys):
    """Lanelets and areas are lost and named; regulatory elements stay with their ways, to the letter."""
    nodes = "".join(f"<node id='{i}' lat='48.000{i}' lon='11'><tag k='ele' v='5'/></node>" for i in (1, 2, 3, 4))

    def relation(number, members, **tags):
        words = "".join(f"<tag k='{key}' v='{value}'/>" for key, value in tags.items())
        refs = "".join(f"<member type='{kind}' ref='{ref}' role='{role}'/>" for kind, ref, role in members)
        return f"<relation id='{number}'>{refs}{words}</relation>"

    ways = "<way id='9'><nd ref='1'/><nd ref='2'/><tag k='type' v='stop_line'/></way>"
    ways += "<way id='8'><nd ref='3'/><nd ref='4'/><tag k='type' v='traffic_light'/><tag k='height' v='1'/></way>"
    rules = relation(5, [("way", 9, "left"), ("way", 8, "right")], type="lanelet")
    rules += relation(6, [("way", 9, "outer")], type="multipolygon")
    rules += relation(70, [("way", 9, "ref_line"), ("way", 8, "refers")], type="regulatory_element",
                      subtype="traffic_light")  # fmt: skip
    rules += relation(71, [("relation", 5, "yield"), ("way", 9, "ref_line")], type="regulatory_element",
                      subtype="right_of_way", fallback="yes")  # fmt: skip
    rules += relation(72, [("relation", 5, "refers")], type="regulatory_element", subtype="speed_limit")
    (tmp_path / "m.osm").write_text(f"<osm>{nodes}{ways}{rules}</osm>")
    assert main(["convert", str(tmp_path / "m.osm"), str(tmp_path / "again.osm"), "--strict"]) == LOST
    said = capsys.readouterr().out
    for words in ("1 lanelet relations", "1 multipolygon relations", "1 regulatory elements that name no way",
                  "1 references of regulatory elements to lanelets", "1 tags of regulatory elements"):  # fmt: skip
        assert f"left out when the map was read: {words}" in said
    before, after = read_map(tmp_path / "m.osm"), read_map(tmp_path / "again.osm")
    rules = {element.id: element.attributes["regulatory"] for element in before.elements}
    assert rules["9"] == ["traffic_light:70:ref_line", "right_of_way:71:ref_line"]
    assert {element.id: element.attributes["regulatory"] for element in after.elements} == rules
    assert compare(before, after).shift_m < 2e-4
    assert main(["convert", str(tmp_path / "again.osm"), str(tmp_path / "m.gpkg")]) == OK
    assert {e.id: e.attributes["regulatory"] for e in read_map(tmp_path / "m.gpkg").elements} == rules


def test_links_and_references_of_opendrive_are_named(tmp_path, capsys):
    link = "<link><predecessor elementType='junction' elementId='4'/></link>"
    more = "<signals><signalReference id='3' s='1' t='0' orientation='+'><validity fromLane='1' toLane='1'/>"
    text = ROAD.format(**PLAIN).replace("<planView>", link + "<planView>")
    text = text.replace("</road>", f"{more}</signalReference></signals></road><junction id='4'/>")
    (tmp_path / "m.xodr").write_text(text)
    assert main(["convert", str(tmp_path / "m.xodr"), str(tmp_path / "m.gpkg"), "--strict"]) == LOST
    said = capsys.readouterr().out
    assert "comes back exactly" in said
    for words in ("1 links of roads", "1 junctions", "1 references to signals", "1 lanes that a signal"):
        assert f"left out when the map was read: {words}" in said


def test_a_map_of_nowhere_is_put_on_the_earth(small_map, tmp_path, capsys):
    nowhere, placed = tmp_path / "nowhere.geojson", tmp_path / "placed.gpkg"
    road = read_map(small_map)
    write_drive_geojson(SemanticMap(road.elements, None, "nowhere"), nowhere)
    assert main(["convert", str(nowhere), str(placed), "--origin", "57.7,12,3"]) == OK
    assert "place on the earth: unknown until now, set to 57.7, 12, 3" in capsys.readouterr().out
    found = read_map(placed)
    assert found.origin == GeoOrigin(57.7, 12.0, 3.0)
    assert all(np.array_equal(a.points, b.points) for a, b in zip(found.elements, road.elements, strict=True))
