"""Landmarks associated with explicit shapes: one frame in masks, a start from one sign, honest covariances."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.alignment.explicit.association import associated
from semloc_jax.alignment.explicit.factors import KINDS, On, row_of
from semloc_jax.alignment.explicit.frame import ExplicitConfig, SeenShapes, explicit_frame
from semloc_jax.alignment.explicit.landmarks import compact_landmarks
from semloc_jax.alignment.explicit.pose import ExplicitPose
from semloc_jax.alignment.explicit.prediction import AssociationConfig, Prediction, offsets
from semloc_jax.alignment.explicit.sights import shape_sights
from semloc_jax.alignment.explicit.start import explicit_starts
from semloc_jax.bench.compact_world import CompactWorld, WorldConfig
from semloc_jax.datasets import open_drive
from semloc_jax.geometry import rigid
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.maps import read_map
from semloc_jax.perception.primitives import primitives_of
from semloc_jax.residuals.seen_point import PointSight, seen_beside
from semloc_jax.structs import ElementClass, SolveStatus

CONFIG = ExplicitConfig(association=AssociationConfig(map_sigma_m=0.05))
NEAR = np.array([0.3, 0.15, 0.03, 0.005, 0.005, 0.005])
WIDE = np.array([2.0, 2.0, 0.03, 0.009, 0.009, 0.05])


@pytest.fixture(scope="module")
def world():
    return CompactWorld(WorldConfig(road_m=600.0), 4)


def places(num):
    return np.linspace(80.0, 520.0, num)


def around(landmarks, T):
    return [mark for mark in landmarks if np.linalg.norm(mark.middle - T[:3, 3]) < 90.0]


def test_offsets_are_those_of_the_residuals(world):
    """The association in numpy and the residuals in JAX look alike, derivatives included."""
    T = world.pose(100.0)
    sight = shape_sights([world.detections(T, None)], world.rig)[-1]
    points = T[:3, 3] + np.array([[12.0, 1.0, 2.0], [20.0, -3.0, 0.5]])
    sights = PointSight(*(leaf[:2] for leaf in sight.sights))
    found = offsets(T, points, sights)

    def seen(pose, k):
        one = PointSight(*(jnp.asarray(leaf[k]) for leaf in sights))
        return seen_beside(jnp.asarray(pose), jnp.asarray(points[k]), one)

    for k in range(len(points)):
        off, distance_m = seen(T, k)
        np.testing.assert_allclose(found.off[k], off, rtol=1e-9)
        assert found.distance_m[k] == pytest.approx(float(distance_m))
        step = 1e-6 * np.eye(6)
        ends = [[seen(T @ rigid.exp(sign * d), k)[0] for sign in (1, -1)] for d in step]
        slope = np.array([(np.asarray(a) - np.asarray(b)) / 2e-6 for a, b in ends]).T
        np.testing.assert_allclose(found.by_pose[k], slope, atol=1e-3)


def test_all_shapes_of_a_frame_without_noise_are_their_landmarks(world):
    """From the true pose every shape is explained, and none is left over."""
    T, num = world.pose(200.0), 0
    seen = SeenShapes.by(world.rig, [world.detections(T, None)])
    certain = replace(CONFIG.association, clearly=-np.inf)
    for match in associated(Prediction(T, 1e-6 * np.eye(6), world.landmarks, world.rig, certain), seen.sights):
        name, row = row_of(match, world.landmarks[match.landmark], T, certain)
        cost = float(KINDS[name].factors([On(row)], 1).costs({"pose": T[None]})[0])
        # A cubic misses a curve by about its own standard deviation; the middle of an ellipse is not quite that of the
        # disc, and a post ends at a whole row.
        assert cost < {"corners": 1e-9, "lane": 1.5}.get(name, 0.07)
        num += 1
    assert num == len(seen.sights) >= 6


@pytest.mark.slow
def test_errors_of_single_frames_are_as_large_as_stated(world):
    """Twelve frames with 2 px and 5 cm of noise: mean square error over the stated variance, in the plane."""
    rng, squares, errors = np.random.default_rng(1), [], []
    for s in places(12):
        T = world.pose(s)
        marks = around(world.mapped, T)
        seen = SeenShapes.by(world.rig, [world.detections(T, rng)])
        start = ExplicitPose(
            T @ rigid.exp(NEAR * rng.normal(size=6)), np.diag(NEAR**2), np.zeros(0), SolveStatus.CONVERGED
        )
        prior = T @ rigid.exp(WIDE * rng.normal(size=6))
        found = explicit_frame(seen, marks, np.ones(len(marks), bool), prior, WIDE, CONFIG, start)
        off = rigid.log(rigid.inverse(T) @ found.pose.T_local_base)[[0, 1, 5]]
        errors.append(off)
        squares.append(off @ np.linalg.solve(found.pose.covariance[np.ix_([0, 1, 5], [0, 1, 5])], off) / 3.0)
    assert np.median(squares) < 1.5
    assert np.mean(squares) < 3.0
    assert np.median(np.linalg.norm(np.array(errors)[:, :2], axis=1)) < 0.25


@pytest.mark.slow
def test_one_sign_gives_a_start_metres_away(world):
    """Two metres and three degrees of doubt: at least two thirds of the frames with a sign start within half a metre,
    and what fits best is what is taken."""
    rng, found = np.random.default_rng(3), []
    for s in places(8):
        T = world.pose(s)
        seen = SeenShapes.by(world.rig, [world.detections(T, rng)])
        if not any(sight.label == ElementClass.SIGN for sight in seen.sights):
            continue
        answers = explicit_starts(seen, around(world.mapped, T), T @ rigid.exp(WIDE * rng.normal(size=6)), WIDE, CONFIG)
        assert [a.nats for a in answers] == sorted(a.nats for a in answers)
        best = answers[0].pose.T_local_base if answers else np.full((4, 4), np.inf)
        found.append(np.linalg.norm((best - T)[:2, 3]) < 0.5)
    assert len(found) >= 6
    assert np.mean(found) > 0.65


def test_a_shape_that_may_be_two_landmarks_waits(world):
    """Two lanes 20 cm apart: neither is taken while half a metre is open, both are once the pose is known."""
    T = world.pose(150.0)
    lanes = [mark for mark in around(world.landmarks, T) if mark.label == ElementClass.LANE_MARKING]
    double = [*lanes, *(mark._replace(points=mark.points + 0.2 * T[:3, 1]) for mark in lanes)]
    sights = [
        sight
        for sight in shape_sights([world.detections(T, None)], world.rig)
        if sight.label in (ElementClass.LANE_MARKING, ElementClass.SIGN)
    ]
    signs = [mark for mark in around(world.landmarks, T) if mark.label == ElementClass.SIGN]
    alone = replace(CONFIG.association, map_sigma_m=0.01)

    def matched(sigma_m):
        covariance = np.diag([sigma_m, sigma_m, 0.01, 0.001, 0.001, 0.001]) ** 2
        found = associated(Prediction(T, covariance, [*double, *signs], world.rig, alone), sights)
        return {match.landmark for match in found if match.sight.label == ElementClass.LANE_MARKING}

    assert matched(0.5) == set()
    known = matched(0.01)
    assert known and max(known) < len(lanes)


@pytest.mark.parametrize("masks", ["sem", "sem_net"])
def test_a_simulated_drive_is_localized_by_shapes(simulated_road, masks):
    """Masks to pose: centimetres across, decimetres along where little stands; and the start is told by evidence."""
    drive = open_drive(simulated_road)
    semantic_map, source = read_map(drive.map_path), mask_source(masks, drive)
    rng, off = np.random.default_rng(7), []
    for frame in drive.frames[::2]:
        T = drive.truth_at(frame)
        local_map = semantic_map.query(T[:3, 3], 70.0)
        landmarks = compact_landmarks(local_map)
        shown = [primitives_of(mask, source.table) for mask in source.masks(frame)]
        rig = source.seen_by(frame.rig.select(source.cameras))
        T_local = local_map.frame.from_map(T, np.float64)
        prior = T_local @ rigid.exp(NEAR * rng.normal(size=6))
        found = explicit_frame(
            SeenShapes.by(rig, shown), landmarks, np.ones(len(landmarks), bool), prior, NEAR, ExplicitConfig()
        )
        off.append(rigid.log(rigid.inverse(T_local) @ found.pose.T_local_base))
        assert len(found.matches) >= 3
    along, across, yaw = np.median(np.abs(off), axis=0)[[0, 1, 5]]
    assert across < 0.06
    assert along < 0.25
    assert np.degrees(yaw) < 0.2
