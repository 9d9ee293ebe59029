"""Suspected faults of calibration and map: their size is found, they widen the levels, and they are told."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from semloc_jax.alignment.class_profiles import GROUPS
from semloc_jax.cameras import BrownConradyCamera, PinholeCamera, Rig
from semloc_jax.evaluation.metrics import ALERT_LIMITS
from semloc_jax.localization import lens_sign, separation, told_faults
from semloc_jax.localization.integrity import ProtectionLevels
from semloc_jax.localization.moved_elements import moves
from semloc_jax.localization.other_calibrations import ASIDE, STEPS, alternatives, changed_rigs, unit_of, widths
from semloc_jax.localization.stance_sums import StanceState, mount_tilt_rad
from semloc_jax.localization.stance_sums import learned as stood
from semloc_jax.localization.suspicions import suspicions
from semloc_jax.localization.watch_config import WatchConfig
from semloc_jax.localization.watch_sums import Tried, WatchState, asked_now, far_side, far_sides, learned

CONFIG = WatchConfig()
LEVELS = ProtectionLevels(0.05, 0.1, 0.12)


def rig(num: int) -> Rig:
    camera = PinholeCamera(500.0, 510.0, 320.0, 200.0, 640, 400)
    mounts = np.tile(np.eye(4), (num, 1, 1))
    mounts[:, :3, :3] = Rotation.from_euler("xyz", [-90.0, 0.0, -90.0], degrees=True).as_matrix()
    mounts[:, :3, 3] = [1.5, 0.0, 1.4]
    return Rig([camera] * num, mounts, [f"camera{k}" for k in range(num)])


def after_frames(num_cameras: int, cost, pose, profiles, num: int = 24) -> WatchState:
    """Frames whose cost and pose are given functions of the calibration's change, as `next_rigs` asks for it."""
    state, names = WatchState(), alternatives(num_cameras)
    for _ in range(num):
        tried = []
        for name in asked_now(state, names, CONFIG):
            changes = STEPS * unit_of(name, CONFIG)
            gains = np.array([cost(name, 0.0) - cost(name, change) for change in changes])
            asked = [True, True, *(far_side(state, names, name) == side for side in (0, 1))]
            steps = np.array([pose(name, change) for change in changes])
            tried.append(Tried(name, np.where(asked, gains, np.nan), steps))
        state = learned(state, names, 0.0, tried, profiles, CONFIG)
    return state


def with_faults(found: list[separation.Separation]) -> ProtectionLevels:
    """Levels of a pose that stays where it is."""
    return separation.with_faults(LEVELS, separation.farthest(separation.reach(found), np.zeros(3)))


def flat() -> np.ndarray:
    """Profiles of lines, posts and both sides that all fit at the pose."""
    return np.tile(20.0 * np.minimum(np.linalg.norm(moves(CONFIG), axis=1), 1.0), (len(GROUPS), 1))


@pytest.mark.parametrize("wrong", ["focal", "radial", "width"])
def test_a_wrong_lens_is_found_with_its_size_and_what_it_does_to_the_pose(wrong):
    """The cost has its least value 4 % narrower, and a lens 1 % wider moves the pose 0.2 m back."""

    def pose(name, change):
        return np.array([-20.0 * change, 0.0, 0.0])

    def cost(name, change):
        return 0.5 * ((change + (0.04 if name == wrong else 0.0)) / 0.01) ** 2

    state = after_frames(1, cost, pose, flat())
    first = suspicions(state, 1, CONFIG)[0]
    assert (first.name, first.size) == (wrong, pytest.approx(-0.04, abs=1e-9))
    np.testing.assert_allclose(first.moved, [0.8, 0.0, 0.0], atol=1e-9)
    # Every frame asks for it at first, twice, later every third; each gains 8 nats, of which two (of a width: four) do
    # not count and three tenths are new.
    asked = np.r_[: CONFIG.eager_looks, CONFIG.eager_looks + alternatives(1).index(wrong) : 24 : 3]
    worth = 2.0 * np.sum(np.exp(-(23 - asked) / 40.0))
    least_nats = CONFIG.width_gain_nats[0] if wrong == "width" else CONFIG.least_gain_nats
    assert first.nats == pytest.approx(0.3 * worth * (8.0 - least_nats), rel=1e-6)


