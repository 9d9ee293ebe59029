"""Worn lines of PandaSet are what is left of them, not what their labels say."""

import numpy as np
import pytest

from semloc_jax.datasets.pandaset.reader import LANE_LINE, ROAD, LabelledPoints
from semloc_jax.datasets.pandaset.vectorize import trace_lines
from semloc_jax.datasets.pandaset.worn_lines import told_by_light, trace_paint

PIECES_M = ((2.0, 3.0), (5.0, 6.5), (9.0, 10.2))
PAINT, BARE = 20.0, 4.0


@pytest.fixture
def points() -> LabelledPoints:
    """A line 12 m long, labelled without a gap, of which three pieces are left; road on both sides."""
    rng = np.random.default_rng(3)
    line = np.column_stack([rng.uniform(0.0, 12.0, 12_000), rng.uniform(-0.06, 0.06, 12_000), np.zeros(12_000)])
    road = np.column_stack([rng.uniform(0.0, 12.0, 6_000), rng.uniform(-2.0, 2.0, 6_000), np.zeros(6_000)])
    is_paint = np.any([(line[:, 0] > start) & (line[:, 0] < end) for start, end in PIECES_M], axis=0)
    light = np.append(np.where(is_paint, PAINT, BARE), np.full(len(road), BARE)) + rng.normal(0.0, 1.0, 18_000)
    class_id = np.repeat([LANE_LINE, ROAD], [12_000, 6_000])
    return LabelledPoints(np.vstack([line, road]), light, np.zeros(18_000, int), class_id, np.zeros(18_000, int))


def test_a_worn_line_is_drawn_as_the_pieces_that_are_left(points):
    assert len(trace_lines(points.of(LANE_LINE))) == 1, "the label alone is one line"
    lines = sorted(trace_paint(points, LANE_LINE, slice(None)), key=lambda line: line.points[:, 0].min())
    ends = np.array([np.sort(line.points[:, 0]) for line in lines])
    np.testing.assert_allclose(ends, PIECES_M, atol=0.05)
    assert all(line.is_isolated for line in lines), "bare road around a piece says where it ends"
    assert [line.width_m for line in lines] == pytest.approx([0.12] * 3, abs=0.02)


def test_light_that_does_not_tell_paint_from_road_leaves_labels_as_they_are(points):
    grey = LabelledPoints(points.p_map, np.full(18_000, BARE), points.sensor, points.class_id, points.sweep)
    lines = trace_paint(grey, LANE_LINE, slice(None))
    assert len(lines) == 1
    assert np.ptp(lines[0].points[:, 0]) > 11.0


def test_points_without_road_beside_them_are_not_called_bare(points):
    line = points.seen(LANE_LINE)
    told = told_by_light(line.p_map, line.intensity, np.zeros((0, 3)), np.zeros(0))
    assert not told.is_told.any()
    assert not told.is_bare.any()
