"""Faults that a drive has neither told nor excluded: they hold the levels open for as long, and no longer."""

import numpy as np
import pytest

from semloc_jax.alignment.class_profiles import GROUPS
from semloc_jax.evaluation.mixture_bounds import RISK
from semloc_jax.localization import innovations, separation, weighed_faults
from semloc_jax.localization.innovations import Innovations
from semloc_jax.localization.lens_way import LensWay
from semloc_jax.localization.moved_elements import moves
from semloc_jax.localization.other_calibrations import ASIDE, STEPS, alternatives
from semloc_jax.localization.stance_sums import learned as stood
from semloc_jax.localization.watch_config import WatchConfig
from semloc_jax.localization.watch_sums import Tried, WatchState, learned
from semloc_jax.localization.weighed_height import with_height
from semloc_jax.localization.weighed_motion import with_motion

CONFIG = WatchConfig()
SHARE = RISK / 6.0
ALERT_M = 0.29
OWN = np.array([0.01, 0.02, 0.05])
"""Standard deviations of a pose: left [m], ahead [m], heading [deg]."""
AHEAD_BY_STEP_M = -0.3
"""How far a lens that is a step longer moves the pose, as on simulated roads."""


def profiles(lines_at_m: float, nats: float) -> np.ndarray:
    """Costs of each group over the moves: all fit at the pose, but the lines, which fit `nats` better ahead of it."""
    table = moves(CONFIG)
    found = np.tile(40.0 * np.minimum(np.linalg.norm(table, axis=1), 1.0), (len(GROUPS), 1))
    away = np.abs(table[:, 0] - lines_at_m)
    is_ahead = table[:, 1] == 0.0
    found[0, is_ahead] = np.minimum(30.0 * away[is_ahead], 14.0) - nats
    found[0, is_ahead & (np.abs(table[:, 0]) < 0.1)] = 0.0
    return found


def after(
    num: int, gains: tuple[float, float], lines_at_m: float = 0.0, nats: float = 0.0, rest: float = 1.0
) -> WatchState:
    """So many looks, in which a longer and a shorter lens gain so much [nats], and posts and the right side say so much
    of what they do say else."""
    moved = np.array([[AHEAD_BY_STEP_M * step, 0.0, 0.0] for step in STEPS])
    state, said = WatchState(), np.array([1.0, rest, 1.0, rest])[:, None] * profiles(lines_at_m, nats)
    for _ in range(num):
        gain = np.array([*gains, np.nan, np.nan])
        state = learned(state, alternatives(1), 0.0, [Tried("focal", gain, moved)], said, CONFIG)
    return state


def most(state: WatchState, is_stated: bool = False) -> np.ndarray:
    """How far the right pose may be: left [m], ahead [m], heading [deg]."""
    causes = weighed_faults.weighed(state, alternatives(1), OWN, np.full(3, 20.0), CONFIG, is_stated=is_stated)
    least, farthest = weighed_faults.reach(causes, SHARE)
    return np.max([-least, farthest, np.zeros(3)], axis=0)


def test_a_sound_lens_is_excluded_by_two_looks_and_a_moved_map_by_one():
    one, two = (most(after(num, (-5.0, -5.0)))[1] for num in (1, 2))
    assert one > two and two < ALERT_M
    assert most(after(8, (-5.0, -5.0)))[1] < 0.2


@pytest.mark.parametrize("num", [1, 4, 12, 28])
def test_a_lens_that_is_2_percent_off_holds_the_level_open_where_each_frame_gains_less_than_chance(num):
    """Gains of a frame on a road of a seed that nothing was chosen on: 1 nat for the right side, below the 2 nats of a
    suspicion, and the pose was 0.4 m off while it was called good."""
    assert most(after(num, (-6.5, 1.0)))[1] > ALERT_M


def test_the_place_that_a_wrong_lens_leaves_is_on_its_side():
    causes = weighed_faults.weighed(after(20, (-6.5, 1.0)), alternatives(1), OWN, np.full(3, 20.0), CONFIG)
    least, farthest = weighed_faults.reach(causes, SHARE)[:, 1]
    assert farthest > 0.3 and least > -0.05
    there = causes._replace(mean=causes.mean - np.array([0.0, farthest, 0.0]))
    assert weighed_faults.reach(there, SHARE)[1, 1] == pytest.approx(0.0, abs=1e-4)


def small(state: WatchState) -> float:
    """How far ahead or behind the right pose may be where masks are small [m]."""
    causes = weighed_faults.weighed(state, alternatives(1), OWN, np.full(3, 20.0), CONFIG, is_small=True)
    return float(np.abs(weighed_faults.reach(causes, SHARE)[:, 1]).max())


