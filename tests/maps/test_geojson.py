"""Both kinds of GeoJSON: what is read, that writing and reading again changes nothing, RFC 7946 rules."""

import json
from pathlib import Path

import numpy as np
import pytest
from pyproj import Transformer

from semloc_jax.errors import SemlocError
from semloc_jax.maps import GeoOrigin, MapElement, SemanticMap, read_map, write_drive_geojson, write_geojson
from semloc_jax.structs import ElementClass

ORIGIN = GeoOrigin(48.0712, 11.6523, 512.0)


def _assert_same_elements(one: SemanticMap, other: SemanticMap, tolerance_m: float) -> None:
    assert [e.id for e in one.elements] == [e.id for e in other.elements]
    for a, b in zip(one.elements, other.elements, strict=True):
        assert (a.label, a.closed, a.style, a.shape, a.has_height) == (
            b.label,
            b.closed,
            b.style,
            b.shape,
            b.has_height,
        )
        assert np.abs(a.points - b.points).max() <= tolerance_m
        sizes = [(e.width_m, e.radius_m, e.radius_top_m, e.height_m) for e in (a, b)]
        np.testing.assert_allclose(sizes[0], sizes[1], atol=1e-9)
        assert (a.normal is None) == (b.normal is None)
        assert a.normal is None or np.allclose(a.normal, b.normal)


@pytest.mark.parametrize(
    ("drive", "counts"),
    [
        (
            "road_dir",
            {"LANE_MARKING": 81, "STOP_LINE": 2, "CROSSWALK": 30, "ROAD_MARK": 6, "POLE": 30, "SIGN": 10}
            | {"TRAFFIC_LIGHT": 6, "GUARDRAIL": 2},
        ),
        (
            "garage_dir",
            {"SLOT_LINE": 136, "PARKING_SLOT": 42, "ROAD_MARK": 4, "STOP_LINE": 1, "SPEED_BUMP": 1, "PILLAR": 15}
            | {"CONE": 7, "SIGN": 1},
        ),
    ],
)
def test_drive_maps_are_read_in_full_and_survive_writing(drive, counts, request, tmp_path):
    road = read_map(request.getfixturevalue(drive) / "map.geojson")
    labels = [element.label.name for element in road.elements]
    assert {name: labels.count(name) for name in labels} == counts
    assert road.origin == ORIGIN and not road.skipped
    write_drive_geojson(road, tmp_path / "again.geojson")
    again = read_map(tmp_path / "again.geojson")
    _assert_same_elements(road, again, 0.0)
    assert [dict(e.attributes) for e in again.elements] == [dict(e.attributes) for e in road.elements]
    # And through degrees: within half a millimetre.
    write_geojson(road, tmp_path / "wgs84.geojson")
    _assert_same_elements(road, read_map(tmp_path / "wgs84.geojson"), 2e-4)


def test_fields_of_a_drive_map(road_dir):
    elements = {element.id: element for element in read_map(road_dir / "map.geojson").elements}
    assert elements["edge_aL"].width_m == 0.15 and elements["edge_aL"].style == "solid"
    assert elements["lane_L"].is_logical and elements["lane_L_0"].style == "dashed"
    assert (elements["lamp_0"].radius_m, elements["lamp_0"].radius_top_m) == (0.095, 0.065)
    assert elements["sign_0"].shape == "circle" and elements["sign_0"].closed
    assert np.linalg.norm(elements["sign_0"].normal) == pytest.approx(1.0, abs=1e-12)
    assert not np.array_equal(elements["stop_0"].points[0], elements["stop_0"].points[-1])


def _collection(*features, **members) -> dict:
    return {"type": "FeatureCollection", "features": list(features), **members}


def _feature(geometry_type, coordinates, **properties) -> dict:
    return {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": geometry_type, "coordinates": coordinates},
    }


def _write(path: Path, document) -> Path:
    path.write_text(json.dumps(document))
    return path


def test_rfc_7946_is_longitude_latitude_height_about_the_chosen_origin(tmp_path):
    line = [[11.6523, 48.0712, 512.0], [11.6533, 48.0722, 515.0]]
    document = _collection(_feature("LineString", line, **{"class": "lane_solid", "width": 0.15}))
    element = read_map(_write(tmp_path / "m.geojson", document), origin=ORIGIN).elements[0]
    enu = Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84 "
        "+step +proj=topocentric +ellps=WGS84 +lon_0=11.6523 +lat_0=48.0712 +h_0=512"
    )
    expected = np.array([enu.transform(*point) for point in line])
    np.testing.assert_allclose(element.points, expected, atol=1e-6)


