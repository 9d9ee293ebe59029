"""Query by radius against brute force; the frame of a local map."""

import numpy as np
import pytest
import shapely

from semloc_jax.errors import SemlocError
from semloc_jax.maps import MapElement, SemanticMap, read_map
from semloc_jax.structs import ElementClass
from tests.counting import num_calls


def _random_map(count: int, seed: int = 0, reach_m: float = 500.0) -> SemanticMap:
    rng = np.random.default_rng(seed)
    elements = []
    for index in range(count):
        start = np.append(rng.uniform(-reach_m, reach_m, 2), 0.0)
        if index % 3 == 0:
            points = start + np.cumsum(np.append(rng.normal(0, 8, (6, 2)), np.zeros((6, 1)), axis=1), axis=0)
            elements.append(MapElement(f"line{index}", ElementClass.LANE_MARKING, points, width_m=0.15))
        elif index % 3 == 1:
            points = np.stack([start, start + [0, 0, 5]])
            elements.append(MapElement(f"pole{index}", ElementClass.POLE, points, radius_m=0.1))
        else:
            points = start + np.array([[0, 0, 0], [40, 0, 0], [40, 30, 0], [0, 30, 0]])
            elements.append(MapElement(f"area{index}", ElementClass.CROSSWALK, points, closed=True))
    return SemanticMap(tuple(elements))


def _shape(element):
    return shapely.Polygon(element.points[:, :2]) if element.closed else shapely.LineString(element.points[:, :2])


@pytest.mark.parametrize("seed", range(4))
def test_query_finds_what_brute_force_finds(seed):
    road = _random_map(300, seed)
    center = np.random.default_rng(seed + 10).uniform(-300, 300, 2)
    found = {element.id for element in road.query(center, 60.0).elements}
    expected = {e.id for e in road.elements if _shape(e).distance(shapely.Point(center)) < 60.0}
    assert found == expected
    assert expected


def test_query_from_inside_a_large_area_finds_it():
    square = np.array([[-100.0, -100, 0], [100, -100, 0], [100, 100, 0], [-100, 100, 0]])
    road = SemanticMap((MapElement("hall", ElementClass.PARKING_SLOT, square, closed=True),))
    assert len(road.query((0.0, 0.0), 5.0).elements) == 1


def test_lines_are_cut_and_areas_stay_whole():
    line = MapElement("l", ElementClass.LANE_MARKING, np.array([[-90.0, 0, 0], [90, 0, 9]]), width_m=0.1)
    area = MapElement("a", ElementClass.CROSSWALK, np.array([[25.0, 0, 0], [45, 0, 0], [45, 5, 0]]), closed=True)
    local = SemanticMap((line, area)).query((0.0, 0.0), 30.0)
    cut, whole = local.elements
    np.testing.assert_allclose(cut.points[[0, -1]], [[-30, 0, 3], [30, 0, 6]], atol=1e-9)
    assert cut.true_ends == (False, False) and cut.id == "l"
    np.testing.assert_array_equal(whole.points, area.points)


def test_heading_leaves_out_what_is_far_behind():
    poles = [
        MapElement(f"p{x}", ElementClass.POLE, np.array([[x, 0.0, 0], [x, 0, 5]]), radius_m=0.1) for x in (-30, -10, 30)
    ]
    road = SemanticMap(tuple(poles))
    assert [e.id for e in road.query((0.0, 0.0), 40.0, heading_rad=0.0).elements] == ["p-10", "p30"]
    assert [e.id for e in road.query((0.0, 0.0), 40.0, heading_rad=np.pi).elements] == ["p-30", "p-10"]


def test_local_origin_is_near_the_place_in_whole_metres(road_dir):
    road = read_map(road_dir / "map.geojson")
    local = road.query((160.0, -47.0), 40.0)
    np.testing.assert_array_equal(local.origin_map, np.round(local.origin_map))
    assert np.linalg.norm(local.origin_map - [160, -47, -1.2]) < 1.5
    assert local.ground is road.ground


def test_bad_queries_and_maps():
    road = _random_map(6)
    for center, radius in [((np.nan, 0.0), 10.0), ((0.0, 0.0), 0.0), ((0.0,), 5.0), ((0.0, 0.0), float("nan"))]:
        with pytest.raises(SemlocError, match="map query"):
            road.query(center, radius)
    with pytest.raises(SemlocError, match="no elements"):
        SemanticMap(()).query((0.0, 0.0), 10.0)
    bad = MapElement("bad", ElementClass.POLE, np.array([[0, 0, np.nan], [0, 0, 1]]))
    with pytest.raises(SemlocError, match="'bad' has NaN"):
        SemanticMap((bad,))
    with pytest.raises(SemlocError, match="expected \\[k 3\\]"):
        MapElement("flat", ElementClass.POLE, np.zeros((2, 2)))


def test_nothing_near_is_an_empty_local_map_and_not_an_error():
    assert _random_map(30).query((1e5, 1e5), 50.0).elements == ()


def test_the_work_of_a_query_does_not_grow_with_the_map():
    """Twenty times the map of the same density: as many calls for a query, for each element that it finds."""
    calls = []
    for road in (_random_map(150), _random_map(3_000, reach_m=500.0 * np.sqrt(20.0))):
        places = [(x, y, 0.0) for x in np.linspace(-300, 300, 12) for y in np.linspace(-300, 300, 12)]
        num_found = sum(len(road.query(place, 60.0).elements) for place in places)
        calls.append(num_calls(lambda road=road, places=places: [road.query(p, 60.0) for p in places]) / num_found)
    assert calls[1] < 1.5 * calls[0]


def test_a_class_by_its_name_is_the_class_and_another_word_is_refused():
    pole = [[0.0, 0, 0], [0, 0, 5]]
    assert MapElement("a", "pole", pole).label is ElementClass.POLE
    assert SemanticMap((MapElement("a", "pole", pole, radius_m=0.1),)).labels == {ElementClass.POLE}
    with pytest.raises(SemlocError, match="unknown class 'poles'; did you mean 'pole'"):
        MapElement("a", "poles", pole)


def test_two_elements_of_one_id_are_told(caplog):
    pole = MapElement("a", ElementClass.POLE, [[0.0, 0, 0], [0, 0, 5]])
    SemanticMap((pole, pole))
    assert "two elements have the id 'a'" in caplog.text