@pytest.mark.parametrize(("at_steps", "is_held"), [(-0.1, True), (-0.8, False), (-1.6, False)])
def test_what_small_masks_like_of_a_lens_is_told_by_the_way(at_steps, is_held):
    """A real drive of 400 x 120 px likes a lens that is 2.5 % longer by 0.8 nats a frame, whose lens is exact: its
    pixels. Its way says -0.1 +- 0.35 steps; with the focal length stated 2 and 5 % too long -0.9 and -1.3."""
    state = after(20, (0.8, -1.6))
    assert small(state) > ALERT_M
    one = np.float64(1.0)
    way = LensWay(num=np.float64(40.0), squares=8.0 * one, products=-8.0 * at_steps * one, differences=40.0 * one)
    assert (small(state._replace(lens=way)) < ALERT_M) == is_held


@pytest.mark.parametrize(("height_m", "least_m", "most_m"), [(0.003, 0.0, ALERT_M), (0.086, 0.5, 1.2)])
def test_a_horizontal_focal_length_that_is_off_shows_in_the_height_of_the_vehicle(height_m, least_m, most_m):
    """Sound vehicles of country roads stand 0.3 cm high, a real one 1.0 cm, and 8.6 cm with the horizontal focal length
    stated 5 % too long: 0.66 m behind, and no fit of a frame told it."""
    state = after(8, (-5.0, -5.0))
    stance = state.stance
    for _ in range(10):
        stance = stood(stance, np.array([height_m, 0.0, 0.0]), np.array([0.026, 0.0, 0.0]), 10.0)
    state = state._replace(stance=stance)
    freedom = np.full(3, 20.0)
    causes = weighed_faults.weighed(state, alternatives(1), OWN, freedom, CONFIG)
    reach_m = weighed_faults.reach(with_height(causes, state, 1.65, OWN, freedom), SHARE)[1, 1]
    assert least_m < reach_m < most_m


@pytest.mark.parametrize("gains", [(-0.1, -0.2), (0.0, 0.0), (0.3, -0.1)])
def test_frames_that_do_not_tell_the_lens_leave_it_what_it_is_before_the_drive(gains):
    """Gains on country roads with lines, dashes and posts alone. Of 90 frames with a lens 5 % off 32 were called good,
    0.65 m off along the road."""
    assert most(after(12, gains))[1] > 0.2


def test_small_masks_whose_costs_do_not_bend_leave_the_lens_open_too():
    state = after(12, (0.3, -0.1))
    assert small(state) > 0.2


def test_lines_that_fit_ahead_of_posts_count_before_they_are_sure():
    told = most(after(2, (-5.0, -5.0), lines_at_m=1.0, nats=1.0))
    assert told[1] > 0.7
    assert told[0] < 0.05


def test_lines_alone_that_may_have_been_moved_as_a_whole_are_told_by_who_states_the_accuracy_of_the_map():
    """A real street has no post in view and nothing to the right: its lines a metre aside are the map a metre aside."""
    alone = after(12, (-5.0, -5.0), rest=0.0)
    assert (most(alone)[:2] > (1.3, 4.0)).all()
    assert (most(alone, is_stated=True)[:2] < 0.2).all()
    assert weighed_faults.is_alone(alone, CONFIG) and not weighed_faults.is_alone(after(1, (-5.0, -5.0)), CONFIG)


def test_posts_that_have_begun_to_tell_hold_the_level_open_until_they_have_told():
    begun, told = after(1, (-5.0, -5.0), rest=0.1), after(12, (-5.0, -5.0), rest=0.1)
    assert (most(begun, is_stated=True)[:2] > (1.2, 3.0)).all()
    assert (most(told, is_stated=True)[:2] < ALERT_M).all()