def test_origin_is_the_named_one_else_the_middle(tmp_path):
    line = [[11.0, 48.0, 500.0], [11.002, 48.002, 500.0]]
    features = [_feature("LineString", line, **{"class": "lane_solid", "width": 0.1})]
    features.append(_feature("LineString", line[::-1], **{"class": "lane_solid", "width": 0.1}))
    assert read_map(_write(tmp_path / "a.geojson", _collection(*features))).origin == GeoOrigin(48.001, 11.001, 500.0)
    named = _collection(*features, origin={"lat_deg": 48.0, "lon_deg": 11.0, "alt_m": 490.0})
    found = read_map(_write(tmp_path / "b.geojson", named))
    assert found.origin == GeoOrigin(48.0, 11.0, 490.0)
    np.testing.assert_allclose(found.elements[0].points[0], [0, 0, 10], atol=1e-6)


def test_coordinates_without_height_are_flat_and_stay_two_dimensional(tmp_path):
    document = _collection(_feature("LineString", [[11.0, 48.0], [11.01, 48.0]], **{"class": "lane_solid"}))
    road = read_map(_write(tmp_path / "m.geojson", document))
    assert not road.elements[0].has_height and np.all(road.elements[0].points[:, 2] == 0.0)
    write_geojson(road, tmp_path / "n.geojson")
    written = json.loads((tmp_path / "n.geojson").read_text())["features"][0]["geometry"]["coordinates"]
    np.testing.assert_allclose(written, [[11.0, 48.0], [11.01, 48.0]], atol=2e-9)


def test_written_file_follows_rfc_7946(road_dir, tmp_path):
    write_geojson(read_map(road_dir / "map.geojson"), tmp_path / "m.geojson")
    document = json.loads((tmp_path / "m.geojson").read_text())
    assert document["type"] == "FeatureCollection" and "crs" not in document and "frame" not in document
    for feature in document["features"]:
        assert feature["type"] == "Feature" and isinstance(feature["properties"], dict)
        if feature["geometry"]["type"] == "Polygon":
            for ring in feature["geometry"]["coordinates"]:
                assert ring[0] == ring[-1] and len(ring) >= 4


def test_unknown_classes_are_counted_not_lost_in_silence(tmp_path):
    line = [[0, 0, 0], [1, 0, 0]]
    known = _feature("LineString", line, **{"class": "lane_solid", "width": 0.1})
    document = _collection(known, _feature("LineString", line, **{"class": "tram_rail"}), frame={})
    assert read_map(_write(tmp_path / "m.geojson", document)).skipped == {"tram_rail": 1}


def test_an_element_made_in_memory_can_be_written(tmp_path):
    pole = MapElement("p", ElementClass.POLE, np.array([[0, 0, 0], [0, 0, 4.0]]), radius_m=0.1, radius_top_m=0.05)
    sign = MapElement(
        "s", ElementClass.SIGN, np.eye(3), closed=True, shape="triangle", normal=np.array([0.6, 0.0, 0.8])
    )
    lane = MapElement("v", ElementClass.LANE_MARKING, np.array([[0, 0, 0], [9, 0, 0.0]]), style="virtual")
    bar = MapElement("d", ElementClass.LANE_MARKING, lane.points, width_m=0.12, style="dashed")
    road = SemanticMap((pole, sign, lane, bar), ORIGIN)
    write_drive_geojson(road, tmp_path / "m.geojson")
    _assert_same_elements(road, read_map(tmp_path / "m.geojson"), 1e-4)


def test_writing_degrees_needs_an_origin_and_a_folder(tmp_path):
    lane = MapElement("d", ElementClass.LANE_MARKING, np.array([[0, 0, 0], [9, 0, 0.0]]), width_m=0.1)
    with pytest.raises(SemlocError, match="has no origin on the earth"):
        write_geojson(SemanticMap((lane,)), tmp_path / "m.geojson")
    with pytest.raises(SemlocError, match="cannot write map"):
        write_drive_geojson(SemanticMap((lane,)), tmp_path / "missing" / "m.geojson")
