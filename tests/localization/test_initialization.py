"""Priors from satellite fixes and the driven path, sectors of heading, tiles of an area."""

import numpy as np
import pytest

from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.fusion.measurements import FusedPose, GnssMeasurement
from semloc_jax.fusion.prediction import MotionLog
from semloc_jax.geometry import rigid
from semloc_jax.localization.acquisition import AcquisitionConfig, places_around
from semloc_jax.localization.initialization import (
    NUM_FIXES,
    InitializationConfig,
    newest,
    no_fixes,
    prior_from_fixes,
    sectors,
    tile_priors,
    why_no_prior,
    with_fix,
)

HEADING, SPEED = 0.7, 10.0


def straight_log(yaw_rate=0.0):
    log = MotionLog()
    for t in np.arange(0.0, 6.0, 0.02):
        log.add_wheels(float(t), SPEED, yaw_rate)
    return log


def fixes_along(times, noise_m=0.0, sigma_m=1.3, seed=0):
    rng = np.random.default_rng(seed)
    fixes = no_fixes()
    for t in times:
        p = np.array([100.0, 50.0, 2.0]) + SPEED * t * np.array([np.cos(HEADING), np.sin(HEADING), 0.0])
        noise = np.append(noise_m * rng.normal(size=2), 0.0)
        fixes = with_fix(fixes, GnssMeasurement(float(t), p + noise, np.full(3, sigma_m)))
    return fixes


def test_exact_fixes_on_a_straight_road_give_position_and_heading():
    times = np.arange(0.0, 5.0, 0.2)
    prior = prior_from_fixes(fixes_along(times), straight_log(), 5.0, None, InitializationConfig())
    expected = np.array([100.0, 50.0]) + SPEED * 5.0 * np.array([np.cos(HEADING), np.sin(HEADING)])
    assert np.hypot(prior.x_m - expected[0], prior.y_m - expected[1]) < 0.01
    assert abs(np.degrees(prior.heading_rad - HEADING)) < 0.1
    assert prior.sigma_xy_m == pytest.approx(1.5 * 1.3 + 0.03 * 2.0, abs=0.01)  # inflated, and 2 m driven since


def test_noisy_fixes_lie_within_what_the_prior_says():
    times = np.arange(0.0, 5.0, 0.2)
    off = []
    for seed in range(20):
        prior = prior_from_fixes(
            fixes_along(times, noise_m=1.0, seed=seed), straight_log(), 5.0, None, InitializationConfig()
        )
        off.append((prior.heading_rad - HEADING) / prior.sigma_heading_rad)
    assert np.sqrt(np.mean(np.square(off))) < 1.0


@pytest.mark.parametrize(
    ("times", "sigma_m"), [([1.0], 1.3), ([1.0, 1.05], 1.3), ([0.0, 1.0, 2.0], 30.0)], ids=["one", "near", "vague"]
)
def test_too_little_is_no_prior(times, sigma_m):
    fixes = fixes_along(times, sigma_m=sigma_m)
    assert prior_from_fixes(fixes, straight_log(), times[-1], None, InitializationConfig()) is None


def test_fixes_after_the_frame_are_not_used():
    fixes = fixes_along([1.0, 2.0, 5.5])
    now = prior_from_fixes(fixes, straight_log(), 3.0, None, InitializationConfig())
    without = prior_from_fixes(fixes_along([1.0, 2.0]), straight_log(), 3.0, None, InitializationConfig())
    assert now == without


def test_the_buffer_keeps_order_and_length():
    fixes = fixes_along([2.0, 1.0, 3.0])
    assert fixes.time_s[-3:].tolist() == [1.0, 2.0, 3.0]
    assert len(fixes.time_s) == NUM_FIXES
    assert np.isfinite(newest(fixes, 2).time_s).sum() == 2
    assert newest(fixes, 2).time_s[-1] == 3.0


def test_sectors_cover_a_vague_heading_and_leave_a_sure_one():
    config = InitializationConfig()
    sure = PosePrior(0.0, 0.0, 1.0, 1.0, np.deg2rad(5.0))
    assert sectors(sure, config) == [sure]
    found = sectors(PosePrior(0.0, 0.0, 1.0, 1.0, np.deg2rad(40.0)), config)
    turns = np.degrees([prior.heading_rad - 1.0 for prior in found])
    reach = 2.5 * config.sector_sigma_deg  # what a search covers to each side
    for wanted in np.linspace(-80.0, 80.0, 33):  # two sigmas
        assert np.abs(turns - wanted).min() <= reach
    assert turns[0] == 0.0


def test_tiles_leave_no_hole():
    tiles = tile_priors(np.array([5.0, -3.0]), 10.0, 4.0, 30.0)
    rng = np.random.default_rng(0)
    for _ in range(200):
        radius, angle = 10.0 * np.sqrt(rng.uniform()), rng.uniform(-np.pi, np.pi)
        place = np.array([5.0, -3.0]) + radius * np.array([np.cos(angle), np.sin(angle)])
        near = min(tiles, key=lambda tile: np.hypot(tile.x_m - place[0], tile.y_m - place[1]))
        assert max(abs(near.x_m - place[0]), abs(near.y_m - place[1])) <= 2.5 * near.sigma_xy_m
    headings = np.unique(np.round(np.degrees([tile.heading_rad for tile in tiles])))
    assert len(headings) == 12


