"""Lines side by side: each drive shows both strands of a double line, and none is laid onto the other."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.evaluation import compare_maps
from semloc_jax.mapping.crowd.merged import merged
from semloc_jax.mapping.crowd.world_lines import Piece, WorldLine, line_sights
from semloc_jax.maps import MapElement
from tests.mapping.crowd_world import DriveNoise, Road, _on, drive

APART_M = 0.26


def straight(y_m, length_m=20.0):
    return np.column_stack([np.arange(0.0, length_m + 0.1), np.full(int(length_m) + 1, y_m)])


def pieces(*sides_m):
    return [Piece.of(np.column_stack([straight(y), np.zeros(21)]), straight(y), 0.03) for y in sides_m]


def lines(*sides_m):
    return [
        WorldLine.along("line", (0, MapElement("e", "lane_marking", np.zeros((2, 3)))), straight(y)) for y in sides_m
    ]


@pytest.mark.parametrize("shift_m", [0.0, 0.1, 0.2, -0.2])
def test_both_strands_are_found_even_where_the_nearest_is_the_wrong_one(shift_m):
    seen = line_sights(lines(0.0, APART_M), pieces(shift_m, APART_M + shift_m), 0.28)
    assert len(seen.line) == 42 and (seen.piece == seen.line).all()


def test_one_piece_is_one_strand():
    seen = line_sights(lines(0.0, APART_M), pieces(0.2), 0.28)
    assert set(seen.line.tolist()) == {1} and len(seen.line) == 21
    assert len(line_sights(lines(0.0), pieces(0.5), 0.28).line) == 0


def test_a_double_line_stays_two_lines_where_they_are():
    plain = Road.of(150.0)
    ends = np.arange(20.0, 121.0, 2.0)
    sides = {"left_strand": APART_M / 2, "right_strand": -APART_M / 2}
    strands = [_on(n, "lane_marking", [(s, y) for s in ends], style="solid", width_m=0.12) for n, y in sides.items()]
    kept = [e for e in plain.elements if not e.id.startswith("dash") or not 18.0 < 6.0 + 9.0 * int(e.id[5:]) < 120.0]
    road = replace(plain, elements=(*kept, *strands))
    found = merged(None, [drive(road, k, DriveNoise(bend_rad=0.001)) for k in range(6)])
    both = [e.points[:, :2] for e in found.beliefs.map.elements if e.style == "solid"]
    line = compare_maps(found.beliefs.map.elements, road.elements, "se2").classes["line"]
    assert line.recall > 0.97 and line.precision > 0.97
    assert float(np.sqrt(np.mean(line.across_m**2))) < 0.03
    assert sum(np.linalg.norm(np.diff(xy, axis=0), axis=1).sum() for xy in both) == pytest.approx(500.0, abs=10.0)
