"""What the way says of the heading: cameras that look aside, before and after the drive has told."""

import numpy as np
import pytest
from scipy.stats import norm

from semloc_jax.fusion.measurements import FusedPose
from semloc_jax.localization import course, told_faults
from semloc_jax.localization.course import Course, course_of, heading_level_deg, remembered_rad
from tests.localization.test_watch import rig

SHARE = 1e-3 / 6.0
"""Of the risk of a frame, on one side of one direction."""


def told(heading_deg: float, way_deg: float, aside_deg: float) -> FusedPose:
    """A fused pose after cameras that measured the heading with one sigma, and a way that measured its direction with
    another one and found it aside; the fusion held the direction of travel near zero with 0.3 deg."""
    information = np.array([[1.0 / heading_deg**2 + 1.0 / way_deg**2, 1.0 / way_deg**2], [1.0 / way_deg**2] * 2])
    information[1, 1] += 1.0 / 0.3**2
    covariance = np.linalg.inv(information)
    turned, travel = covariance @ np.array([1.0, 1.0]) * aside_deg / way_deg**2
    pose = 1e-4 * np.eye(6)
    pose[5, 5] = np.deg2rad(1.0) ** 2 * covariance[0, 0]
    joint, sigma = np.deg2rad(1.0) ** 2 * covariance[0, 1], np.deg2rad(np.sqrt(covariance[1, 1]))
    found = FusedPose(0.0, np.eye(4), pose, 1.0, 0.0, np.zeros(2), np.deg2rad(travel), sigma, joint)
    return found._replace(gnss_offset_m=np.array([turned, 0.0]))  # how far the heading was pulled [deg]


@pytest.mark.parametrize("aside_deg", [0.0, 0.7])
def test_the_course_is_where_the_way_goes_whatever_the_fusion_believes(aside_deg):
    """Seen from the heading that the fusion ended with, and as sure as the way, but for the wide prior."""
    fused = told(0.1, 0.2, aside_deg)
    found = course_of(fused)
    wide = np.hypot(np.degrees(0.02), 0.1)
    share = wide**2 / (wide**2 + 0.2**2)
    assert np.degrees(found.off_rad) == pytest.approx(share * aside_deg - fused.gnss_offset_m[0], abs=1e-6)
    assert np.degrees(found.sigma_rad) == pytest.approx(0.2 * np.sqrt(share), rel=1e-6)


def test_before_any_way_is_driven_cameras_may_look_aside_as_far_as_mounts_allow():
    found = course_of(told(0.1, 1e3, 0.0))
    assert np.degrees(found.sigma_rad) == pytest.approx(np.hypot(0.1, np.degrees(0.02)), rel=1e-3)
    assert heading_level_deg(0.0, found, 15.0, SHARE) > 2.0
    assert course_of(FusedPose(0.0, np.eye(4), np.eye(6), 1.0, 0.0, np.zeros(2))) == Course(0.0, 0.0)


def test_the_way_says_how_probable_cameras_that_look_aside_are():
    """Against densities: the way with 0.2 deg, an axle with 0.3 deg, cameras with the wide prior besides."""
    for off_deg, less in ((0.0, True), (0.3, True), (1.0, False)):
        found = told(1e-3, 0.2, off_deg)
        exact, aside = norm(0.0, np.hypot(0.2, 0.3)), norm(0.0, np.hypot(0.2, np.degrees(0.02)))
        odds = 0.005 / 0.995 * aside.pdf(off_deg) / exact.pdf(off_deg)
        probable = course.probability(0.0, course_of(found), True, 0.005)
        assert probable == pytest.approx(odds / (1.0 + odds), rel=1e-3) and (probable < 0.005) == less
        assert course.probability(0.0, course_of(found), False, 0.005) == 0.005
    unknown = Course(0.0, np.deg2rad(3.0))
    assert course.probability(0.0, unknown, True, 0.005) == pytest.approx(0.005, rel=1e-2)


def test_a_level_reaches_to_the_far_side_of_the_course_with_what_is_left_of_the_risk():
    found = Course(np.deg2rad(0.2), np.deg2rad(0.1))
    for far_deg, aside_deg in ((0.2, 0.0), (0.3, -0.3)):
        level_deg = heading_level_deg(np.deg2rad(aside_deg), found, np.inf, 0.03)
        assert level_deg == pytest.approx(far_deg + 0.1 * norm.ppf(0.97), abs=1e-4)
        # At its level the probability is what the risk leaves; on the far side of zero there is next to nothing.
        assert course.misleading(np.deg2rad(aside_deg), found, np.inf, level_deg) == pytest.approx(0.03, rel=1e-2)


def test_what_was_sure_is_remembered_and_what_was_not_is_not():
    """0.6 deg with 0.2 deg are 0.4 deg at the least; ten metres leave exp(-1 / 2) of that, no more than two standard
    deviations beyond what the drive says by now."""
    sure, unsure = Course(np.deg2rad(0.6), np.deg2rad(0.2)), Course(np.deg2rad(0.3), np.deg2rad(0.4))
    first = remembered_rad(0.0, sure, 1.0)
    assert np.degrees(first) == pytest.approx(0.4) and remembered_rad(0.0, unsure, 1.0) == 0.0
    assert np.degrees(remembered_rad(first, unsure, 10.0)) == pytest.approx(0.4 * np.exp(-0.5))
    assert np.degrees(remembered_rad(-first, Course(0.0, np.deg2rad(0.1)), 0.0)) == pytest.approx(-0.2)


@pytest.mark.parametrize(
    ("off_deg", "num", "said"),
    [
        (0.7, 1, "camera camera0 looks 0.7 deg to the right of where the vehicle drives; run semloc calibrate"),
        (-0.7, 2, "the cameras look 0.7 deg to the left of where the vehicle drives; run semloc calibrate"),
        (
            0.05,
            1,
            "the direction of travel is not known yet, and with it whether the camera looks aside: a few metres tell",
        ),
    ],
)
def test_the_sentence_says_by_how_much_or_that_nothing_is_known_yet(off_deg, num, said):
    found = Course(np.deg2rad(off_deg), np.deg2rad(0.25))
    assert told_faults.aside_cause(found, 0.0, 0.6, rig(num)) == said


def test_way_and_masks_that_agree_are_surer_together_and_those_that_do_not_are_less_sure():
    way = Course(*np.deg2rad([-0.2, 0.2]).tolist())
    agreed, torn = (np.degrees(course.joined(way, *np.deg2rad([off_deg, 0.1]).tolist())) for off_deg in (-0.3, 0.6))
    assert agreed == pytest.approx([-0.28, 0.2 / np.sqrt(5.0)], abs=1e-9)
    assert torn == pytest.approx([0.44, 0.8 / np.sqrt(0.05) * 0.2 / np.sqrt(5.0)], abs=1e-9)
    assert course.joined(Course(0.1, 0.0), 0.2, 0.1) == Course(0.1, 0.0)
