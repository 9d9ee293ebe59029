"""Frames that fit the motion between them, and frames that do not."""

import numpy as np
import pytest

from semloc_jax.localization.innovations import Innovations, doubts, learned

COVARIANCE = np.diag([0.1, 0.05, 0.02, 0.01, 0.01, 0.002]) ** 2


def after(factor, num: int, seed: int = 0) -> list[Innovations]:
    """Frames whose differences have so many times the standard deviations they should."""
    random, state, found = np.random.default_rng(seed), Innovations(), []
    for _ in range(num):
        difference = random.normal(size=6) * np.sqrt(np.diag(COVARIANCE)) * factor
        chi2 = float(difference @ np.linalg.solve(COVARIANCE, difference))
        state = learned(state, chi2, difference, COVARIANCE)
        found.append(state)
    return found


def test_careful_covariances_are_never_doubted_and_exact_ones_as_often_as_said():
    assert not any(doubts(state) for state in after(0.6, 500))
    share = np.mean([bool(doubts(state)) for state in after(1.0, 4000)])
    assert 0.03 < share < 0.1  # neighbours share frames: their mean scatters as that of nine, not of five


@pytest.mark.parametrize(("axis", "word"), [(0, "odometer"), (1, "direction of the cameras"), (5, "gyroscope")])
def test_what_does_not_fit_is_named(axis, word):
    factor = np.ones(6)
    factor[axis] = 6.0
    (doubt,) = doubts(after(factor, 12)[-1])
    assert word in doubt.cause and "masks and motion do not fit" in doubt.cause


def test_a_pose_is_in_doubt_as_far_as_masks_and_motion_differ():
    state = Innovations()
    for _ in range(30):
        state = learned(state, 40.0, np.array([0.3, -0.1, 0.0, 0.0, 0.0, 0.004]), COVARIANCE)
    (doubt,) = doubts(state)
    assert doubt[:3] == pytest.approx((0.1, 0.3, np.degrees(0.004)))


def test_a_clock_that_is_late_shows_along_the_way_alone():
    """Two and a half standard deviations behind, frame after frame, and all else better than it should be: the six
    directions together are within what chance does."""
    state = Innovations()
    for _ in range(12):
        behind = np.array([-0.25, 0.0, 0.0, 0.0, 0.0, 0.0])
        state = learned(state, 6.25, behind, COVARIANCE)
    (doubt,) = doubts(state)
    assert "odometer or its clock" in doubt.cause and doubt.longitudinal_m == pytest.approx(0.25)


@pytest.mark.parametrize(("sigmas", "told_at"), [(1.5, 5), (0.5, None)])
def test_a_lag_within_its_sigma_shows_as_a_sum_to_one_side(sigmas, told_at):
    """Twenty frames 1.5 standard deviations behind; their squares are below the limit of one direction, 3.0. After n
    of them the sum is 1.5 (1 - 0.9^n) / 0.1 over the root of (1 - 0.81^n) / 0.19: 3.31 for five."""
    state, found = Innovations(), []
    for _ in range(20):
        behind = np.array([-0.1 * sigmas, 0.0, 0.0, 0.0, 0.0, 0.0])
        state = learned(state, sigmas**2, behind, COVARIANCE)
        found.append(bool(doubts(state)))
    assert (1 + found.index(True) if any(found) else None) == told_at
    for _ in range(20):  # as often ahead as behind
        for side in (1.0, -1.0):
            state = learned(state, 2.25, side * np.array([0.15, 0.0, 0.0, 0.0, 0.0, 0.0]), COVARIANCE)
    assert doubts(state) == ()


def test_it_is_over_soon_and_what_is_no_number_says_nothing():
    state = after(4.0, 6)[-1]
    assert doubts(state)
    assert learned(state, np.nan, np.zeros(6), COVARIANCE) is state
    for _ in range(8):
        state = learned(state, 1.0, np.zeros(6), COVARIANCE)
    assert doubts(state) == ()
