"""The satellite prior: straight, curved, standing, with drop-outs and outliers, against the truth."""

import numpy as np
import pytest

from semloc_jax.datasets import GnssTrack, WheelOdometry, gnss_prior, read_drive
from semloc_jax.datasets.sensors import read_gnss
from semloc_jax.errors import SemlocError
from semloc_jax.geometry.geodesy import wgs84_from_enu


def circle_drive(speed=10.0, yaw_rate=0.2, duration=10.0, jitter=0.0, seed=0):
    """Wheel odometry and fixes of a circle, and the function that gives the true x, y, heading."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, duration, 0.02)
    odometry = WheelOdometry(time, np.full(len(time), speed), np.full(len(time), yaw_rate))

    def truth(t):
        heading = 0.7 + yaw_rate * t
        radius = speed / yaw_rate
        return np.array(
            [50 + radius * (np.sin(heading) - np.sin(0.7)), 20 - radius * (np.cos(heading) - np.cos(0.7)), heading]
        )

    fix_time = np.arange(0.0, duration, 0.2)
    p = np.array([[*truth(t)[:2], 3.0] for t in fix_time]) + rng.normal(size=(len(fix_time), 3)) * jitter
    return odometry, GnssTrack(fix_time, p, np.full(p.shape, 1.3)), truth


def heading_error_deg(heading, expected):
    return np.degrees(abs((heading - expected + np.pi) % (2 * np.pi) - np.pi))


@pytest.mark.parametrize("causal", [False, True])
def test_clean_fixes_give_the_exact_pose_in_a_curve(causal):
    odometry, gnss, truth = circle_drive()
    prior = gnss_prior(gnss, 5.03, odometry, causal=causal)
    x, y, heading = truth(5.03)
    np.testing.assert_allclose(prior.p_enu, [x, y, 3.0], atol=1e-4)
    assert heading_error_deg(prior.heading_rad, heading) < 1e-3


def test_without_odometry_the_parabola_follows_the_curve():
    _, gnss, truth = circle_drive()
    prior = gnss_prior(gnss, 5.03)
    assert heading_error_deg(prior.heading_rad, truth(5.03)[2]) < 1.0
    np.testing.assert_allclose(prior.p_enu[:2], truth(5.03)[:2], atol=0.1)


@pytest.mark.parametrize("with_odometry", [True, False])
def test_an_antenna_on_the_roof_gives_the_base(with_odometry):
    """The antenna swings around the base in a curve: 1.3 m ahead, 0.4 m to the left, 1.6 m up."""
    odometry, gnss, truth = circle_drive()
    poses = np.array([truth(t) for t in gnss.time_s])
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    shift = np.column_stack([1.3 * cos - 0.4 * sin, 1.3 * sin + 0.4 * cos, np.full(len(poses), 1.6)])
    on_roof = GnssTrack(gnss.time_s, gnss.p_enu + shift, gnss.sigma_m, (1.3, 0.4, 1.6))
    prior = gnss_prior(on_roof, 5.03, odometry if with_odometry else None)
    x, y, heading = truth(5.03)
    np.testing.assert_allclose(prior.p_enu, [x, y, 3.0], atol=1e-3 if with_odometry else 0.25)
    # Without odometry the path of the antenna is taken for that of the base: it points 1.3 m x 0.02 / m inward.
    assert heading_error_deg(prior.heading_rad, heading) < (1e-3 if with_odometry else 2.5)


def test_fixes_on_the_earth_are_brought_to_the_frame_of_a_map():
    """Fixes kept around their own first place, and a map whose origin is 3 km away: the same points on the earth."""
    origin = (48.05, 11.62, 500.0)
    p_map = np.array([[2400.0, -1800.0, 3.0], [2410.0, -1795.0, 3.2], [2425.0, -1788.0, 3.1]])
    places = np.stack(wgs84_from_enu(p_map, origin), axis=1)
    places = np.vstack([places, [[np.nan, 11.0, 500.0]]])  # a row without a fix
    track = GnssTrack.from_wgs84(np.array([0.2, 0.1, 0.3, 0.4]), places, np.full((4, 3), 1.0))
    assert track.time_s.tolist() == [0.1, 0.2, 0.3]
    np.testing.assert_allclose(track.p_enu[0], 0.0, atol=1e-9)
    np.testing.assert_allclose(track.seen_from(origin).p_enu, p_map[[1, 0, 2]], atol=1e-6)
    assert track.seen_from(origin).seen_from((0.0, 0.0, 0.0)).origin is None  # a map frame stays one


def test_outliers_and_a_drop_out_do_no_harm():
    odometry, gnss, truth = circle_drive(jitter=0.4)
    p = gnss.p_enu.copy()
    p[::6, :2] += [25.0, -12.0]
    present = (gnss.time_s < 3.0) | (gnss.time_s > 7.0)
    gnss = GnssTrack(gnss.time_s[present], p[present], gnss.sigma_m[present])
    prior = gnss_prior(gnss, 5.0, odometry)
    x, y, heading = truth(5.0)
    assert np.hypot(prior.p_enu[0] - x, prior.p_enu[1] - y) < 0.5
    assert heading_error_deg(prior.heading_rad, heading) < 1.5


def test_reversing_keeps_the_heading_of_the_vehicle():
    odometry, gnss, truth = circle_drive(speed=-3.0, yaw_rate=-0.1)
    prior = gnss_prior(gnss, 5.0, odometry)
    assert heading_error_deg(prior.heading_rad, truth(5.0)[2]) < 0.01


def test_standing_still_says_that_the_heading_is_unknown():
    time = np.arange(0.0, 5.0, 0.02)
    odometry = WheelOdometry(time, np.zeros(len(time)), np.zeros(len(time)))
    gnss = GnssTrack(np.arange(0.0, 5.0, 0.2), np.tile([1.0, 2.0, 3.0], (25, 1)), np.full((25, 3), 1.3))
    prior = gnss_prior(gnss, 2.5, odometry)
    assert prior.sigma_heading_rad == pytest.approx(np.pi)
    np.testing.assert_allclose(prior.p_enu, [1.0, 2.0, 3.0])


def test_causal_uses_no_later_fix():
    odometry, gnss, _ = circle_drive()
    later = GnssTrack(gnss.time_s, gnss.p_enu + (gnss.time_s > 4.0)[:, None] * 500.0, gnss.sigma_m)
    before = gnss_prior(gnss, 4.0, odometry, causal=True)
    np.testing.assert_array_equal(before.p_enu, gnss_prior(later, 4.0, odometry, causal=True).p_enu)
    with pytest.raises(SemlocError, match="no fix up to time"):
        gnss_prior(gnss, -1.0, odometry, causal=True)


def test_rendered_road_every_frame_within_two_degrees_and_the_receivers_own_bias(road_dir):
    drive = read_drive(road_dir)
    headings, sides, ratios = [], [], []
    for frame in drive.frames:
        T = drive.truth_at(frame)
        prior = drive.gnss_prior(frame.time_s)
        headings.append(heading_error_deg(prior.heading_rad, np.arctan2(T[1, 0], T[0, 0])))
        sides.append(np.linalg.norm((prior.p_enu - T[:3, 3])[:2]))
        ratios.append(np.radians(headings[-1]) / prior.sigma_heading_rad)
    assert np.median(headings) < 0.5 and np.max(headings) < 1.0
    assert np.max(sides) < 2.5
    assert np.max(ratios) < 3.0


def test_fixes_in_metres_of_the_map_need_a_time_and_a_place_only(tmp_path):
    """Any usual name of a column, any unit of time; heights and standard deviations as of a plain receiver."""
    (tmp_path / "gps.csv").write_text("timestamp;east;north\n1700000000000;1,5;2,5\n1700000000200;2,5;3,5\n")
    fixes = read_gnss(tmp_path / "gps.csv")
    np.testing.assert_allclose(fixes.time_s, [1700000000.0, 1700000000.2])
    np.testing.assert_allclose(fixes.p_enu, [[1.5, 2.5, 0.0], [2.5, 3.5, 0.0]])
    np.testing.assert_allclose(fixes.sigma_m, [[3.0, 3.0, 6.0]] * 2)
