"""The right period of the markings: satellites and odometer speak against a track that needs them to be wrong."""

import numpy as np
import pytest

from semloc_jax.fusion.measurements import FusedPose, GnssMeasurement
from semloc_jax.localization import phase
from semloc_jax.localization.elsewhere import _apart, crossing
from semloc_jax.localization.initialization import no_fixes, with_fix
from semloc_jax.localization.rivals import _valleys


def fixes(sigma_m: float):
    found = no_fixes()
    for k in range(8):
        found = with_fix(found, GnssMeasurement(0.2 * k, np.array([2.0 * k, 0.0, 0.0]), np.full(3, sigma_m)))
    return found


def pose(off_m: float, scale: float = 1.0) -> FusedPose:
    return FusedPose(1.6, np.eye(4), np.eye(6), scale, 0.0, np.array([0.6, 0.8]) * off_m)


def test_a_period_of_12_m_is_no_offset_of_satellites_that_state_1_3_m():
    right, wrong = (phase.nats_against(pose(off), fixes(1.3)) for off in (1.0, 12.0))
    assert right < 0.2
    assert wrong - right > 15.0  # (12 m / 1.95 m)^2 / 2 = 18.9 nats
    assert phase.doubts(pose(1.0), fixes(1.3), 0.0) == ()
    assert "12.0 m off" in phase.doubts(pose(12.0), fixes(1.3), 0.0)[0]


def test_masks_settle_what_satellites_doubt_aside_but_not_along():
    """Masks that make every other place a thousand times less probable; ten times less does not. Along the way they may
    be late."""
    aside, along = (pose(1.0)._replace(gnss_offset_m=np.array(off)) for off in ([1.0, 7.0], [7.0, 1.0]))
    for one, nats, settled in ((aside, 10.0, False), (aside, 1001.0, True), (along, 1001.0, False)):
        assert (phase.doubts(one, fixes(1.3), np.log(nats)) == ()) == settled
    assert phase.doubts(pose(0.5, scale=0.94), fixes(1.3), np.log(1001.0)) == ()
    assert phase.doubts(pose(0.5, scale=0.94), fixes(1.3), 0.0) != ()


def test_other_places_are_looked_at_a_period_along_and_two_lanes_across():
    moves = crossing()
    for x, y in ((-9.0, 0.0), (6.0, 0.0), (0.0, 3.5), (0.0, -7.0), (0.0, 0.0)):
        assert np.min(np.hypot(moves[:, 0] - x, moves[:, 1] - y)) < 0.3
    assert (moves[:, 2] == 0.0).all()


def test_places_apart_from_the_pose_are_chosen_cheapest_first():
    moves = np.array(
        [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [6.0, 0.0, 0.0], [6.5, 0.0, 0.0], [12.0, 0.0, 0.0], [0.0, 3.5, 0.0]]
    )
    assert _apart(moves, np.array([0.0, 1.0, 5.0, 4.0, np.inf, 2.0])) == [5, 3]


@pytest.mark.parametrize(("away_m", "doubted"), [(0.0, (0.0, 0.01)), (6.0, (0.7, 0.95)), (12.0, (0.99, 1.0))])
def test_how_often_a_track_a_period_away_is_doubted(away_m, doubted):
    """Fixes whose slow error is as large as they state, 1.3 m in both directions."""
    slow_m = 1.3 * np.random.default_rng(0).normal(size=(500, 2)) + [away_m, 0.0]
    there = [pose(0.0)._replace(gnss_offset_m=off_m) for off_m in slow_m]
    known = fixes(1.3)
    share = np.mean([bool(phase.doubts(one, known, 0.0)) for one in there])
    assert doubted[0] <= share <= doubted[1]


def test_a_young_track_is_told_what_the_old_one_knows_of_the_satellites():
    old, young = pose(1.0), pose(0.0)
    moved = np.eye(4)
    moved[:2, 3] = np.array([0.6, 0.8]) * -11.0
    young = young._replace(T_map_base=moved)
    told = phase.nats_of_tracks([old, young], [20, 1], fixes(1.3))
    assert told == pytest.approx([phase.nats_against(pose(off), fixes(1.3)) for off in (1.0, 12.0)])
    of_one_age = phase.nats_of_tracks([old, young], [20, 20], fixes(1.3))
    assert of_one_age[1] == 0.0  # it has learned its own


def test_poor_satellites_do_not_tell_a_period():
    assert phase.nats_against(pose(12.0), fixes(8.0)) == pytest.approx(0.5, abs=0.01)
    assert phase.doubts(pose(12.0), fixes(8.0), 0.0) == ()


def test_without_fixes_only_the_odometer_speaks():
    assert phase.nats_against(pose(50.0), no_fixes()) == 0.0
    # 10 % of the way at a belief of 2 %.
    assert phase.nats_against(pose(0.0, scale=0.9), no_fixes()) == pytest.approx(12.5)


def test_valleys_away_from_the_track_are_found_lowest_first():
    offsets = np.arange(-14.0, 14.01, 0.25)
    costs = 10.0 - 3.0 * np.exp(-(offsets**2)) - 6.0 * np.exp(-((offsets - 6.0) ** 2)) - np.exp(-((offsets + 9.0) ** 2))
    found = offsets[_valleys(costs, offsets)]
    np.testing.assert_allclose(found[:2], [6.0, -9.0])
    assert (np.abs(found) > 1.0).all()
