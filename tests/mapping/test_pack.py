"""What of a drive's map goes into its upload."""

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
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


def test_a_file_tells_round_boards_by_two_sides_and_painted_outlines_no_finer_than_they_are_known():
    """A board of 24 corners askew on a slope, an arrow whose outline wobbles by 3 cm and one that is known to 1 cm."""
    turn = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    aside = np.array([0.6, 0.8, 0.0])
    board = [15.0, 6.0, 5.3] + 0.4 * (np.outer(np.cos(turn), aside) + np.outer(np.sin(turn), [0.0, 0.0, 1.0]))
    round_board = MapElement("b", "sign", board, closed=True, shape="circle", normal=np.array([0.8, -0.6, 0.0]))
    s_m = np.arange(0.0, 3.01, 0.25)
    side = 0.2 + np.where(np.arange(len(s_m)) % 2, 0.03, 0.0)
    outline = np.vstack([np.column_stack([s_m, side]), np.column_stack([s_m, -side])[::-1]])
    arrow = MapElement("a", "road_mark", np.column_stack([outline, np.zeros(len(outline))]), closed=True)
    way = np.column_stack([np.arange(0.0, 40.1, 10.0), np.zeros(5), 0.05 * np.arange(0.0, 40.1, 10.0), np.zeros(5)])
    ring = (np.array([[0.0, -9.0], [9.0, -9.0], [9.0, 9.0]]),)
    arrows = {}
    for sigma_m in (0.01, 0.08):
        held = {"b": Belief(0.15, 0.15, 4.0, 8, 0), "a": Belief(sigma_m, 0.2, 4.0, 8, 0)}
        made = BeliefMap(SemanticMap((round_board, arrow), None, "d"), held)
        again = unpacked(packed_bytes(PackedDrive("d", made, np.zeros(4), 1.5, None, way, ring)), "d").beliefs.map
        told = {e.label.name: e for e in again.elements}
        apart_m = np.abs(told["SIGN"].points - board)
        assert apart_m[:, :2].max() < 0.011 and apart_m[:, 2].max() < 0.061  # heights are told in 10 cm
        arrows[sigma_m] = told["ROAD_MARK"].points
    assert len(arrows[0.01]) > 0.8 * len(outline) and len(arrows[0.08]) < 0.4 * len(outline)
    ring_m = np.vstack([arrows[0.08], arrows[0.08][:1]])[:, :2]
    assert polyline.nearest(ring_m, outline).distance_m.max() < 0.055


def test_a_file_of_another_version_says_so():
    with pytest.raises(SemlocError, match="another version of this package; pack the drive again"):
        unpacked(b"SLOC\x02" + bytes(40), "d")
