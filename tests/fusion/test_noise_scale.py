"""How large the errors of measured poses are and how long they hold, learned from series with known errors."""

import numpy as np
import pytest

from semloc_jax.fusion.kalman import KalmanFusion
from semloc_jax.fusion.measurements import PoseMeasurement
from semloc_jax.fusion.noise_scale import (
    DIRECTIONS,
    NoiseConfig,
    contour_distance_m,
    correlation_m,
    factors,
    learned,
    of_a_series,
    of_one_pose,
    unknown_noise,
    without_poses,
)
from semloc_jax.geometry import rigid
from tests.fusion.fusion_drive import STEP_S, error, increment, true_poses

MODEL = np.diag([0.10, 0.03, 0.02, 0.002, 0.002, 0.003]) ** 2
CONFIG = NoiseConfig(share=1.0)


def driven(scale, length_m, num=500, seed=0):
    """A filter on a drive of about a metre a frame whose measured poses are off by `scale` sigmas of the noise model,
    the same over `length_m`: what was learned, and the normalised squared errors of the fused poses."""
    rng, poses = np.random.default_rng(seed), true_poses(num)
    rho = np.exp(-1.0 / length_m) if length_m > 0 else 0.0
    fusion, noise, off = KalmanFusion(), unknown_noise(), rng.normal(size=6)
    state, squares = None, []
    for k, T in enumerate(poses):
        off = rho * off + np.sqrt(1.0 - rho**2) * rng.normal(size=6)
        measurement = PoseMeasurement(k * STEP_S, T @ rigid.exp(scale * off * np.sqrt(np.diag(MODEL))), MODEL)
        if state is None:
            state = fusion.start(measurement)
            continue
        step = increment(k - 1, rng)
        state = fusion.predict(state, step)
        alone = of_one_pose(MODEL, noise, CONFIG)
        state, _ = fusion.correct(state, measurement._replace(covariance=of_a_series(alone, 1.0, noise, CONFIG)))
        fused = fusion.pose(state)
        noise = learned(noise, measurement, fused, step, 1.0, CONFIG)
        e = error(fused.T_map_base, T)[DIRECTIONS]
        squares.append(e @ np.linalg.solve(fused.covariance[np.ix_(DIRECTIONS, DIRECTIONS)], e) / 3.0)
    return noise, np.array(squares[100:])


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
def test_errors_other_than_the_noise_model_are_found(scale):
    noise, squares = driven(scale, 0.0)
    # The noise model itself counts as some frames.
    believed, seen = CONFIG.believed_frames, CONFIG.memory_frames
    expected = (believed + seen * scale**2) / (believed + seen)
    assert factors(noise, CONFIG) == pytest.approx(expected, rel=0.45)
    assert correlation_m(noise, CONFIG).max() < 1.0
    assert 0.5 < squares.mean() < 1.6


def test_errors_that_stay_the_same_for_metres_are_found_and_do_not_make_a_filter_too_sure():
    noise, squares = driven(1.0, 3.0)
    assert 1.5 < np.median(correlation_m(noise, CONFIG)) < 6.0
    assert 0.4 < squares.mean() < 2.0
    # A filter that takes them for independent is too sure.
    assert of_a_series(MODEL, 1.0, noise, CONFIG)[0, 0] > 2.0 * MODEL[0, 0]


def test_a_vehicle_that_stands_learns_next_to_nothing():
    noise = unknown_noise()
    standing, driving = (of_a_series(MODEL, way_m, noise, CONFIG)[0, 0] / MODEL[0, 0] for way_m in (0.0, 5.0))
    assert standing > 60.0
    assert driving == pytest.approx(1.0, abs=0.02)


def test_poses_of_another_path_are_not_compared():
    noise, _ = driven(1.0, 0.0, num=20)
    far, T = without_poses(noise), rigid.exp(np.array([50.0, 0, 0, 0, 0, 0]))
    again = learned(far, PoseMeasurement(9.0, T, MODEL), KalmanFusion().pose(KalmanFusion().start(
        PoseMeasurement(9.0, T, MODEL))), increment(0), 1.0, CONFIG)  # fmt: skip
    assert np.array_equal(again.far, noise.far)
    assert np.array_equal(factors(again, CONFIG), factors(noise, CONFIG))


def test_contours_far_ahead_are_one_measurement_for_longer():
    """Poses that a map 32 m ahead held were off by the same 13 cm and 0.2 deg for 20 frames; taken for new in each of
    them, they made a pose six times too sure."""
    fresh, shared = unknown_noise(), []
    for distance_m in (8.0, 32.0):
        seen = np.diag([1.0, 0.0, 1.0, 1.0, 1.0, 0.0]) * 1e-4
        across, heading = np.array([0, 1, 0, 0, 0, distance_m]), np.array([0, 0, 0, 0, 0, 1.0])
        jacobian = np.stack([across, heading])[:, [1, 5]]
        own = np.linalg.inv(jacobian.T @ np.diag([1 / 0.02**2, 1 / 0.003**2]) @ jacobian)
        seen[np.ix_([1, 5], [1, 5])] = own
        assert contour_distance_m(seen) == pytest.approx(distance_m)
        shared.append(np.diagonal(of_a_series(seen, 1.1, fresh, CONFIG)) / np.diagonal(seen))
    near, far = shared
    assert (far > 8.0 * near).all()
