"""Places along polylines, against shapely."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from shapely import LineString, Point

from semloc_jax.geometry import polyline

LINE = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 1.0], [4.0, 3.0, 1.0], [-2.0, 3.5, 0.5]])


def test_arc_length_and_interpolation():
    s_m = polyline.arc_length(LINE)
    assert s_m[-1] == pytest.approx(sum(np.linalg.norm(b - a) for a, b in pairwise(LINE)))
    assert np.allclose(polyline.interpolate(LINE, s_m), LINE)
    flat = LINE[:, :2]
    places = np.linspace(0.0, polyline.arc_length(flat)[-1], 23)
    expected = [LineString(flat).interpolate(s).coords[0] for s in places]
    assert np.allclose(polyline.interpolate(flat, places), expected)
    assert np.allclose(polyline.interpolate(flat, np.array([-5.0, 500.0])), flat[[0, -1]])


def test_tangent_is_the_direction_of_travel():
    assert np.allclose(polyline.tangent(LINE[:, :2], np.array([1.0, 4.0, 5.0])), [[1, 0], [0, 1], [0, 1]])
    assert np.allclose(np.linalg.norm(polyline.tangent(LINE, np.linspace(0, 12, 9)), axis=1), 1.0)


def test_nearest_equals_shapely():
    flat = LINE[:, :2]
    queries = np.random.default_rng(0).uniform(-4, 8, (200, 2))
    foot = polyline.nearest(flat, queries)
    line = LineString(flat)
    assert np.allclose(foot.distance_m, [line.distance(Point(q)) for q in queries])
    assert np.allclose(foot.s_m, [line.project(Point(q)) for q in queries])
    assert np.allclose(np.abs(foot.lateral_m), foot.distance_m)


def test_left_is_positive():
    foot = polyline.nearest(LINE, np.array([[2.0, 0.5, 0.5], [2.0, -0.5, 0.5], [3.5, 1.0, 1.0], [4.5, 1.0, 1.0]]))
    assert foot.lateral_m == pytest.approx([0.5, -0.5, 0.5, -0.5])


def test_jax_and_numpy_agree():
    queries = np.random.default_rng(0).uniform(-4, 8, (20, 3))
    ours = jax.jit(polyline.nearest)(jnp.asarray(LINE), jnp.asarray(queries))
    assert isinstance(ours.s_m, jax.Array)
    for theirs, mine in zip(polyline.nearest(LINE, queries), ours, strict=True):
        assert isinstance(theirs, np.ndarray)
        assert np.allclose(theirs, mine)
    s_m = jnp.linspace(0.0, 10.0, 7)
    assert np.allclose(jax.jit(polyline.interpolate)(jnp.asarray(LINE), s_m), polyline.interpolate(LINE, np.array(s_m)))