@pytest.mark.parametrize(("differ_m", "least_m", "most_m"), [(0.05, 0.0, 0.2), (0.16, ALERT_M, 0.5)])
def test_masks_and_motion_that_differ_leave_the_pose_as_open_whatever_masks_are_said_to_scatter(
    differ_m, least_m, most_m
):
    """Frames of 400 x 120 px with an odometer that sticks: each differs from the motion by one of its sigmas (0.16 m),
    no test of their sums speaks, and the pose is 0.25 m behind. On the sound drive it is 0.05 m."""
    fits = Innovations()
    for k in range(8):
        difference = np.array([(-1.0) ** (k // 2) * differ_m, 0.0, 0.0, 0.0, 0.0, 0.0])
        fits = innovations.learned(fits, 1.0, difference, np.diag([0.16, 0.1, 0.1, 0.01, 0.01, 0.01]) ** 2)
    assert innovations.doubts(fits) == ()
    state = after(8, (-5.0, -5.0))
    freedom = np.full(3, 20.0)
    causes = weighed_faults.weighed(state, alternatives(1), OWN, freedom, CONFIG)
    reach_m = np.abs(weighed_faults.reach(with_motion(causes, fits, OWN, freedom), SHARE)[:, 1]).max()
    assert least_m < reach_m < most_m


def test_a_pose_between_two_explanations_is_off_by_the_way_to_one_of_them():
    fault = separation.separated(np.array([0.4, 0.0, 0.0]), "")
    at_one_end, between = (separation.second_moment(fault, np.array([0.0, move, 0.0]))[1] for move in (0.0, 0.2))
    assert np.sqrt(between) == pytest.approx(0.2)
    assert np.sqrt(at_one_end) == pytest.approx(0.4 / np.sqrt(2.0))


def test_a_sound_lens_leaves_the_place_as_open_as_lenses_are_exact():
    """0.125 % at 0.3 m for 2.5 %."""
    variance = weighed_faults.of_sound_ones(after(2, (-5.0, -5.0)), alternatives(1), CONFIG)
    assert 0.01 < np.sqrt(variance[1]) <= 0.015
    assert variance[0] == variance[2] == 0.0


def test_cameras_at_the_front_and_at_the_rear_tell_whether_all_look_aside():
    """Gains of garages of seeds on which nothing was chosen: sound cameras, and cameras turned by 0.5 and 0.7 deg. The
    way denied them for three metres, since what held the pose was ahead first and behind it later. Of the last, near
    steps alone show a slope and no bend."""
    found = []
    for gains in ((-3.1, -3.2, np.nan, np.nan), (-4.1, 1.2, np.nan, -5.7), (-3.5, 2.9, np.nan, -2.8)):
        state = WatchState()
        for _ in range(8):
            moved = np.array([[0.0, 0.0, np.deg2rad(-0.7) * step] for step in STEPS])
            state = learned(state, alternatives(4), 0.0, [Tried(ASIDE, np.array(gains), moved)], profiles(0, 0), CONFIG)
        causes = weighed_faults.weighed(state, alternatives(4), OWN, np.full(3, 20.0), CONFIG)
        level_deg = weighed_faults.reach(causes, SHARE)[1, 2]
        found.append((weighed_faults.aside(state, alternatives(4), CONFIG), level_deg))
    (sound, sound_deg), *turned = found
    assert sound < 0.002 and sound_deg < 0.3
    assert all(share > 2.0 * sound and level_deg > 0.6 for share, level_deg in turned)
    assert weighed_faults.aside(state, alternatives(1), CONFIG) == 0.005
    assert weighed_faults.aside(WatchState(), alternatives(4), CONFIG) == 0.005


def test_masks_of_cameras_all_round_say_how_far_aside_they_look():
    """Gains of PandaSet 002 after eleven looks. The way alone says -0.21 deg with 0.13 deg there."""
    state = WatchState()
    for _ in range(11):
        moved = np.array([[0.0, 0.0, -0.013 * step] for step in STEPS])
        gains = np.array([-3.5, -15.8, np.nan, np.nan])
        state = learned(state, alternatives(6), 0.0, [Tried(ASIDE, gains, moved)], profiles(0, 0), CONFIG)
    off_rad, sigma_rad = weighed_faults.heading_if_aside(state, alternatives(6), CONFIG)
    assert np.degrees([off_rad, sigma_rad]) == pytest.approx([-0.25, 0.097], abs=0.01)
    assert weighed_faults.heading_if_aside(state, alternatives(1), CONFIG) is None


def test_what_a_solve_holds_of_the_heading_itself_is_no_word_of_the_masks():
    """Cameras that stand together: turned by a step each they cost what the solve holds the heading by, 0.38 nats."""
    state = WatchState()
    for _ in range(28):
        moved = np.array([[0.0, 0.0, -0.013 * step] for step in STEPS])
        gains = np.array([-0.37, -0.37, np.nan, np.nan])
        state = learned(state, alternatives(6), 0.0, [Tried(ASIDE, gains, moved)], profiles(0, 0), CONFIG)
    assert weighed_faults.heading_if_aside(state, alternatives(6), CONFIG) is None
    assert weighed_faults.heading_if_aside(WatchState(), alternatives(6), CONFIG) is None
