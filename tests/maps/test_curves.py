"""Arc-length sampling, parallel lines and clipping against shapely."""

import numpy as np
import pytest
import shapely

from semloc_jax.maps.curves import clip_to_circle, parallel, resample, without_repeats


def _wiggly(seed: int, count: int = 12) -> np.ndarray:
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.uniform(0.5, 3.0, count))
    return np.stack([x, rng.normal(0, 0.6, count), rng.normal(0, 0.2, count)], axis=1)


def _densified(points: np.ndarray, seed: int) -> np.ndarray:
    """The same line with many more vertices at odd places."""
    shares = np.sort(np.random.default_rng(seed).uniform(0, 1, (len(points) - 1, 7)), axis=1)
    pieces = [
        a + np.concatenate([[0.0], share])[:, None] * (b - a)
        for a, b, share in zip(points[:-1], points[1:], shares, strict=True)
    ]
    return np.vstack([*pieces, points[-1:]])


def test_samples_lie_at_equal_arc_lengths_on_the_line():
    points = _wiggly(0)
    position, tangent, length, line, share = resample([points], 0.25)
    total = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    assert np.isclose(length.sum(), total, rtol=1e-12)
    assert np.ptp(length) == 0.0
    assert abs(length[0] - 0.25) < 0.25 / len(length)
    assert (line == 0).all()
    np.testing.assert_allclose(share, (np.arange(len(share)) + 0.5) / len(share), atol=1e-12)
    # shapely measures in the plane: compare there with a flat line.
    flat = points * [1, 1, 0]
    position, tangent, length, _, _ = resample([flat], 0.25)
    expected = [shapely.LineString(flat[:, :2]).interpolate(s) for s in (np.arange(len(position)) + 0.5) * length[0]]
    np.testing.assert_allclose(position[:, :2], [(p.x, p.y) for p in expected], atol=1e-10)
    np.testing.assert_allclose(np.linalg.norm(tangent, axis=1), 1.0, atol=1e-12)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_samples_do_not_depend_on_vertices(seed):
    points = _wiggly(seed)
    coarse = resample([points], 0.3)[0]
    dense = resample([_densified(points, seed)], 0.3)[0]
    np.testing.assert_allclose(dense, coarse, atol=1e-9)


def test_many_lines_at_once_equal_one_by_one():
    lines = [_wiggly(4), np.array([[5.0, 5, 5], [5.0, 5, 5]]), _wiggly(5, 3), np.array([[0.0, 0, 0], [0, 0, 0.1]])]
    position, _, length, line, _ = resample(lines, 0.4)
    assert np.bincount(line, minlength=4)[[1, 3]].tolist() == [0, 1]
    for index in (0, 2, 3):
        alone = resample([lines[index]], 0.4)
        np.testing.assert_allclose(position[line == index], alone[0], atol=1e-9)
        np.testing.assert_allclose(length[line == index], alone[2], rtol=1e-9)


def test_parallel_line_is_mitred_like_shapely():
    points = np.array([[0.0, 0, 1], [10, 0, 2], [10, 8, 3], [16, 14, 4], [30, 14, 5]])
    for offset in (0.3, -0.3):
        expected = shapely.LineString(points[:, :2]).offset_curve(offset, join_style="mitre", mitre_limit=10)
        found = parallel(points, offset)
        np.testing.assert_allclose(found[:, :2], np.array(expected.coords), atol=1e-9)
        np.testing.assert_array_equal(found[:, 2], points[:, 2])


def test_left_is_up_cross_tangent():
    east = np.array([[0.0, 0, 0], [5, 0, 0]])
    np.testing.assert_allclose(parallel(east, 0.1)[:, 1], 0.1)


def test_a_loop_is_mitred_at_its_seam():
    square = np.array([[0.0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0], [0, 0, 0]])
    inner = parallel(square, 0.5, is_loop=True)
    np.testing.assert_allclose(inner[:, :2], [[0.5, 0.5], [3.5, 0.5], [3.5, 3.5], [0.5, 3.5], [0.5, 0.5]], atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_clip_equals_intersection_with_a_disc(seed):
    rng = np.random.default_rng(seed)
    points = np.cumsum(rng.normal(0, 2.0, (40, 3)), axis=0)
    center, radius = rng.normal(0, 3.0, 2), 5.0
    parts = clip_to_circle(points, center, radius)
    disc = shapely.Point(center).buffer(radius, quad_segs=4096)
    expected = shapely.LineString(points[:, :2]).intersection(disc).length
    found = sum(np.linalg.norm(np.diff(part[:, :2], axis=0), axis=1).sum() for part, _, _ in parts)
    assert found == pytest.approx(expected, rel=1e-4)
    for part, _, _ in parts:
        assert np.all(np.linalg.norm(part[:, :2] - center, axis=1) <= radius + 1e-9)


def test_clip_tells_true_ends_from_cuts():
    line = np.array([[-10.0, 0, 0], [0, 0, 1], [10, 0, 2]])
    assert [part[1:] for part in clip_to_circle(line, np.zeros(2), 5.0)] == [(False, False)]
    assert [part[1:] for part in clip_to_circle(line, np.array([-10.0, 0]), 5.0)] == [(True, False)]
    assert [part[1:] for part in clip_to_circle(line, np.array([10.0, 0]), 12.0)] == [(False, True)]
    assert [part[1:] for part in clip_to_circle(line, np.zeros(2), 50.0)] == [(True, True)]
    assert clip_to_circle(line, np.array([0.0, 9.0]), 5.0) == []
    ((cut, _, _),) = clip_to_circle(line, np.array([-10.0, 0]), 5.0)
    np.testing.assert_allclose(cut[-1], [-5, 0, 0.5], atol=1e-12)


def test_a_line_that_leaves_and_returns_gives_two_parts():
    arch = np.array([[-4.0, 0, 0], [-4, 20, 0], [4, 20, 0], [4, 0, 0]])
    parts = clip_to_circle(arch, np.zeros(2), 6.0)
    assert [part[1:] for part in parts] == [(True, False), (False, True)]


def test_repeated_vertices_are_dropped():
    points = np.array([[0.0, 0, 0], [0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0]])
    assert len(without_repeats(points)) == 4
    assert len(without_repeats(points, closed=True)) == 3
