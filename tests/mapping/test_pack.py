"""What of a drive's map goes into its upload."""

import numpy as np
import pytest

from semloc_jax.geometry import polyline
from semloc_jax.mapping.crowd.pack import each_curb_once
from semloc_jax.maps import Belief, BeliefMap, MapElement, SemanticMap
from semloc_jax.maps.io.packed_drive import PackedDrive, packed_bytes, unpacked


def line(name, start_m, end_m, side_m, label="curb"):
    s_m = np.arange(start_m, end_m + 0.5)
    return MapElement(name, label, np.column_stack([s_m, np.full(len(s_m), side_m), np.zeros(len(s_m))]), width_m=0.15)


def map_of(*lines, sigma_m=0.13):
    return BeliefMap(SemanticMap(lines, None, "d"), {e.id: Belief(sigma_m, 0.3, 4.0, 8, 0) for e in lines})


def test_a_curb_that_is_drawn_thrice_is_told_once():
    """0.2 and 0.3 m aside of a longer one; one that runs on past its end, one beyond a path and paint stay."""
    paint = [line(f"p{k}", 0, 20, 3.0 + 0.2 * k, "lane_marking") for k in range(2)]
    made = map_of(
        line("short", 5, 15, 0.2), line("long", 0, 20, 0.0), line("other", 2, 19, -0.3), line("on", 14, 34, 0.1),
        line("path", 0, 20, 0.9), *paint,
    )  # fmt: skip
    assert [e.id for e in each_curb_once(made)] == ["long", "on", "path", "p0", "p1"]


@pytest.mark.parametrize(("sigma_m", "num_points"), [(0.02, 9), (0.13, 2)])
def test_a_line_is_told_no_finer_than_it_is_known(sigma_m, num_points):
    """A curb that goes to and fro by 0.1 m."""
    zigzag = line("c", 0, 8, 0.0)
    zigzag = zigzag.with_points(zigzag.points + np.outer(np.arange(9) % 2, [0.0, 0.1, 0.0]))
    drive = PackedDrive(
        "d", map_of(zigzag, sigma_m=sigma_m), np.zeros(4), 1.5, None, np.zeros((2, 4)) + np.arange(2)[:, None],
        (np.array([[0.0, -9.0], [9.0, -9.0], [9.0, 9.0]]),),
    )  # fmt: skip
    again = unpacked(packed_bytes(drive), "d").beliefs.map.elements[0].points
    assert len(again) == num_points
    assert polyline.nearest(again[:, :2], zigzag.points[:, :2]).distance_m.max() <= sigma_m + 0.01
