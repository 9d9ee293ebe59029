"""The benchmark's problem: the same for everyone, solvable, and judged by centimetres and degrees that are right."""

import struct
from functools import cache

import numpy as np
import pytest

from semloc_jax.bench.host_model import LevelModel
from semloc_jax.bench.problem import (
    FULL_LEVELS,
    MAGIC,
    STRIDE,
    displacement,
    make_problem,
    read_problem,
    to_binary,
    write_problem,
)
from semloc_jax.errors import SemlocError

small = cache(make_problem)


def test_the_seed_decides_everything():
    one, other = make_problem(200, 3), make_problem(200, 3)
    assert to_binary(one) == to_binary(other)
    assert np.array_equal(one.starts(7), other.starts(7))
    assert to_binary(one) != to_binary(make_problem(200, 4))


def test_it_is_the_problem_of_the_design():
    problem = small(1000)
    assert problem.p_map.shape == (3, 1000)
    assert [image.shape for image in problem.images] == [(3, 400 // s, 640 // s) for s in STRIDE]
    assert np.bincount(problem.channel).min() > 50, "all three classes are in view"
    # Everybody's pixels are multiples of 1/127: what ours holds in eight bits the others hold exactly.
    steps = problem.images[0] * 127
    assert np.abs(steps - np.round(steps)).max() < 1e-4


def test_fewer_starts_are_the_first_of_more():
    problem = small(200)
    assert np.array_equal(problem.starts(5), problem.starts(5000)[:5])
    off = np.linalg.inv(problem.T_true) @ problem.starts(500)
    assert 3.9 < np.abs(off[:, 0, 3]).max() <= 4.0
    assert 1.9 < np.abs(off[:, 1, 3]).max() <= 2.0
    yaw = np.degrees(np.arctan2(off[:, 1, 0], off[:, 0, 0]))
    assert 4.8 < np.abs(yaw).max() < 5.1


def test_contours_lie_on_the_mask_boundaries_at_the_truth():
    problem = small(1000)
    fine = LevelModel(problem, FULL_LEVELS[-1], problem.T_true)
    value = fine.residual(np.zeros(6))[:-6] / fine.root.max()
    # The ramp of the finest level is 3 px: a point is half a pixel off at the median, for masks are whole pixels.
    assert np.median(np.abs(value)) * problem.ramp_px[-1] < 0.5
    moved = LevelModel(problem, FULL_LEVELS[-1], problem.T_true @ displacement(np.array([[0, 0.3, 0, 0, 0, 0]]))[0])
    assert np.sum(moved.residual(np.zeros(6))[:-6] ** 2) > 3 * np.sum(fine.residual(np.zeros(6))[:-6] ** 2)


@pytest.mark.parametrize(
    ("xi", "is_close"), [((0.19, 0), True), ((0.21, 0), False), ((0, 0.19), True), ((0, 0.21), False)]
)
def test_success_is_within_a_fifth_of_a_metre_and_of_a_degree(xi, is_close):
    problem = small(200)
    off = displacement(np.array([[xi[0] * 0.6, xi[0] * 0.8, 0, 0, 0, np.deg2rad(xi[1])]]))
    assert problem.succeeded(problem.T_true @ off)[0] == is_close
    distance, angle = problem.errors((problem.T_true @ off).astype(np.float32))
    assert distance[0] == pytest.approx(xi[0], abs=2e-6)
    assert angle[0] == pytest.approx(xi[1], abs=1e-4)


def test_files_hold_the_same_problem(tmp_path):
    problem = small(200)
    write_problem(problem, tmp_path / "p.npz")
    back = read_problem(tmp_path / "p.npz")
    assert to_binary(back) == to_binary(problem)
    raw = (tmp_path / "p.bin").read_bytes()
    assert struct.unpack("<2i", raw[:8]) == (MAGIC, 200)
    assert len(raw) == 4 * (8 + 4 * 4) + 8 * (12 + 48 + 4) + 4 * (5 * 200 + sum(i.size for i in problem.images))


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(SemlocError, match="no such file"):
        read_problem(tmp_path / "none.npz")