def test_fixes_alone_start_a_vehicle_without_wheels():
    """Images, masks and satellites: the direction of travel is the heading, as surely as the fixes tell."""
    off = []
    for seed in range(20):
        fixes = fixes_along(np.arange(0.0, 5.0, 0.2), noise_m=0.3, seed=seed)
        prior = prior_from_fixes(fixes, MotionLog(), 5.0, None, InitializationConfig())
        expected = np.array([100.0, 50.0]) + SPEED * 5.0 * np.array([np.cos(HEADING), np.sin(HEADING)])
        assert np.hypot(prior.x_m - expected[0], prior.y_m - expected[1]) < 2.0 * prior.sigma_xy_m
        off.append((prior.heading_rad - HEADING) / prior.sigma_heading_rad)
    assert np.sqrt(np.mean(np.square(off))) < 1.0


@pytest.mark.parametrize(
    ("times", "speed", "sigma_m", "told"),
    [
        ([], SPEED, 1.3, "no satellite fix in the last 20 s; give --prior"),
        ([1.0], SPEED, 1.3, "1 valid satellite fix so far; 2 are needed"),
        ([0.0, 1.0, 2.0], SPEED, 30.0, "state a sigma of 30 m or more, not 10 m"),
        (np.arange(0.0, 5.0, 0.2), 0.0, 1.3, "do not give the heading of one that stands; give --prior"),
    ],
)
@pytest.mark.parametrize("with_wheels", [True, False])
def test_why_there_is_no_start_is_told_with_what_would_help(times, speed, sigma_m, told, with_wheels):
    fixes, log = no_fixes(), MotionLog()
    for t in times:
        p = np.array([100.0 + speed * t, 50.0, 2.0])
        fixes = with_fix(fixes, GnssMeasurement(float(t), p, np.full(3, sigma_m)))
    for t in np.arange(0.0, 6.0, 0.02) if with_wheels else ():
        log.add_wheels(float(t), speed, 0.0)
    assert told in why_no_prior(fixes, log, 5.0, None, InitializationConfig())
    assert prior_from_fixes(fixes, log, 5.0, None, InitializationConfig()) is None


def test_a_prior_has_nothing_to_complain_of():
    fixes = fixes_along(np.arange(0.0, 5.0, 0.2))
    for log in (straight_log(), MotionLog()):
        assert why_no_prior(fixes, log, 5.0, None, InitializationConfig()) == ""


def test_a_fast_vehicle_waits_for_the_heading_while_fixes_keep_coming():
    """After 4 m of way the heading is vague, and the next fix comes within half a second; a second later none came."""
    fixes, config = fixes_along((0.0, 0.2, 0.4)), InitializationConfig(wide_sigma_heading_deg=10.0)
    assert prior_from_fixes(fixes, straight_log(), 0.4, None, config) is None
    assert "more come at once" in why_no_prior(fixes, straight_log(), 0.4, None, config)
    late = prior_from_fixes(fixes, straight_log(), 1.4, None, config)
    assert 10.0 < np.degrees(late.sigma_heading_rad) < 60.0
    # One that hardly moves learns little by waiting.
    slow = MotionLog()
    for t in np.arange(0.0, 6.0, 0.02):
        slow.add_wheels(float(t), 3.0, 0.0)
    assert "more come at once" not in why_no_prior(fixes, slow, 0.4, None, config)


def test_dead_reckoning_that_is_unsure_along_the_way_is_searched_along_it():
    T = rigid.planar_pose(10.0, 5.0, HEADING)

    def places(along_m, across_m):
        covariance = np.diag([along_m, across_m, 0.1, 0.01, 0.01, 0.01]) ** 2
        coasting = FusedPose(5.0, T, covariance, 1.0, 0.0, np.zeros(2))
        return places_around(coasting, AcquisitionConfig())

    (one,) = places(1.5, 0.5)
    assert (one.x_m, one.y_m, one.sigma_xy_m) == pytest.approx((10.0, 5.0, 3.0))
    found = places(5.0, 0.5)
    ahead = np.array([np.cos(HEADING), np.sin(HEADING)])
    along = np.array([(p.x_m, p.y_m) - T[:2, 3] for p in found]) @ ahead
    assert len(found) == 3 and sorted(along) == pytest.approx([-8.0, 0.0, 8.0]), "10 m either way"
    assert {p.sigma_xy_m for p in found} == {4.0} and found[0].x_m == 10.0
    assert len(places(3.9, 3.9)) == 3 and places(4.1, 4.1) == [], "across the way one search reaches 8 m"
    assert places(12.0, 0.5) == [], "more places than a search may take"
