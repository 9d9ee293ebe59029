"""nuScenes map expansions, on a small one written by hand after the format's description."""

import json

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.maps import read_lane_centers, read_map
from semloc_jax.maps.io.nuscenes import map_from_nuscenes
from semloc_jax.structs import ElementClass
from tests.maps.io.nuscenes_file import expansion


def test_dividers_change_their_type_along_the_way(tmp_path):
    (tmp_path / "boston.json").write_text(json.dumps(expansion()))
    road = read_map(tmp_path / "boston.json")
    bars = [e for e in road.elements if e.style == "dashed"]
    assert len(bars) == 4 and all(e.length_m == pytest.approx(3.0) and e.points[:, 0].max() <= 40.0 for e in bars)
    doubles = [e for e in road.elements if e.style == "solid"]
    np.testing.assert_allclose([e.points[:, 1].mean() for e in doubles], [0.12, -0.12])
    assert all(np.allclose(e.points[:, 0], [40.0, 60.0]) for e in doubles)
    assert all("width" in e.attributes["assumed"] for e in bars + doubles)
    assert road.frame == "nuScenes map frame" and not any(e.has_height for e in road.elements)


def test_areas_and_lights():
    road = map_from_nuscenes(expansion(), "boston.json")
    (crossing,) = [e for e in road.elements if e.label == ElementClass.CROSSWALK]
    assert crossing.closed and len(crossing.points) == 4
    stops = {e.id: e.style for e in road.elements if e.label == ElementClass.STOP_LINE}
    assert stops == {"S": "", "U": "virtual"}, "a turn stop is no paint"
    (light,) = [e for e in road.elements if e.label == ElementClass.TRAFFIC_LIGHT]
    assert light.is_logical
    assert sum(e.attributes.get("layer") == "road_divider" and e.is_logical for e in road.elements) == 1


@pytest.mark.parametrize(
    "change",
    [
        {"node": [{"token": "a"}]},
        {"line": [{"token": "L", "node_tokens": ["nowhere", "a"]}]},
        {"polygon": 5},
        {"lane_divider": [{"token": "D", "line_token": "L", "lane_divider_segments": [3]}]},
    ],
)
def test_broken_expansions_are_refused(change):
    with pytest.raises(SemlocError, match="expected a nuScenes map expansion"):
        map_from_nuscenes(expansion() | change, "boston.json")


def test_lanes_are_chains_of_arcs(tmp_path):
    """A quarter circle to the left of 10 m radius, 20 m straight on, 5 m to the right; held against their own ends."""
    quarter = 0.5 * np.pi * 10.0
    path = {"start_pose": [1.0, 2.0, 0.0], "radius": 10.0, "shape": "LSR", "segment_length": [quarter, 20.0, 5.0]}
    document = expansion() | {"arcline_path_3": {"lane": [path]}}
    (tmp_path / "boston.json").write_text(json.dumps(document))
    (line,) = read_lane_centers(tmp_path / "boston.json", None)
    ends = np.array([1.0, 2.0]), np.array([11.0, 12.0]), np.array([11.0, 32.0])
    turned = [10.0 * (1.0 - np.cos(0.5)), 10.0 * np.sin(0.5)]
    for end in (*ends, ends[-1] + turned):
        assert np.linalg.norm(line[:, :2] - end, axis=1).min() < 1e-9
    np.testing.assert_allclose(line[-1, :2], ends[-1] + turned, atol=1e-9)
    assert np.linalg.norm(np.diff(line, axis=0), axis=1).max() <= 0.5
    path["radius"] = float("nan")
    (tmp_path / "boston.json").write_text(json.dumps(document))
    with pytest.raises(SemlocError, match="lane lane cannot be read"):
        read_lane_centers(tmp_path / "boston.json", None)