def test_a_drive_that_fits_raises_no_suspicion():
    state = after_frames(2, lambda name, c: 0.5 * (c / 0.01) ** 2, lambda name, c: np.zeros(3), flat())
    found = suspicions(state, 2, CONFIG)
    assert len(found) == 13 and max(s.nats for s in found) < 1e-9
    assert suspicions(WatchState(), 1, CONFIG) == []


def test_one_frame_that_likes_another_lens_is_no_suspicion():
    state = WatchState()
    for k in range(24):
        gains = np.array([6.0 if k == 7 else -3.0, -3.0, np.nan, np.nan])
        assert far_side(state, alternatives(1), "focal") is None
        tried = [Tried(name, gains, np.ones((4, 3))) for name in asked_now(state, alternatives(1), CONFIG)]
        state = learned(state, alternatives(1), 0.0, tried, flat(), CONFIG)
    assert max(s.nats for s in suspicions(state, 1, CONFIG)) == 0.0


def test_one_camera_of_two_is_named():
    def cost(name, change):
        return 0.5 * ((change - (0.02 if name == "yaw 1" else 0.0)) / 0.005) ** 2

    first = suspicions(after_frames(2, cost, lambda name, c: np.zeros(3), flat(), 40), 2, CONFIG)[0]
    assert (first.name, first.size) == ("yaw 1", pytest.approx(0.02))


@pytest.mark.parametrize(
    ("group", "axis", "off_m"), [(1, 1, 0.5), (0, 0, -2.0), (1, 0, 1.0), (2, 1, 0.5), (3, 1, -0.3)]
)
def test_what_fits_beside_all_else_is_found(group, axis, off_m):
    profiles = flat()
    there = np.zeros(3)
    there[axis] = off_m
    profiles[group] = 20.0 * np.minimum(np.linalg.norm(moves(CONFIG) - there, axis=1), 1.0)
    state = after_frames(1, lambda name, c: 0.5 * (c / 0.01) ** 2, lambda name, c: np.zeros(3), profiles, 6)
    first = suspicions(state, 1, CONFIG)[0]
    assert first.name == GROUPS[group] + ("_ahead", "_left")[axis]
    assert first.size == pytest.approx(off_m) and first.nats > CONFIG.count_nats
    assert first.moved[axis] == pytest.approx(off_m)


def test_posts_are_doubted_as_soon_as_lines_alone_fit_elsewhere_in_every_frame():
    """One nat a frame a metre ahead is little, and on a drive where posts stand where they should it never is so."""
    profiles = flat()
    ahead = moves(CONFIG)[:, 0] == 1.0
    profiles[0][ahead] = -1.0
    state = after_frames(1, lambda name, c: 0.5 * (c / 0.01) ** 2, lambda name, c: np.zeros(3), profiles, 12)
    found = told_faults.spoken_for(state, rig(1), CONFIG)
    assert with_faults(found).longitudinal_m == pytest.approx(LEVELS.longitudinal_m + 1.0)
    after_one = after_frames(1, lambda name, c: 0.5 * (c / 0.01) ** 2, lambda name, c: np.zeros(3), profiles, 1)
    assert with_faults(told_faults.spoken_for(after_one, rig(1), CONFIG)) == LEVELS


