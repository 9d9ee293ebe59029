"""Errors over time: the numbers drawn are those of the evaluation, limits and misses are visible."""

import numpy as np
import pytest
from matplotlib.colors import to_rgba

from semloc_jax import viz
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import Trajectory
from semloc_jax.viz.trajectory import INSIDE, OUTSIDE


def _drive(count: int = 20) -> Trajectory:
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, 0, 3] = np.arange(count)
    return Trajectory(0.1 * np.arange(count), T)


def _moved(lateral_m: np.ndarray) -> Trajectory:
    T = _drive(len(lateral_m)).T_map_base.copy()
    T[:, 1, 3] += lateral_m
    return Trajectory(0.1 * np.arange(len(lateral_m)), T)


def _dots(axes, colour: str) -> np.ndarray:
    parts = [c.get_offsets() for c in axes.collections if len(c.get_facecolor()) and hasattr(c, "get_sizes")]
    colours = [c.get_facecolor()[0] for c in axes.collections if len(c.get_facecolor()) and hasattr(c, "get_sizes")]
    chosen = [np.asarray(p) for p, c in zip(parts, colours, strict=True) if np.allclose(c, to_rgba(colour))]
    return np.vstack(chosen) if chosen else np.zeros((0, 2))


def test_errors_are_drawn_and_those_beyond_the_limit_are_red():
    lateral = np.linspace(-0.1, 0.1, 20)
    lateral[7] = 0.35
    lateral[12] = 40.0
    figure = viz.errors_over_time(_moved(lateral), _drive(), missed_s=[0.4])
    axes = figure.axes[0]
    inside, outside = _dots(axes, INSIDE), _dots(axes, OUTSIDE)
    keep = np.abs(lateral) <= 0.29
    np.testing.assert_allclose(inside[:, 1], lateral[keep], atol=1e-12)
    np.testing.assert_allclose(np.sort(outside[:, 0]), [0.7, 1.2], atol=1e-9)
    low, high = axes.get_ylim()
    assert high < 1.0, "one wild pose does not flatten the rest"
    assert low == -high
    assert [row.get_ylabel() for row in figure.axes] == ["lateral [m]", "longitudinal [m]", "heading [deg]"]
    assert "limit ±0.29 m" in axes.get_title(loc="right")


def test_trajectories_of_different_clocks_are_refused():
    reference = _drive()
    late = Trajectory(reference.time_s + 100.0, reference.T_map_base)
    with pytest.raises(SemlocError, match="expected the same clock"):
        viz.errors_over_time(late, reference)


def test_pictures_are_written_and_bad_paths_are_refused(tmp_path):
    figure = viz.errors_over_time(_moved(np.zeros(20)), _drive())
    path = viz.save(figure, tmp_path / "errors.png")
    assert path.stat().st_size > 5000
    with pytest.raises(SemlocError, match="in a folder that exists"):
        viz.save(figure, tmp_path / "missing" / "errors.png")
