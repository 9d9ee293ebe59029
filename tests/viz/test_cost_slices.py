"""Cost slices: minima are found between the grid points, flat places have none, the true pose is marked."""

import numpy as np
import pytest

from semloc_jax import viz
from semloc_jax.errors import SemlocError

A, B = np.linspace(-3.0, 3.0, 61), np.linspace(-2.0, 2.0, 41)


def _well(a0: float, b0: float, depth: float, width: float = 0.5) -> np.ndarray:
    return depth * np.exp(-((A[:, None] - a0) ** 2 + (B[None, :] - b0) ** 2) / (2 * width**2))


def _slice(cost: np.ndarray) -> viz.CostSlice:
    return viz.CostSlice(("x", "y"), A, B, cost)


def test_minima_are_found_between_the_grid_points_lowest_first():
    cost = 1.0 - _well(0.33, -0.52, 0.8) - _well(-2.04, 1.07, 0.5)
    first, second = viz.find_minima(_slice(cost))
    assert (first.offset_a, first.offset_b) == pytest.approx((0.33, -0.52), abs=0.01)
    assert (second.offset_a, second.offset_b) == pytest.approx((-2.04, 1.07), abs=0.01)
    assert first.cost == pytest.approx(0.2, abs=0.01)


def test_a_flat_or_empty_slice_has_no_minimum():
    assert viz.find_minima(_slice(np.full((61, 41), 0.7))) == []
    assert viz.find_minima(_slice(np.full((61, 41), np.nan))) == []


def test_a_plateau_counts_once():
    cost = np.ones((61, 41))
    cost[20:24, 10:13] = 0.2
    assert len(viz.find_minima(_slice(cost))) == 1


def test_a_minimum_at_the_border_is_reported_there():
    cost = np.broadcast_to(np.abs(A + 3.0)[:, None] + np.abs(B - 0.5)[None, :], (61, 41)) / 10
    (minimum,) = viz.find_minima(_slice(cost))
    assert minimum.offset_a == -3.0
    assert minimum.offset_b == pytest.approx(0.5)


def test_one_panel_for_each_class_on_one_scale():
    slices = {"all": _slice(1.0 - _well(0, 0, 0.8)), "pole": _slice(1.0 - _well(0, 0, 0.3))}
    figure = viz.landscape(slices, "frame 20", truth=(0.0, 0.0))
    panels = [axes for axes in figure.axes if axes.get_title()]
    assert [axes.get_title() for axes in panels] == ["all", "pole"]
    assert [axes.get_xlabel() for axes in panels] == ["longitudinal [m]"] * 2
    words = figure.get_supxlabel()
    assert all(word in words for word in ("minima", "nothing of it in view", "true pose"))
    assert "true pose" not in viz.landscape(slices, "frame 20").get_supxlabel()
    ranges = {axes.collections[0].get_clim() for axes in panels}
    assert len(ranges) == 1
    assert next(iter(ranges)) == pytest.approx((0.2, 1.0), abs=0.01)


def test_labels_of_minima_side_by_side_are_not_written_over_each_other():
    near = 1.0 - _well(-0.2, 0.0, 0.8, 0.1) - _well(0.2, 0.05, 0.7, 0.1) - _well(2.0, 1.5, 0.5, 0.2)
    axes = viz.landscape({"pole": _slice(near)}).axes[0]
    assert [text.get_text().split()[0] for text in axes.texts] == ["1", "3"]


def test_axes_of_a_slice_must_fit_its_cost():
    with pytest.raises(SemlocError, match=r"got cost \(41, 61\)"):
        viz.CostSlice(("x", "y"), A, B, np.zeros((41, 61)))
    with pytest.raises(SemlocError, match="expected directions among x, y, z, roll, pitch, yaw"):
        viz.CostSlice(("x", "heading"), A, B, np.zeros((61, 41)))