def test_what_one_frame_does_not_say_again_is_doubted_on():
    """Half a metre; a metre further nothing is said: exp(-1 / 8) of it. Then a smaller doubt, and a larger one."""
    said = [separation.Separation(0.0, 0.5, 0.0, "lines fit 0.5 m ahead")]
    at_first = separation.remembered(np.zeros((2, 3)), said, 1.0, CONFIG)
    assert separation.lasting(at_first, said) == []
    later = separation.remembered(at_first, [], 1.0, CONFIG)
    behind, ahead = separation.lasting(later, [])
    assert ahead.longitudinal_m == pytest.approx(0.5 * np.exp(-0.125)) and "not been cleared" in ahead.cause
    assert (behind.side[1], ahead.side[1]) == (-1.0, 1.0)
    smaller = [separation.Separation(0.1, 0.2, 0.0, "")]
    both = separation.remembered(later, smaller, 0.0, CONFIG)
    np.testing.assert_allclose(both, np.outer([-1.0, 1.0], [0.1, ahead.longitudinal_m, 0.0]))
    assert np.abs(separation.remembered(later, [], 80.0, CONFIG)).max() < 1e-4
    # A vehicle that stands sees the same errors again and clears nothing.
    np.testing.assert_array_equal(separation.remembered(later, [], 0.0, CONFIG), later)


def test_frames_without_numbers_leave_the_sums_alone():
    state = after_frames(1, lambda name, c: 0.5 * (c / 0.01) ** 2, lambda name, c: np.zeros(3), flat(), 4)
    after = learned(
        state,
        alternatives(1),
        0.0,
        [Tried("focal", np.full(4, np.nan), np.zeros((4, 3)))],
        np.full_like(flat(), np.nan),
        CONFIG,
    )
    keep = np.exp(-1.0 / CONFIG.memory_frames)
    np.testing.assert_allclose(after.gain, keep * state.gain)
    np.testing.assert_allclose(after.profiles, keep * state.profiles)


def test_the_other_calibrations_take_turns():
    """Lenses, the width of the road and the yaw of all cameras at first; then they and every camera's pitch and yaw."""
    at = [asked_now(WatchState(num_frames=np.int64(k)), alternatives(2), CONFIG) for k in range(CONFIG.eager_looks + 8)]
    assert set(at[: CONFIG.eager_looks]) == {("focal", "radial", "width", "yaw all")}
    assert sorted(name for (name,) in at[CONFIG.eager_looks :]) == sorted(alternatives(2))


def test_small_masks_are_asked_for_the_focal_lengths_in_every_look_and_on_both_sides():
    at = [asked_now(WatchState(num_frames=np.int64(k)), alternatives(1), CONFIG, True) for k in range(24)]
    assert all("focal" in names for names in at)
    assert [names for names in at[CONFIG.eager_looks :]].count(("focal",)) == 4
    sides = [far_sides(WatchState(), alternatives(1), name, is_small=True) for name in ("focal", "radial")]
    assert sides == [(0, 1), ()]


def test_four_cameras_do_not_forget_what_the_start_of_a_drive_told():
    """One of a dozen calibrations is asked a frame: what all frames have told of one gets no less on the way."""
    names = alternatives(4)
    row = len(STEPS) * names.index(ASIDE)

    def looks(num: int) -> float:
        state = after_frames(4, lambda name, c: 0.5 * (c / 0.01) ** 2, lambda name, c: np.zeros(3), flat(), num)
        return float(state.num[row])

    start = looks(CONFIG.eager_looks)
    assert start > 10.0
    assert all(looks(CONFIG.eager_looks + num * len(names)) > 0.9 * start for num in (1, 5, 12))


