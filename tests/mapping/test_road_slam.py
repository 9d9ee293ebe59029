"""Road-SLAM: marks told apart by a forest that a seed grows, sub-maps met by two marks at a time, loops of a ring."""

import builtins

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid
from semloc_jax.mapping.literature.mark_forest import ForestConfig, MarkForest, simulated_marks
from semloc_jax.mapping.literature.mark_pairs import MarkPairsConfig, SeenMark, merged, motion_by_pairs
from semloc_jax.mapping.literature.road_slam import MarkMaps, RoadSlamConfig, matched
from semloc_jax.mapping.revisits import Revisit
from semloc_jax.simulation.mark_samples import MarkKind, mark_sample
from tests.mapping.mark_scores import f1_scores
from tests.mapping.ring_of_points import LAP, ring_maps

CONFIG = MarkPairsConfig()
SIGMA = np.array([1.0, 1.0, 0.03])


def scattered(num=8, seed=0):
    rng = np.random.default_rng(seed)
    kinds = rng.integers(0, 3, num)
    xy = rng.uniform(-15, 15, (num, 2))
    return [SeenMark(k, int(kinds[k]), xy[k], 3) for k in range(num)]


def test_a_seed_gives_the_same_marks_of_every_class():
    for kind in MarkKind:
        one, again, other = (mark_sample(kind, np.random.default_rng(seed)) for seed in (3, 3, 4))
        np.testing.assert_array_equal(one, again)
        assert len(one) >= 50
        assert one.shape != other.shape or np.abs(one - other).max() > 0.0


@pytest.mark.slow
def test_a_small_forest_tells_most_marks_apart_and_is_the_same_for_a_seed():
    pytest.importorskip("sklearn", reason="scikit-learn, the extra roadslam, is not installed")
    config = ForestConfig(num_samples=25, num_trees=40)
    marks, true = simulated_marks(8, seed=1)
    forest = MarkForest.grown(config)
    found = forest.kinds(marks)
    assert np.mean(found == true) > 0.75  # 0.975 with the 400 marks a class of the defaults, see FIGURES
    np.testing.assert_array_equal(found, MarkForest.grown(config).kinds(marks))
    assert len(forest.kinds([])) == 0


def test_without_scikit_learn_one_line_says_what_to_install(monkeypatch):
    imported = builtins.__import__

    def refused(name, *args, **kwargs):
        if name.startswith("sklearn"):
            raise ImportError(name)
        return imported(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refused)
    with pytest.raises(SemlocError, match=r"pip install 'semloc-jax\[roadslam\]'"):
        MarkForest.grown()


def test_scores_of_a_class_are_those_of_the_book():
    a, n = int(MarkKind.ARROW), int(MarkKind.NUMBER)
    scores = f1_scores(np.array([a, a, a, n]), np.array([a, a, n, n]))
    assert scores[MarkKind.ARROW] == pytest.approx((3, 1.0, 2 / 3, 0.8))
    assert scores[MarkKind.NUMBER] == pytest.approx((1, 0.5, 1.0, 2 / 3))
    assert MarkKind.CROSSWALK not in scores


def test_the_motion_between_sub_maps_is_found_among_false_marks():
    T = rigid.planar_pose(1.2, -0.8, 0.04)
    target = scattered()
    noise = 0.05 * np.random.default_rng(1).normal(size=(len(target), 2))
    source = [mark.moved(rigid.inverse(T))._replace(xy=mark.moved(rigid.inverse(T)).xy + e)
              for mark, e in zip(target, noise, strict=True)]  # fmt: skip
    source += scattered(4, seed=9)
    found = motion_by_pairs(source, target, np.eye(4), SIGMA, CONFIG)
    off = rigid.log(rigid.inverse(T) @ found)
    assert np.hypot(*off[:2]) < 0.15
    assert abs(off[5]) < 0.02


def test_a_motion_far_from_the_odometry_is_no_hypothesis():
    target = scattered()
    source = [mark.moved(rigid.planar_pose(8.0, 0.0)) for mark in target]
    assert motion_by_pairs(source, target, np.eye(4), SIGMA, CONFIG) is None
    other = [mark._replace(kind=mark.kind + 3) for mark in target]
    assert motion_by_pairs(other, target, np.eye(4), SIGMA, CONFIG) is None


def test_sightings_become_marks_and_single_ones_do_not():
    at = np.array([5.0, 1.0])
    seen = [SeenMark(k, 0, at + [0.1 * k, 0.0], 1) for k in range(3)]
    (mark,) = merged([*seen, SeenMark(4, 1, at, 1), SeenMark(5, 0, at + 4.0, 1)])
    assert (mark.num_seen, mark.frame) == (3, 0)
    np.testing.assert_allclose(mark.xy, [5.1, 1.0])


def test_sub_maps_of_two_rounds_are_a_loop_and_other_places_are_none():
    maps, poses, chain = ring_maps()
    config = RoadSlamConfig()
    maps = type(maps)(chain, maps.frames, maps.points, config.points)
    rng = np.random.default_rng(2)
    world = [(poses[k] @ np.append(rng.uniform(-4, 4, 2), [0.0, 1.0]))[:2] for k in range(0, LAP, 2)]
    marks = []
    for k in maps.frames:
        for number, xy in enumerate(world):
            own = (rigid.inverse(poses[k]) @ np.append(xy, [0.0, 1.0]))[:2]
            if np.linalg.norm(own) < 8.0:
                marks.append(SeenMark(int(k), number % 3, own + 0.03 * rng.normal(size=2), 1))
    seen = MarkMaps(maps, marks)
    covariance = np.diag([0.5, 0.5, 0.1, 0.01, 0.01, 0.03]) ** 2
    a, b = 25, 25 + LAP
    T_a_b = rigid.inverse(poses[a]) @ poses[b]
    loop = matched(
        seen, Revisit(a, b, (b - 1, b, b + 1), covariance), T_a_b @ rigid.planar_pose(0.6, -0.4, 0.02), config
    )
    off = rigid.log(rigid.inverse(T_a_b) @ loop.T_a_b)
    assert np.hypot(*off[:2]) < 0.25
    assert loop.reasons == () or "of the points have a partner" in loop.reasons[0]
    wrong = matched(seen, Revisit(a - LAP // 2, b, (b - 1, b, b + 1), covariance), np.eye(4), config)
    assert not wrong.is_accepted
    nothing = MarkMaps(maps, marks[:1])
    assert matched(nothing, Revisit(a, b, (b - 1, b, b + 1), covariance), T_a_b, config) is None
