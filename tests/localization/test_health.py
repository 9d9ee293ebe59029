"""When a pose is trusted, when the vehicle is lost, which elements of the map are not believed."""

import numpy as np
import pytest

from semloc_jax.alignment.longitudinal import LongitudinalConfig, is_searched
from semloc_jax.alignment.pose_prior import RoadSigmas
from semloc_jax.fusion.inertial_fusion import InertialFusion
from semloc_jax.fusion.measurements import FusedPose, GnssMeasurement, Innovation, PoseMeasurement
from semloc_jax.geometry import rigid
from semloc_jax.localization import health, map_faults
from semloc_jax.localization.beginning import regained
from semloc_jax.localization.following import FollowConfig, FrameReport, stance_after
from semloc_jax.localization.frame_alignment import Alignment, masks_covariance
from semloc_jax.localization.health import HealthConfig
from semloc_jax.localization.map_faults import TrustConfig
from semloc_jax.localization.predicting import conflicts_after
from semloc_jax.localization.track_state import TrackStatus
from semloc_jax.maps import MapElement, SemanticMap
from semloc_jax.structs import ElementClass, SolveStatus


def alignment(**changes) -> Alignment:
    good = Alignment(
        PoseMeasurement(0.0, np.eye(4), 1e-4 * np.eye(6)),
        *(SolveStatus.CONVERGED, 0.3, 0.7, 0.8, 10.0, np.inf, 2000.0, 0.0),
        *(np.ones(6), np.zeros(3), np.zeros(3)),
    )
    return good._replace(**changes)


def test_a_good_frame_has_no_problems():
    assert health.frame_problems(alignment(), 0.9, HealthConfig()) == (False, ())


@pytest.mark.parametrize(
    ("changes", "usable", "is_occluded"),
    [
        ({"cost": 0.95}, 0.9, False),
        ({"inlier_ratio": 0.1}, 0.9, False),
        ({"coverage": 0.05}, 0.9, True),
        ({"status": SolveStatus.NO_EVIDENCE}, 0.9, True),
        ({}, 0.1, True),
        ({"cost": 0.95}, 0.0, True),  # masks of one class: nothing is contradicted
        ({"in_view_px": 50.0}, 0.9, True),
        ({"status": SolveStatus.NOT_FINITE}, 0.9, False),
    ],
)
def test_what_speaks_against_a_frame_is_said(changes, usable, is_occluded):
    found = health.frame_problems(alignment(**changes), usable, HealthConfig())
    assert found[0] == is_occluded
    assert len(found[1]) == 1


def frames(counters, num, occluded, accepted):
    for _ in range(num):
        counters = health.counted(counters, occluded, accepted)
    return counters


def test_the_papers_three_rules_say_lost():
    config = HealthConfig()
    start = health.no_counts()
    assert health.lost_because(start, config) == ()
    failed = frames(start, 9, False, False)
    assert health.lost_because(failed, config) == ("9 alignments failed",)
    assert "occluded" in health.lost_because(frames(start, 41, True, False), config)[0]
    assert health.lost_because(start._replace(off_map=np.float64(5.0)), config) == ("outside of the map",)
    assert health.lost_because(frames(failed, 4, False, True), config) == ()  # good frames take failures back


def fix_at(x_m, accepted):
    pose = FusedPose(0.0, np.eye(4), 1e-4 * np.eye(6), 1.0, 0.0, np.zeros(2))
    return GnssMeasurement(0.0, np.array([x_m, 0.0, 0.0]), np.full(3, 1.3)), Innovation(9.0, 2, accepted), pose


def test_three_fixes_elsewhere_contradict_one_outlier_does_not():
    config = HealthConfig()
    outlier = conflicts_after(0, [fix_at(20.0, False), fix_at(1.0, True), fix_at(20.0, False)], config)
    assert outlier == 1
    carried_off = conflicts_after(0, [fix_at(30.0, False)] * 3, config)
    counters = health.no_counts()._replace(conflicts=carried_off)
    assert health.lost_because(counters, config) == ("3 satellite fixes in a row contradict the pose",)
    assert conflicts_after(0, [fix_at(4.0, False)] * 3, config) == 0.0  # metres are what fixes are off by


def test_status_follows_tracks_and_reasons():
    assert health.status_of(2, True, ()) == TrackStatus.INITIALIZING
    assert health.status_of(1, False, ()) == TrackStatus.INITIALIZING
    assert health.status_of(1, True, ("why",)) == TrackStatus.DEGRADED
    assert health.status_of(1, True, ()) == TrackStatus.TRACKING


def test_a_view_without_innovation_is_not_accepted():
    assert not FrameReport(None, True, False, ("occluded",)).is_accepted


def test_the_masks_share_of_an_estimate_is_what_the_prediction_did_not_bring():
    """Gaussians: information adds, so taking the prediction's off again leaves that of masks and road."""
    rng = np.random.default_rng(0)
    A = rng.normal(size=(6, 6))
    sigma = np.array([0.3, 0.2, 0.03, 0.01, 0.01, 0.02])
    masks = (A @ A.T + 6 * np.eye(6)) / np.outer(sigma, sigma)
    estimate = np.linalg.inv(masks + np.diag(1 / sigma**2))
    road = np.diag([0.0, 0.0, 1.0, 1.0, 1.0, 0.0]) / sigma**2
    found = masks_covariance(estimate, sigma, 1e-6)
    np.testing.assert_allclose(found, np.linalg.inv(masks + road), rtol=1e-9)