def test_the_other_calibrations_differ_as_they_say():
    """Longer and shorter, bent and unbent, every camera down and up, left and right; axes as in scipy."""
    given = rig(2)
    told = {name: changed_rigs(given, name, CONFIG) for name in alternatives(2)}
    assert [float(t.cameras[0].fx) for t in (*told["focal"], told["pitch 0"][0])] == pytest.approx(
        [512.5, 487.5, 525.0, 475.0, 500.0]
    )
    # At the side of the image, 320 px from its centre, a ray lies 5 % farther out or in.
    side = np.array([[0.64, 0.0, 1.0]])
    shifts = [float(t.cameras[1].project(side)[0][0, 0]) - 640.0 for t in told["radial"]]
    assert shifts == pytest.approx([16.0, -16.0, 32.0, -32.0], abs=0.01)
    for name, axis, camera in (("pitch 0", "y", 0), ("yaw 0", "z", 0), ("yaw 1", "z", 1)):
        for sign, other in zip(STEPS, told[name], strict=True):
            turn = Rotation.from_euler(axis, sign * CONFIG.turn_rad).as_matrix()
            np.testing.assert_allclose(
                other.T_base_cam[camera, :3, :3], turn @ np.asarray(given.T_base_cam)[camera, :3, :3], atol=1e-9
            )
            np.testing.assert_allclose(other.T_base_cam[1 - camera], given.T_base_cam[1 - camera])
            if name == "yaw 1":
                both = told["yaw all"][STEPS.tolist().index(sign)]
                np.testing.assert_allclose(both.T_base_cam[1], other.T_base_cam[1])
                np.testing.assert_allclose(both.T_base_cam[0], told["yaw 0"][STEPS.tolist().index(sign)].T_base_cam[0])


def test_a_road_of_another_width_moves_the_lenses_nowhere():
    given = rig(2)
    assert all(other is given for other in changed_rigs(given, "width", CONFIG))
    np.testing.assert_allclose(widths("width", CONFIG), [0.2, -0.2, 0.4, -0.4, 0.0])
    assert not any(widths("focal", CONFIG))


@pytest.mark.parametrize(
    ("height_m", "open_m", "is_told"), [(0.0, 0.0, False), (0.04, 0.0, True), (-0.04, 0.0, False), (0.04, 0.03, False)]
)
def test_a_narrower_road_is_doubted_sooner_where_the_vehicle_stands_higher(height_m, open_m, is_told):
    """Three nats a frame are what a real drive may say; with a height that the width would account for they are not.
    What the map leaves open of the height says nothing."""

    def cost(name, change):
        return 0.0 if name != "width" else 3.0 * ((change + 0.2) / 0.2) ** 2

    state = after_frames(1, cost, lambda name, change: np.array([change, 0.0, 0.0]), flat(), 3)
    stance = stood(state.stance, np.array([height_m, 0.0, 0.0]), np.array([open_m, 0.0, 0.0]), 1.0)
    state = state._replace(stance=stance)
    assert bool(told_faults.spoken_for(state, rig(1), CONFIG)) == is_told


def test_which_side_of_a_narrower_road_was_moved_is_not_known():
    """0.3 m narrower, the pose 0.4 m ahead and 0.1 m to the left of the middle: 0.05 m to the right, or 0.25 m left."""

    def cost(name, change):
        return 0.5 * ((change + (0.3 if name == "width" else 0.0)) / 0.05) ** 2

    def pose(name, change):
        return np.array([0.4, 0.1, 0.0]) * change / -0.3

    found = told_faults.spoken_for(after_frames(1, cost, pose, flat(), 2), rig(1), CONFIG)
    reached = separation.reach(found)
    np.testing.assert_allclose(reached, [[-0.05, 0.0, 0.0], [0.25, 0.4, 0.0]], atol=1e-9)
    assert {one.cause for one in found} == {
        "masks fit better with a road that is 0.30 m narrower than in the map; see map_changes.csv"
    }


def rolled(roll_deg, open_deg: float, way_m: float) -> StanceState:
    """A drive past looks 2 m apart; `roll_deg` of the number of the look."""
    state = StanceState()
    for k in range(int(way_m / 2.0)):
        state = stood(state, np.deg2rad([0.0, roll_deg(k), 0.0]), np.deg2rad([0.0, open_deg, 0.0]), 2.0)
    return state


OWN_RAD = np.deg2rad(0.5)


