"""ESF-640: its sum, its order, what it does not see (place, heading, scale) and what it does (shape)."""

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.perception.shape_functions import NUM_BINS, ShapeConfig, shape_functions

FEW = ShapeConfig(num_triples=4000)


def bar(length, width, spacing=0.05):
    u, v = np.meshgrid(np.arange(0, length, spacing), np.arange(0, width, spacing))
    return np.column_stack([u.ravel(), v.ravel()])


def ring(radius, width, spacing=0.05):
    xy = bar(2 * (radius + width), 2 * (radius + width), spacing) - (radius + width)
    away = np.linalg.norm(xy, axis=1)
    return xy[(away > radius - 0.5 * width) & (away < radius + 0.5 * width)]


def parts(found):
    return found.reshape(10, NUM_BINS)


def test_ten_histograms_that_sum_to_one_and_are_the_same_twice():
    found = shape_functions(bar(3.0, 0.5), 0.05, FEW)
    assert found.shape == (640,)
    assert found.sum() == pytest.approx(1.0)
    np.testing.assert_array_equal(found, shape_functions(bar(3.0, 0.5), 0.05, FEW))


def test_a_convex_mark_has_no_lines_outside_and_a_ring_has():
    """In, out and mixed of A3, D3 and D2: every line between points of a bar runs inside of it."""
    of_bar = parts(shape_functions(bar(3.0, 0.5), 0.05, FEW)).sum(axis=1)
    assert of_bar[[1, 2, 4, 5, 7, 8, 9]].sum() < 0.01
    of_ring = parts(shape_functions(ring(1.0, 0.12), 0.05, FEW)).sum(axis=1)
    assert of_ring[7] + of_ring[8] > 5 * of_ring[6]
    assert of_ring[9] > 0.1


def test_lengths_of_a_thin_bar_fall_off_as_a_line_has_them():
    """Density of the distance d of two points on a line of length 1: 2 (1 - d), so that 2 d - d^2 are shorter."""
    lengths = parts(shape_functions(bar(6.0, 0.1), 0.05, ShapeConfig()))[6]
    d = (np.arange(NUM_BINS) + 1.0) / NUM_BINS
    np.testing.assert_allclose(np.cumsum(lengths) / lengths.sum(), 2 * d - d**2, atol=0.015)


def test_place_heading_and_scale_do_not_matter_and_shape_does():
    shape = ring(1.0, 0.2)
    c, s = np.cos(0.4), np.sin(0.4)
    moved = 1.5 * shape @ np.array([[c, s], [-s, c]]) + [40.0, -7.0]
    own = shape_functions(shape, 0.05, FEW)
    same = np.abs(own - shape_functions(moved, 0.075, FEW)).sum()
    other = np.abs(own - shape_functions(bar(2.0, 2.0), 0.05, FEW)).sum()
    assert same < 0.25 * other


@pytest.mark.parametrize("xy", [np.zeros((0, 2)), np.zeros((2, 2)), np.ones((9, 2))])
def test_clouds_without_a_shape_are_refused(xy):
    with pytest.raises(SemlocError, match="three in different places"):
        shape_functions(xy, 0.05)
