"""What a tracked drive says beside its numbers."""

import numpy as np

from semloc_jax.alignment.scene import SceneConfig
from semloc_jax.localization.track_state import TrackStatus
from semloc_jax.maps import Belief, BeliefMap, MapElement, SemanticMap
from semloc_jax.reports.track_log import COLUMNS, TrackTable
from semloc_jax.reports.track_metrics import told_apart


def test_what_the_map_is_off_is_told_once_where_poses_are_places_in_it():
    """Two poses, beside what is off by 3 cm and by 20 cm; on the earth it is in the sigmas of each pose."""
    columns = {name: np.zeros(2) for name in COLUMNS}
    columns["x_m"], columns["time_s"], columns["qw"] = np.array([0.0, 500.0]), np.arange(2.0), np.ones(2)
    table = TrackTable(("0", "1"), ("",) * 2, (TrackStatus.TRACKING,) * 2, ("",) * 2, ("",) * 2, columns)
    elements, beliefs = [], {}
    for k in range(10):
        near = k < 5
        line = [[k, 2.0, 0.0], [k + 1.0, 2.0, 0.0]] if near else [[500.0 + k, 2.0, 0.0], [501.0 + k, 2.0, 0.0]]
        elements.append(MapElement(f"e{k}", "lane_marking", line))
        off = (0.03, np.radians(0.05)) if near else (0.2, np.radians(0.11))
        beliefs[f"e{k}"] = Belief(0.02, 0.05, 4.0, sigma_place_m=off[0], sigma_turn_rad=off[1])
    stated = BeliefMap(SemanticMap(tuple(elements), None, "m"), beliefs).as_map()
    said = told_apart(table, stated, SceneConfig(place_in="map"))
    assert "0.03 to 0.20 m and 0.05 to 0.11 deg" in said
    assert told_apart(table, stated, SceneConfig()) == ""
