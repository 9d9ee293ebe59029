"""The length of the roads of a large map, from a picture, is that of the outlines."""

import numpy as np
import pytest

from semloc_jax.maps import inspect
from semloc_jax.maps.columns import Columns
from semloc_jax.maps.elements import MapElement
from semloc_jax.structs import ElementClass


def _lane(key: str, points: np.ndarray) -> MapElement:
    return MapElement(key, ElementClass.LANE_MARKING, points, width_m=0.12, style="solid")


def test_a_picture_of_the_map_tells_the_length_of_its_roads():
    way = np.linspace(0.0, 1.0, 60)
    straight = np.column_stack([900.0 * way, 0.0 * way, 0.0 * way])
    bend = np.column_stack([1500.0 + 300.0 * np.sin(3.0 * way), 300.0 * np.cos(3.0 * way), 0.0 * way])
    elements = [_lane("a", straight), _lane("b", straight + [0.0, 3.5, 0.0]), _lane("c", bend)]
    columns = Columns.of(elements)
    exact_m = inspect._road_length_m(columns)
    assert exact_m == pytest.approx(1800.0, rel=0.02)
    assert inspect.road_length_on_grid_m(columns) == pytest.approx(exact_m, rel=0.03)


def test_the_size_of_a_large_map_is_told_from_a_part_of_it(monkeypatch):
    rng = np.random.default_rng(1)
    lines = [np.cumsum(rng.normal(size=(12, 3)) * [3.0, 3.0, 0.0], axis=0) + [k, 0.0, 0.0] for k in range(400)]
    semantic_map = inspect.SemanticMap(tuple(_lane(f"{k}", line) for k, line in enumerate(lines)))
    whole = inspect.inspect_map(semantic_map)
    monkeypatch.setattr(inspect, "_STRETCH", 15)
    part = inspect.inspect_map(semantic_map)
    assert part.bytes_per_km == pytest.approx(whole.bytes_per_km, rel=0.15)
    assert part.compact_bytes_per_km == pytest.approx(whole.compact_bytes_per_km, rel=0.15)
