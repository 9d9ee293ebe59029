"""Surveyed distances are compared within the map, wherever its frame lies."""

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import surveyed_distances, surveyed_metrics
from semloc_jax.geometry import rigid
from semloc_jax.maps import MapElement
from semloc_jax.structs import ElementClass

ROWS = [
    {
        "a": {"id": "s", "what": "entrance corner 0 of the slot", "point": [0.0, 0.0, 0.0]},
        "b": {"id": "t", "what": "tip of the arrow", "point": [30.0, 40.0, 0.0]},
        "distance_m": 50.0,
    },
    {
        "a": {"id": "s", "what": "entrance corner 0 of the slot", "point": [0.0, 0.0, 0.0]},
        "b": {"id": "u", "what": "entrance corner 0 of the slot", "point": [90.0, 0.0, 0.0]},
        "distance_m": 90.0,
    },
]


def test_distances_are_off_by_what_the_map_is_off():
    """A map 0.2 % too large in a frame of its own: 10 cm in 50 m; the second slot is not in it."""
    T = rigid.planar_pose(5.0, -3.0, 0.7)
    slot = np.array([[0.0, 0.0, 0.0], [2.5, 0.0, 0.0], [2.5, 5.0, 0.0], [0.0, 5.0, 0.0]])
    arrow = np.array([[28.0, 40.0, 0.0], [30.0, 40.0, 0.0], [28.5, 39.0, 0.0]])
    elements = [
        MapElement("a", ElementClass.PARKING_SLOT, 1.002 * slot @ T[:3, :3].T + T[:3, 3], closed=True),
        MapElement("b", ElementClass.ROAD_MARK, 1.002 * arrow @ T[:3, :3].T + T[:3, 3], closed=True),
    ]
    found = {m.key: m.value for m in surveyed_metrics(elements, surveyed_distances(ROWS, "x"), rigid.inverse(T))}
    assert (found["surveyed.distances"], found["surveyed.found"]) == (2.0, 1.0)
    assert found["surveyed.rmse"] == pytest.approx(0.1, abs=1e-9)
    assert found["surveyed.max"] == pytest.approx(0.1, abs=1e-9)


@pytest.mark.parametrize("wrong", [[{"a": 1}], [{**ROWS[0], "distance_m": "far"}], 3])
def test_what_is_no_list_of_distances_is_refused_in_one_line(wrong):
    with pytest.raises(SemlocError, match=r"meta.json: surveyed: .*expected a list"):
        surveyed_distances(wrong, "meta.json")