def test_a_camera_that_is_rolled_in_every_place_is_told_from_a_vehicle_that_nods():
    lasting = mount_tilt_rad(rolled(lambda k: 2.0, 0.0, 200.0), OWN_RAD, CONFIG.mount_sigma_deg)
    assert np.degrees(lasting) == pytest.approx([2.0, 0.0], abs=0.1)
    nodding = mount_tilt_rad(rolled(lambda k: 2.0 * np.sin(0.7 * k), 0.0, 200.0), OWN_RAD, CONFIG.mount_sigma_deg)
    assert abs(np.degrees(nodding[0])) < 0.1
    # One look says little: half a degree of its own against a degree of the mount leaves four fifths.
    first = mount_tilt_rad(rolled(lambda k: 2.0, 0.0, 2.0), OWN_RAD, CONFIG.mount_sigma_deg)
    assert np.degrees(first[0]) == pytest.approx(1.6)
    assert (mount_tilt_rad(StanceState(), OWN_RAD, CONFIG.mount_sigma_deg) == 0.0).all()


def test_a_crown_that_the_map_has_not_is_no_tilt_of_the_camera():
    """The map leaves 2 deg open, on one side all along the road: averaging does not take that away."""
    crowned = mount_tilt_rad(rolled(lambda k: 1.2, 2.0, 400.0), OWN_RAD, CONFIG.mount_sigma_deg)
    assert np.degrees(crowned[0]) == pytest.approx(1.2 / (1.0 + 4.0), rel=0.02)


def test_a_rolled_camera_is_not_above_where_it_would_be():
    found = told_faults.separations(WatchState(stance=rolled(lambda k: 2.0, 0.0, 200.0)), rig(1), CONFIG)
    assert with_faults(found).lateral_m == pytest.approx(0.05 + 1.4 * np.deg2rad(2.0), rel=0.02)


def test_levels_never_promise_more_than_a_survey():
    lateral_m, longitudinal_m, heading_deg = separation.at_least(LEVELS, CONFIG)
    assert (lateral_m, longitudinal_m) == CONFIG.least_levels[:2]
    assert heading_deg == pytest.approx(np.hypot(LEVELS.heading_deg, 0.3))  # a camera is mounted to tenths of a degree
    rolled_m = np.array([0.06, 0.0, 0.0])  # what is seen and what is too small for it are independent
    assert separation.at_least(LEVELS, CONFIG, rolled_m).lateral_m == pytest.approx(np.hypot(lateral_m, 0.06))
    wide = ProtectionLevels(1.0, 2.0, np.inf)
    assert separation.at_least(wide, CONFIG) == wide


def test_every_suspicion_has_a_sentence():
    from semloc_jax.localization.moved_elements import CLASSES
    from semloc_jax.localization.watch_sums import Suspicion

    for name in (*alternatives(2), *CLASSES):
        if name == ASIDE:  # weighed, and told by its levels
            continue
        told = told_faults._told(Suspicion(name, -0.03, 9.0, np.zeros(3)), rig(2))
        assert ("map_changes.csv" if name in (*CLASSES, "width") else "semloc calibrate") in told
    assert "fit 0.50 m to the left" in told_faults._told(Suspicion("posts_left", 0.5, 9.0, np.zeros(3)), rig(1))


def bent_rig() -> Rig:
    straight = rig(1)
    return Rig([BrownConradyCamera(500.0, 510.0, 320.0, 200.0, 640, 400, -0.3, 0.1)], straight.T_base_cam, ["front"])


@pytest.mark.parametrize(
    ("gains", "told"), [([], False), ([2.0], True), ([0.5] * 20, True), ([-12.0], False), ([-0.1] * 90, False)]
)
def test_levels_reach_to_the_pose_of_the_other_sign_until_the_drive_speaks_against_it(gains, told):
    state = lens_sign.SignState()
    for gain in (*gains, np.nan):
        state = lens_sign.learned(state, gain, np.array([-0.35, 0.02, 0.001]))
    found = told_faults.separations(WatchState(sign=state), bent_rig(), CONFIG)
    wide = with_faults(found)
    assert wide.longitudinal_m == pytest.approx(LEVELS.longitudinal_m + (0.35 if told else 0.0))
    causes = separation.causes(LEVELS, found, ALERT_LIMITS[0])
    assert [("distortion of camera front may have the wrong sign" in cause) for cause in causes] == [True] * told