def test_a_direction_that_only_the_prediction_held_is_left_wide():
    sigma = np.full(6, 0.1)
    information = np.diag([0.0, 400.0, 400.0, 400.0, 400.0, 400.0])
    covariance = np.linalg.inv(information + np.diag(1 / sigma**2))
    found = masks_covariance(covariance, sigma, 1e-3)
    assert np.sqrt(found[0, 0]) == pytest.approx(0.1 / np.sqrt(1e-3))
    assert np.sqrt(found[1, 1]) == pytest.approx(1 / 20.0)


def test_the_road_is_searched_where_information_is_missing():
    config = LongitudinalConfig()
    assert not is_searched(0.02, 0.03, config)
    assert is_searched(0.5, 0.03, config)  # the prediction may be farther off than a solve can bridge
    assert is_searched(0.02, 0.4, config)  # the masks of the last frame held nothing along the road


def test_a_lasting_tilt_is_learned_and_a_weak_view_hardly_moves_it():
    measured, road, config = np.array([0.0, 0.0, np.deg2rad(1.0)]), RoadSigmas(), FollowConfig()
    sharp, weak = 1e-8 * np.eye(6), 1.0 * np.eye(6)
    stance = np.zeros(3)
    for _ in range(50):
        stance = stance_after(stance, measured, sharp, road, config)
    assert np.degrees(stance[2]) == pytest.approx(1.0, abs=0.01)
    assert abs(np.degrees(stance_after(np.zeros(3), measured, weak, road, config)[2])) < 1e-3
    for _ in range(200):
        stance = stance_after(stance, 10 * measured, sharp, road, config)
    assert np.degrees(stance[2]) == pytest.approx(config.max_tilt_deg)


def test_a_track_that_is_found_again_keeps_what_dead_reckoning_knows():
    """Velocity and biases are those of before the map was lost, unless the pose contradicts dead reckoning."""
    fusion, moving = InertialFusion(), np.array([12.0, 0.0, 0.0])
    coasting = fusion.start(PoseMeasurement(0.0, np.eye(4), 1e-2 * np.eye(6)))
    known = coasting.covariance.copy()
    known[6:9, 6:9] = 0.01 * np.eye(3)
    coasting = coasting._replace(velocity_map=moving, covariance=known)
    for ahead_m, is_kept in ((0.1, True), (5.0, False)):
        found = PoseMeasurement(0.0, rigid.exp(np.array([ahead_m, 0, 0, 0, 0, 0])), 1e-2 * np.eye(6))
        track = regained(fusion, coasting, found, 0.5)
        assert np.allclose(track.fusion.velocity_map, moving if is_kept else 0.0)
        assert track.fusion.T_map_base[0, 3] == pytest.approx(0.5 * ahead_m if is_kept else ahead_m)
        assert int(track.num_accepted) == 0 and float(track.penalty) == 0.5


def three_elements() -> SemanticMap:
    lines = [np.array([[0.0, y, 0.0], [10.0, y, 0.0]]) for y in (0.0, 3.5, 7.0)]
    return SemanticMap(tuple(MapElement(f"line_{k}", ElementClass.LANE_MARKING, p) for k, p in enumerate(lines)))


def test_an_element_that_every_frame_contradicts_is_reported_and_hardly_counts():
    config, trust = TrustConfig(), map_faults.full_trust(3)
    rng = np.random.default_rng(0)
    for _ in range(12):
        visible = np.array([100.0, 100.0, 0.0])
        missed = np.array([20.0 + 20.0 * rng.uniform(), 95.0, 0.0])
        trust = map_faults.updated(trust, visible, missed, config)
    weights = map_faults.weights(trust, config)
    np.testing.assert_allclose(weights, [1.0, config.least_weight, 1.0])
    changes = map_faults.map_changes(trust, three_elements(), config)
    assert [(c.element_id, c.num_frames) for c in changes] == [("line_1", 12)]
    assert changes[0].missed_share == pytest.approx(0.95)


def test_only_elements_that_were_in_view_are_kept_and_the_others_count_in_full():
    """The same numbers as for a map of three, whatever lies before, between and behind them."""
    config, rng = TrustConfig(), np.random.default_rng(1)
    small, large = map_faults.full_trust(3), map_faults.full_trust(1_000_000)
    rows = np.array([17, 500_000, 999_999])
    for k in range(12):
        visible = np.where(rng.random(3) < 0.7, rng.uniform(5.0, 200.0, 3), 0.0)
        missed = rng.uniform(0.6, 1.0, 3) * visible
        small = map_faults.updated(small, visible, missed, config)
        order = rng.permutation(3)
        chosen = order[: 1 + k % 3]  # who is not named is not in view
        left_out = np.setdiff1d(order, chosen)
        large = map_faults.updated(large, visible[chosen], missed[chosen], config, rows[chosen])
        large = map_faults.updated(large, visible[left_out], missed[left_out], config, rows[left_out])
    assert large.rows.tolist() == rows.tolist()
    for name in ("seen_px", "missed_px", "num_frames"):
        np.testing.assert_array_equal(getattr(large, name), getattr(small, name), err_msg=name)
    asked = np.array([999_999, 5, 17, 500_000, 500_001])
    expected = map_faults.weights(small, config)
    found = map_faults.weights(large, config, asked)
    np.testing.assert_array_equal(found, [expected[2], 1.0, expected[0], expected[1], 1.0])
    assert expected.min() < 0.9


def test_one_bad_frame_takes_no_trust():
    config = TrustConfig()
    trust = map_faults.updated(map_faults.full_trust(3), np.full(3, 100.0), np.full(3, 100.0), config)
    np.testing.assert_array_equal(map_faults.weights(trust, config), 1.0)
