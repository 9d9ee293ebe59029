"""An element that cannot be meant is named and left out; the rest of the map is as good as without it."""

import json
import logging
from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.maps import SemanticMap, inspect_map, read_map, sample
from semloc_jax.maps.elements import MapElement
from semloc_jax.maps.io import write_map
from semloc_jax.maps.io.paint import strokes
from semloc_jax.maps.soundness import fault_of
from semloc_jax.structs import ElementClass

AWAY_M = 4.0e6


def _line(key="line", step_m=5.0, label=ElementClass.LANE_MARKING) -> MapElement:
    points = np.array([[step_m * k, 0.0, 0.0] for k in range(10)])
    return MapElement(key, label, points, width_m=0.12, style="solid")


def _crosswalk(corner_m: float, key="crossing") -> MapElement:
    points = np.array([[10.0, 3.0, 0.0], [14.0, 3.0, 0.0], [14.0, 8.0, 0.0], [10.0, corner_m, 0.0]])
    return MapElement(key, ElementClass.CROSSWALK, points, closed=True)


@pytest.mark.parametrize("suffix", [".geojson", ".gpkg", ".osm", ".smap"])
def test_a_corner_far_away_costs_its_element_only(tmp_path, suffix, caplog):
    path = tmp_path / f"map{suffix}"
    write_map(SemanticMap((_line(), _crosswalk(8.0, "good"), _crosswalk(AWAY_M))), path)
    with caplog.at_level(logging.WARNING):
        found = read_map(path)
        samples = sample(found.query([0.0, 0.0], 60.0), 0.25)
    assert len(found.elements) == 2
    assert "left out: CROSSWALK of 4 points is 4000 km across" in caplog.text
    assert [fault for fault in found.faulty.values()] == ["CROSSWALK of 4 points is 4000 km across"]
    assert len(samples.valid) <= 1024
    assert any(d.kind == "left out" and "4000 km" in d.detail for d in inspect_map(found).defects)


@pytest.mark.parametrize("suffix", [".geojson", ".gpkg", ".osm"])
@pytest.mark.parametrize(
    "told",
    [{"height_sigma_m": "abc"}, {"height_sigma_m": None}, {"height_sigma_m": 1e300}, {"height_sigma_m": -1}]
    + [{"assumed": 5}, {"assumed": [["width"]]}],
)
def test_words_that_are_computed_with_are_looked_at_when_they_enter(tmp_path, suffix, told):
    """They stood for the height of a sample, or were counted by `inspect`, whatever a file held there."""
    path = tmp_path / f"map{suffix}"
    odd, class_list = (replace(_line(key), attributes=words) for key, words in (("odd", told), ("list", {"class": []})))
    write_map(SemanticMap((_line(), class_list, odd)), path)
    found = read_map(path)
    samples = sample(found.query([0.0, 0.0], 60.0), 0.25)
    assert samples.height_sigma.max() == 0.0 and len(found.elements) == 2
    assert ["; expected" in fault for fault in found.faulty.values()] == [True]
    assert inspect_map(found).assumed == {}


def test_what_is_large_and_true_stays():
    assert fault_of(_line(step_m=2000.0)) is None
    assert fault_of(_crosswalk(8.0)) is None
    assert "jumps 4000 km" in fault_of(_line(step_m=AWAY_M))
    way = np.array([[19_000.0 * (k % 2), 0.0, 0.0] for k in range(40)])
    assert "of 40 points is 741 km long" in fault_of(MapElement("zigzag", ElementClass.CURB, way))


def test_a_line_that_cannot_be_meant_is_not_cut_into_dashes():
    """Half a million bars would be made before the map is looked at."""
    found = strokes(_line(step_m=AWAY_M), ["dashed", "dashed"], 0.12, 0.1, 3.0, 6.0)
    assert [fault_of(element) is None for element in found] == [False, False]


@pytest.mark.parametrize(
    ("coordinates", "words"),
    [
        ([], "0 points; expected at least 2"),
        ([[0.0, 0.0, 0.0]], "1 points; expected at least 2"),
        ([[0.0, 0.0, 0.0], [float("nan"), 0.0, 0.0]], "NaN, infinite or huge coordinates"),
        ([[0.0, 0.0, 0.0], ["x", 0.0, 0.0]], "coordinates cannot be read"),
        (None, "coordinates cannot be read"),
    ],
)
def test_a_feature_that_cannot_be_read_is_named_and_left_out(tmp_path, coordinates, words):
    path = tmp_path / "map.geojson"
    write_map(SemanticMap((_line("a"), _line("b"))), path)
    document = json.loads(path.read_text())
    document["features"][1]["geometry"]["coordinates"] = coordinates
    path.write_text(json.dumps(document))
    found = read_map(path)
    assert [element.id for element in found.elements] == ["a"]
    assert set(found.faulty) == {"b"} and words in found.faulty["b"] and "feature b" in found.faulty["b"]


def test_sampling_counts_before_it_takes_memory():
    around = SemanticMap((_line(), _crosswalk(AWAY_M))).query([0.0, 0.0], 60.0)
    with pytest.raises(SemlocError, match=r"map element 'crossing': .* 8000 km long"):
        sample(around, 0.25)


@pytest.mark.parametrize("label", [ElementClass.LANE_MARKING, ElementClass.CROSSWALK, ElementClass.POLE])
def test_elements_of_one_vertex_do_no_harm(label):
    dot = MapElement("dot", label, np.array([[5.0, 2.0, 0.0]]), closed=label == ElementClass.CROSSWALK, width_m=0.1)
    both, alone = SemanticMap((_line(), dot)), SemanticMap((_line(),))
    at, radius_m = [0.0, 0.0], 60.0
    assert sample(both.query(at, radius_m), 0.25).valid.sum() == sample(alone.query(at, radius_m), 0.25).valid.sum()
    assert np.isfinite(both.road_pose(3.0, 1.0, 0.0)).all()
