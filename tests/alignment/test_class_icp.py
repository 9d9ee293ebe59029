"""ICP in the plane by class: known motions, an outside oracle, what a line leaves open, bad input."""

import numpy as np
import pytest

from semloc_jax.alignment.class_icp import ClassPoints, ClassTrees, IcpConfig, align_points
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid

LINE, BAR = 0, 2


def road(noise_m=0.0, seed=0, num_bars=5):
    """Two lines 3.5 m apart with bars between them: 20 m of road, a point every 10 cm."""
    along, across = np.arange(0.0, 20.0, 0.1), np.arange(-1.7, 1.7, 0.1)
    lines = [np.column_stack([along, np.full_like(along, y)]) for y in (-1.75, 1.75)]
    bars = [np.column_stack([np.full_like(across, x), across]) for x in np.linspace(2.0, 18.0, num_bars)]
    xy = np.concatenate([*lines, *bars])
    xy = xy + noise_m * np.random.default_rng(seed).normal(size=xy.shape)
    return ClassPoints.of(xy, np.repeat([LINE, BAR], [2 * len(along), num_bars * len(across)]))


@pytest.mark.parametrize(("x_m", "y_m", "deg"), [(0.6, -0.3, 1.0), (-0.5, 0.4, -2.0)])
def test_a_known_motion_is_found(x_m, y_m, deg):
    T_true = rigid.planar_pose(x_m, y_m, np.deg2rad(deg))
    source = road(0.01, seed=1).moved(rigid.inverse(T_true))
    found = align_points(source, road(0.01, seed=2), np.eye(4))
    off = rigid.log(rigid.inverse(T_true) @ found.T_target_source)
    assert found.converged
    assert np.abs(off[:2]).max() < 0.015
    assert abs(np.rad2deg(off[5])) < 0.05
    assert found.inlier_ratio > 0.97
    assert found.rms_m < 0.06
    assert found.labels == (LINE, BAR)


def test_long_lines_hold_the_points_back_along_them():
    """The weakness of nearest points: those of a line always find a partner where they are. One bar in 20 m loses."""
    source, target = (road(0.01, seed, num_bars=1) for seed in (1, 2))
    found = align_points(source.moved(rigid.planar_pose(-0.6, 0.3)), target, np.eye(4))
    off_m = found.T_target_source[:2, 3] - [0.6, -0.3]
    assert abs(off_m[1]) < 0.01
    assert 0.05 < abs(off_m[0]) < 0.6


def test_points_only_meet_their_own_class():
    """A solid line and a slot line 0.6 m beside it: without classes the nearer one would take the points."""
    along = np.arange(0.0, 8.0, 0.1)
    xy = np.concatenate([np.column_stack([along, np.full_like(along, y)]) for y in (0.0, 0.6)])
    target = ClassPoints.of(xy, np.repeat([LINE, BAR], len(along)))
    source = ClassPoints.of(xy[: len(along)] + [0.0, 0.5], np.full(len(along), LINE))
    assert align_points(source, target, np.eye(4)).T_target_source[1, 3] == pytest.approx(-0.5, abs=1e-3)
    blind = target._replace(label=np.full(len(xy), LINE))
    assert align_points(source, blind, np.eye(4)).T_target_source[1, 3] == pytest.approx(0.1, abs=1e-3)


def test_a_line_alone_leaves_the_way_along_it_open():
    along = np.arange(0.0, 20.0, 0.1)
    one = ClassPoints.of(np.column_stack([along, np.zeros_like(along)]), np.zeros(len(along), int))
    covariance = align_points(one, one, rigid.planar_pose(0.0, 0.1)).covariance
    assert not np.isfinite(covariance).all() or covariance[0, 0] > 1e3 * covariance[1, 1]
    both = align_points(road(0.01), road(0.01, seed=3), rigid.planar_pose(0.1, 0.1)).covariance
    assert 1e-4 < np.sqrt(both[0, 0]) < 0.1


def test_the_motion_is_that_of_small_gicp():
    small_gicp = pytest.importorskip("small_gicp", reason="small-gicp, the oracle of the ICP, is not installed")
    rng = np.random.default_rng(4)
    target = rng.uniform(-8.0, 8.0, size=(400, 2))
    T_true = rigid.planar_pose(0.15, -0.1, np.deg2rad(0.7))
    source = (target - T_true[:2, 3]) @ T_true[:2, :2] + 0.02 * rng.normal(size=target.shape)
    flat = [np.column_stack([xy, np.zeros(len(xy))]) for xy in (target, source)]
    theirs = small_gicp.align(*flat, registration_type="ICP", max_correspondence_distance=0.5, max_iterations=60)
    one = np.zeros(len(target), int)
    config = IcpConfig(gates_m=(0.5,), max_steps=60, tolerance_m=1e-7)
    ours = align_points(ClassPoints.of(source, one), ClassPoints.of(target, one), np.eye(4), config)
    # Both stop where no pair changes any more: the least squares over the same pairs.
    np.testing.assert_allclose(ours.T_target_source, theirs.T_target_source, atol=2e-3)


def test_two_local_maps_meet_where_they_overlap():
    """Each saw another part of the road; the second one's odometry is 0.4 m and 1 deg off."""
    whole = road(0.01, seed=5)
    first, second = (ClassPoints(*(part[whole.xy[:, 0] > 4.0] for part in whole)), road(0.01, seed=6))
    T_first_second = rigid.planar_pose(0.4, -0.2, np.deg2rad(1.0))
    found = align_points(second.moved(rigid.inverse(T_first_second)), ClassTrees.of(first), np.eye(4))
    np.testing.assert_allclose(found.T_target_source[:2, 3], T_first_second[:2, 3], atol=0.03)
    assert 0.75 < found.inlier_ratio < 0.9


def test_thinning_keeps_weights_and_classes_apart():
    xy = np.array([[0.01, 0.01], [0.02, 0.02], [0.02, 0.02], [0.25, 0.0]])
    thin = ClassPoints.of(xy, np.array([0, 0, 2, 0])).thinned(0.1)
    np.testing.assert_array_equal(thin.xy, xy[[0, 2, 3]])
    np.testing.assert_array_equal(thin.label, [0, 2, 0])
    np.testing.assert_array_equal(thin.weight, [2.0, 1.0, 1.0])


def test_sets_that_do_not_meet_are_told_and_empty_ones_refused():
    far = align_points(road(), road(), rigid.planar_pose(100.0, 0.0))
    assert not far.converged
    assert far.inlier_ratio == 0.0
    assert np.isinf(far.covariance).all()
    empty = ClassPoints.joined([])
    with pytest.raises(SemlocError, match=r"0 points on \d+"):
        align_points(empty, road(), np.eye(4))
    with pytest.raises(SemlocError, match="NaN"):
        align_points(road(), road(), np.full((4, 4), np.nan))
