"""What comes near a place is what shapely's tree finds, and a large map looks at its road only where it is asked."""

import numpy as np
import shapely

from semloc_jax.maps import SemanticMap
from semloc_jax.maps.around_place import PlanIndex, TiledGround, plan_geometry
from semloc_jax.maps.elements import MapElement
from semloc_jax.maps.ground import GroundModel
from semloc_jax.structs import ElementClass

SLOPE = np.array([0.02, -0.01])


def street(num: int, seed: int = 0) -> list[MapElement]:
    """Lines, posts and areas within 400 m, on a plane that rises."""
    rng, found = np.random.default_rng(seed), []
    for k in range(num):
        xy = rng.uniform(0.0, 400.0, 2) + np.cumsum(rng.uniform(0.0, 4.0, (2 + k % 5, 2)), axis=0)
        points = np.column_stack([xy, xy @ SLOPE])
        label = (ElementClass.LANE_MARKING, ElementClass.CROSSWALK, ElementClass.POLE)[k % 3]
        found.append(MapElement(f"{k}", label, points, closed=k % 3 == 1 and len(points) > 2, width_m=0.1))
    return found


def test_near_is_what_a_tree_of_shapes_finds():
    elements = street(300)
    index, tree = PlanIndex(elements), shapely.STRtree([plan_geometry(element) for element in elements])
    rng = np.random.default_rng(1)
    for _ in range(40):
        center, radius_m = rng.uniform(-50.0, 450.0, 2), float(rng.choice([0.5, 20.0, 90.0, 1000.0]))
        wanted = tree.query(shapely.Point(center), predicate="dwithin", distance=radius_m)
        np.testing.assert_array_equal(index.near(center, radius_m), np.sort(wanted))


def test_the_road_of_a_large_map_is_that_of_the_whole_around_each_place(monkeypatch):
    monkeypatch.setattr("semloc_jax.maps.semantic_map._WHOLE_GROUND", 10)
    large = SemanticMap(tuple(street(400)))
    whole = GroundModel.from_elements(large.elements)
    assert isinstance(large.ground, TiledGround)
    for center in ([200.0, 200.0], [61.0, 333.0], [399.0, 5.0]):
        one, other = large.ground.plane(center), whole.plane(center)
        np.testing.assert_allclose(one.slope, other.slope, atol=1e-9)
        np.testing.assert_allclose([one.height_m, one.num_points], [other.height_m, other.num_points], atol=1e-9)
        near = large.ground.heights_near(np.array(center), 30.0)
        np.testing.assert_allclose(np.sort(near), np.sort(whole.heights_near(np.array(center), 30.0)), atol=1e-9)


def test_a_line_around_the_earth_costs_no_more_ground_than_a_long_road():
    far = MapElement("far", ElementClass.LANE_MARKING, [[0.0, 0.0, 0.0], [4e6, 0.0, 0.0]], width_m=0.1)
    near = MapElement("near", ElementClass.LANE_MARKING, [[0.0, 3.0, 1.0], [50.0, 3.0, 1.0]], width_m=0.1)
    model = GroundModel.from_elements([far, near])
    assert 20_000 <= len(model.points) < 20_100
    np.testing.assert_allclose(model.heights_near(np.array([25.0, 3.0]), 2.0), 1.0)
