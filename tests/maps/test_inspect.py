"""The map report: contents of the rendered maps, and every defect that is put into a map."""

import numpy as np
import pytest

from semloc_jax.maps import GeoOrigin, MapElement, SemanticMap, inspect_map, read_map
from semloc_jax.structs import ElementClass


def _lane(points, name="lane", **values) -> MapElement:
    values = {"width_m": 0.15} | values
    return MapElement(name, ElementClass.LANE_MARKING, np.array(points, dtype=float), **values)


GOOD = _lane([[0, 0, 0], [50, 0, 0]], "good", style="solid")


def test_report_of_a_rendered_map(road_dir):
    report = inspect_map(read_map(road_dir / "map.geojson"))
    assert report.defects == () and report.has_origin
    counts = {row.name: row.count for row in report.classes}
    assert counts["lane_dashed"] == 67 and counts["lane_boundary"] == 2 and sum(counts.values()) == 167
    dashes = next(row for row in report.classes if row.name == "lane_dashed")
    assert dashes.length_m == pytest.approx(67 * 4.0, rel=0.01)
    # The mapped road is about 415 m long (its lane boundaries).
    assert report.road_length_m == pytest.approx(415, rel=0.12)
    text = report.to_text()
    assert "lane_dashed" in text and "defects: none" in text and max(map(len, text.splitlines())) < 100


@pytest.mark.parametrize(
    ("kind", "bad"),
    [
        ("zero length", _lane([[5, 5, 0], [5, 5, 0]])),
        ("crosses itself", _lane([[0, 5, 0], [10, 5, 0], [10, 9, 0], [5, 1, 0]])),
        ("duplicate", _lane([[50, 0.01, 0], [0, 0.01, 0]])),
        ("repeated id", _lane([[0, 9, 0], [50, 9, 0]], "good")),
        ("missing heights", _lane([[0, 9, 0], [50, 9, 0]], has_height=False)),
        ("missing size", _lane([[0, 9, 0], [50, 9, 0]], width_m=0.0)),
        ("missing size", MapElement("p", ElementClass.POLE, np.array([[0, 9, 0], [0, 9, 5.0]]))),
        ("missing size", MapElement("b", ElementClass.PILLAR, np.eye(3), closed=True)),
        ("jump", _lane([[0, 9, 0], [50, 9, 0], [1e6, 9, 0]])),
        ("gap", _lane([[50.3, 0, 0], [90, 0, 0]], style="solid")),
        ("under ground", MapElement("u", ElementClass.POLE, np.array([[9, 4, -9], [9, 4, -3.0]]), radius_m=0.1)),
    ],
)
def test_each_defect_is_found_once(kind, bad):
    assert [defect.kind for defect in inspect_map(SemanticMap((GOOD, bad))).defects] == [kind]


@pytest.mark.parametrize(
    "other",
    [
        _lane([[50.02, 0, 0], [90, 0, 0]], style="solid"),  # meets it
        _lane([[52, 0, 0], [90, 0, 0]], style="solid"),  # is another line
        _lane([[50.3, 0, 0], [50.3, 40, 0]], style="solid"),  # turns away
        _lane([[50.3, 0, 0], [90, 0, 0]], style="dashed"),  # has gaps by design
        _lane([[50.3, 0, 0], [90, 0, 0]], style="solid", width_m=0.3),
        MapElement("u", ElementClass.POLE, np.array([[9, 4, -1], [9, 4, 5.0]]), radius_m=0.1),
        MapElement("u", ElementClass.POLE, np.array([[9, 40, -9], [9, 40, -3.0]]), radius_m=0.1),  # below no road
    ],
)
def test_what_only_looks_like_a_gap_or_under_ground(other):
    assert inspect_map(SemanticMap((GOOD, other))).defects == ()


def test_the_coordinate_system_and_what_is_assumed_are_told():
    line = _lane([[0, 0, 0], [9, 0, 0]], attributes={"assumed": ["width", "dashes"]})
    text = inspect_map(SemanticMap((line,), frame="MGRS 54SUE")).to_text()
    assert "coordinates: MGRS 54SUE, place on the earth unknown" in text
    assert "assumed: width of 1 elements" in text and "kB/km compact at 1 cm" in text
    placed = inspect_map(SemanticMap((line,), GeoOrigin(48.0, 11.0, 500.0))).to_text()
    assert "coordinates: east, north, up in metres about 48.000000, 11.000000, 500.0 m (WGS84)" in placed


def test_area_that_crosses_itself():
    bow = MapElement("x", ElementClass.ROAD_MARK, np.array([[0, 0, 0], [2, 2, 0], [2, 0, 0], [0, 2, 0.0]]), closed=True)
    assert [defect.kind for defect in inspect_map(SemanticMap((bow,))).defects] == ["crosses itself"]


def test_unknown_classes_and_flat_maps_are_told():
    road = SemanticMap((_lane([[0, 0, 0], [9, 0, 0]], has_height=False),), skipped={"tram": 3})
    defects = {defect.kind: defect.detail for defect in inspect_map(road).defects}
    assert defects == {"unknown class": "3 left out", "missing heights": "the map is taken as flat"}


def test_long_lists_are_cut_in_the_text():
    lanes = tuple(_lane([[0, y, 0], [9, y, 0]], f"l{y}", width_m=0.0) for y in range(30))
    text = inspect_map(SemanticMap(lanes)).to_text(max_defects=5)
    assert "defects: 30" in text and "... and 25 more" in text and text.count("missing size: ") == 5
    crossing = _lane([[0, 5, 0], [10, 5, 0], [10, 9, 0], [5, 1, 0]])
    text = inspect_map(SemanticMap((*lanes, crossing))).to_text(max_defects=5)
    assert text.count("missing size: ") == 4 and text.count("crosses itself: ") == 1, "no kind hides another"


def test_empty_map_has_a_report():
    assert inspect_map(SemanticMap(())).classes == ()
