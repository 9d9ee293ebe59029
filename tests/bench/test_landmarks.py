"""A window with shared landmarks on a simulated road: errors beside the bound, covariances that hold."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.alignment.explicit.prediction import AssociationConfig
from semloc_jax.bench.compact_world import WorldConfig
from semloc_jax.bench.landmarks import Bounds, Driven, DrivenFrame, LandmarkPlan, drive_all
from semloc_jax.fusion.landmark_window import WindowFrame, WindowSize, bound_of, last_pose
from semloc_jax.reports.landmarks import numbers_in_view, report_landmarks, roads

SMALL = LandmarkPlan(
    roads_m=(600.0,),
    seeds=(4,),
    num_frames=16,
    window=WindowSize(6, 48, 10),
    bound_every=3,
)


@pytest.fixture(scope="module")
def driven():
    (drive,) = drive_all(SMALL, lambda _: None)
    return drive


@pytest.mark.slow
def test_the_window_is_near_its_bound_and_says_how_near(driven):
    """Sixteen frames of a dense road: 10 cm, within twice the bound (few frames), NEES of a plane."""
    errors = np.array([frame.window_error_m for frame in driven.frames])
    bounds = [np.trace(frame.bounds.window) for frame in driven.frames if frame.bounds]
    rms_m = np.sqrt(np.mean(np.sum(errors**2, axis=1)))
    assert rms_m < 0.10
    assert 0.4 < rms_m / np.sqrt(np.mean(bounds)) < 2.0
    squares = [f.window_error_m @ np.linalg.solve(f.window_covariance, f.window_error_m) / 2 for f in driven.frames]
    assert np.mean(squares) < 2.5


@pytest.mark.slow
def test_bounds_fall_with_what_is_known(driven):
    """A window knows more than its last frame; both know no less than is stated."""
    for frame in driven.frames:
        if frame.bounds is not None:
            assert np.all(np.linalg.eigvalsh(frame.bounds.alone - frame.bounds.window) > -1e-9)
            assert np.trace(frame.window_covariance) > 0.5 * np.trace(frame.bounds.window)


@pytest.mark.slow
def test_a_window_without_landmarks_is_its_fixes():
    """Exact odometry makes three fixes one, of a third of the variance."""
    size, sigma = WindowSize(3, 8, 1), np.array([1.0, 1.0, 0.1, 0.01, 0.01, 0.1])
    motion = np.eye(4)
    motion[0, 3] = 3.0
    frames, T = [], np.eye(4)
    for _ in range(3):
        frames.append(WindowFrame((), T, motion, 1e4 * np.eye(6), T, np.diag(1.0 / sigma)))
        T = T @ motion
    config = AssociationConfig(map_sigma_m=0.05)
    found = last_pose(frames, (), config, size)
    np.testing.assert_allclose(found.T_local_base, frames[-1].T_local_base, atol=1e-9)
    covariance = bound_of(frames, (), config, size)
    assert covariance[0, 0] == pytest.approx(1.0 / 3.0, rel=1e-3)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-6, atol=1e-12)


def test_rows_are_root_mean_squares_over_bounds():
    """Frames 3 cm off each way, bounds of 2 and 4 cm each way; those without bounds do not count."""
    off, unit = np.array([0.03, -0.03]), np.eye(2)
    frame = DrivenFrame(4, off, 2 * off, 0.03**2 * unit, Bounds(0.02**2 * unit, 0.04**2 * unit))
    driven = [Driven(500.0, seed, (frame, frame._replace(bounds=None)), 0) for seed in (0, 1)]
    row, total = roads(driven)
    assert (row.group, row.num_frames, row.in_view) == ("500 m", 2, 4.0)
    assert total == row._replace(group="all")
    assert row.window_m == pytest.approx(np.sqrt(2) * 0.03)
    assert (row.window_ratio, row.alone_ratio, row.nees) == pytest.approx((1.5, 1.5, 1.0))
    assert [row.group for row in numbers_in_view(driven)] == ["3 .. 4"]


@pytest.mark.slow
def test_the_report_names_what_was_measured(tmp_path):
    plan = replace(SMALL, num_frames=4, world=WorldConfig())
    text = report_landmarks(plan, tmp_path / "rows.json", tmp_path / "rows.png", lambda _: None)
    assert "54 signs, 136 posts" in text and "2 px, 5 cm on the map" in text
    assert (tmp_path / "rows.png").stat().st_size > 10_000
    assert '"window_bound_m"' in (tmp_path / "rows.json").read_text()
