"""Suspected faults of calibration and map: their size is found, they widen the levels, and they are told."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.metrics import ALERT_LIMITS
from semloc_jax.fusion.measurements import FusedPose
from semloc_jax.localization import watch
from semloc_jax.localization.integrity import ProtectionLevels
from semloc_jax.localization.watch_sums import (
    WatchConfig,
    WatchState,
    alternatives,
    learned,
    moves,
    next_rig,
    suspicions,
)

CONFIG = WatchConfig()
LEVELS = ProtectionLevels(0.05, 0.1, 0.12)


def rig(num: int) -> Rig:
    camera = PinholeCamera(500.0, 510.0, 320.0, 200.0, 640, 400)
    mounts = np.tile(np.eye(4), (num, 1, 1))
    mounts[:, :3, :3] = Rotation.from_euler("xyz", [-90.0, 0.0, -90.0], degrees=True).as_matrix()
    mounts[:, :3, 3] = [1.5, 0.0, 1.4]
    return Rig([camera] * num, mounts, [f"camera{k}" for k in range(num)])


def after_frames(num_cameras: int, cost, pose, profiles, num: int = 24) -> WatchState:
    """Frames whose cost and pose are given functions of the calibration's change, as `next_rig` asks for it."""
    state = WatchState()
    for k in range(num):
        at = k % (2 * len(alternatives(num_cameras)))
        unit = CONFIG.focal_share if at // 2 == 0 else CONFIG.turn_rad
        change = unit if at % 2 == 0 else -unit
        name = alternatives(num_cameras)[at // 2]
        state = learned(
            state, num_cameras, 0.0, cost(name, 0.0) - cost(name, change), pose(name, change), profiles, CONFIG
        )
    return state


def flat() -> np.ndarray:
    """Profiles of lines and posts that both fit at the pose."""
    return np.tile(20.0 * np.minimum(np.linalg.norm(moves(CONFIG), axis=1), 1.0), (2, 1))


def test_a_wrong_focal_length_is_found_with_its_size_and_what_it_does_to_the_pose():
    """The cost has its least value 4 % shorter, and a lens 1 % longer moves the pose 0.2 m back."""

    def pose(name, change):
        return np.array([-20.0 * change, 0.0, 0.0, 0.0, 0.0, 0.0])

    state = after_frames(1, lambda name, c: 0.5 * ((c + 0.04) / 0.01) ** 2, pose, flat())
    first = suspicions(state, 1, CONFIG)[0]
    assert (first.name, first.size) == ("focal", pytest.approx(-0.04, abs=1e-9))
    np.testing.assert_allclose(first.moved, [0.8, 0.0, 0.0], atol=1e-9)
    # 24 frames that forget over 40 are worth 18; each gains 8 nats, of which two do not count and three tenths are new.
    worth = np.sum(np.exp(-np.arange(24) / 40.0))
    assert first.nats == pytest.approx(0.3 * worth * (8.0 - CONFIG.least_gain_nats), rel=1e-6)


def test_a_drive_that_fits_raises_no_suspicion():
    state = after_frames(2, lambda name, c: 0.5 * (c / 0.01) ** 2, lambda name, c: np.zeros(6), flat())
    found = suspicions(state, 2, CONFIG)
    assert len(found) == 9 and max(s.nats for s in found) < 1e-9
    assert suspicions(WatchState(), 1, CONFIG) == []


def test_one_camera_of_two_is_named():
    def cost(name, change):
        return 0.5 * ((change - (0.02 if name == "yaw 1" else 0.0)) / 0.005) ** 2

    first = suspicions(after_frames(2, cost, lambda name, c: np.zeros(6), flat(), 40), 2, CONFIG)[0]
    assert (first.name, first.size) == ("yaw 1", pytest.approx(0.02))


@pytest.mark.parametrize(("group", "axis", "off_m"), [(1, 1, 0.5), (0, 0, -2.0), (1, 0, 1.0)])
def test_posts_that_fit_beside_the_lines_are_found(group, axis, off_m):
    profiles = flat()
    there = np.zeros(3)
    there[axis] = off_m
    profiles[group] = 20.0 * np.minimum(np.linalg.norm(moves(CONFIG) - there, axis=1), 1.0)
    state = after_frames(1, lambda name, c: 0.5 * (c / 0.01) ** 2, lambda name, c: np.zeros(6), profiles, 6)
    first = suspicions(state, 1, CONFIG)[0]
    assert first.name == ("lines", "posts")[group] + ("_ahead", "_left")[axis]
    assert first.size == pytest.approx(off_m) and first.nats > CONFIG.count_nats
    assert first.moved[axis] == pytest.approx(off_m)


def test_a_sound_axle_is_no_fault():
    """A real vehicle travels 0.27 deg beside its inertial unit."""
    state = WatchState(aside_rad=np.float64(np.deg2rad(0.27)))
    found = watch.separations(state, fused(), flat_road, rig(1), CONFIG)
    assert watch.with_faults(LEVELS, found) == LEVELS and watch.causes(LEVELS, found, ALERT_LIMITS[0]) == ()


def test_frames_without_numbers_leave_the_sums_alone():
    state = after_frames(1, lambda name, c: 0.5 * (c / 0.01) ** 2, lambda name, c: np.zeros(6), flat(), 4)
    after = learned(state, 1, 0.0, np.nan, np.zeros(6), np.full_like(flat(), np.nan), CONFIG)
    keep = np.exp(-1.0 / CONFIG.memory_frames)
    np.testing.assert_allclose(after.gain, keep * state.gain)
    np.testing.assert_allclose(after.profiles, keep * state.profiles)


def test_the_other_calibrations_take_turns():
    """Longer, shorter, then every camera down, up, left, right; axes as in scipy."""
    given = rig(2)
    told = [next_rig(WatchState(num_frames=np.int64(k)), given, CONFIG) for k in range(10)]
    assert [float(t.cameras[0].fx) for t in told[:3]] == pytest.approx([512.5, 487.5, 500.0])
    for k, axis, camera, sign in ((2, "y", 0, 1), (3, "y", 0, -1), (4, "z", 0, 1), (9, "z", 1, -1)):
        turn = Rotation.from_euler(axis, sign * CONFIG.turn_rad).as_matrix()
        np.testing.assert_allclose(
            told[k].T_base_cam[camera, :3, :3], turn @ np.asarray(given.T_base_cam)[camera, :3, :3], atol=1e-9
        )
        np.testing.assert_allclose(told[k].T_base_cam[1 - camera], given.T_base_cam[1 - camera])


def flat_road(T_map_base):
    """A road at height 0."""
    yaw = Rotation.from_matrix(T_map_base[:3, :3]).as_euler("ZYX")[0]
    T = np.eye(4)
    T[:3, :3], T[:2, 3] = Rotation.from_euler("z", yaw).as_matrix(), T_map_base[:2, 3]
    return T


def no_road(T_map_base):
    raise SemlocError("no road there")


def fused(travel_deg: float = 0.0, sigma_deg: float = 0.1, roll_deg: float = 0.0) -> FusedPose:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("x", roll_deg, degrees=True).as_matrix()
    angles = np.deg2rad([travel_deg, sigma_deg])
    return FusedPose(0.0, T, np.eye(6), 1.0, 0.0, np.zeros(2), float(angles[0]), float(angles[1]))


def test_cameras_that_look_aside_end_tracking_with_a_sentence():
    state = WatchState(aside_rad=np.float64(np.deg2rad(0.7)))
    found = watch.separations(state, fused(), flat_road, rig(1), CONFIG)
    levels = watch.with_faults(LEVELS, found)
    assert levels.heading_deg == pytest.approx(0.82) and levels.longitudinal_m == pytest.approx(0.1)
    assert levels.lateral_m == pytest.approx(0.05 + 1.5 * np.deg2rad(0.7))
    told = "camera camera0 looks 0.7 deg to the right of where the vehicle drives; run semloc calibrate"
    assert watch.causes(LEVELS, found, ALERT_LIMITS[0]) == (told,)


def test_a_rolled_camera_is_not_above_where_it_would_be():
    found = watch.separations(WatchState(), fused(roll_deg=2.0), flat_road, rig(1), CONFIG)
    assert watch.with_faults(LEVELS, found).lateral_m == pytest.approx(0.05 + 1.4 * np.deg2rad(2.0), rel=1e-3)
    nowhere = watch.separations(WatchState(), fused(roll_deg=2.0), no_road, rig(1), CONFIG)
    assert watch.with_faults(LEVELS, nowhere) == LEVELS


def test_levels_never_promise_more_than_a_survey():
    assert watch.at_least(LEVELS, CONFIG) == ProtectionLevels(*CONFIG.least_levels)
    wide = ProtectionLevels(1.0, 2.0, np.inf)
    assert watch.at_least(wide, CONFIG) == wide


def test_the_drive_alone_says_more_than_the_fusion_that_holds_it_near_zero():
    """A mean of 0.7 deg with 0.3 deg, held by a prior of 0.3 deg, comes out as 0.35 deg: the drive alone said 0.7."""
    known = 0.3 / np.sqrt(2.0)
    alone = watch._travel_alone(fused(0.35, known), CONFIG)
    wide = np.degrees(CONFIG.aside_sigma_rad)
    assert np.degrees(alone) == pytest.approx(0.7 / (1.0 + (0.3 / wide) ** 2), rel=1e-6)
    assert watch._travel_alone(fused(0.35, 0.0), CONFIG) == pytest.approx(np.deg2rad(0.35))


def test_every_suspicion_has_a_sentence():
    from semloc_jax.localization.watch_sums import CLASSES, Suspicion

    for name in (*alternatives(2), *CLASSES):
        told = watch._told(Suspicion(name, -0.03, 9.0, np.zeros(3)), rig(2))
        assert ("map_changes.csv" if name in CLASSES else "semloc calibrate") in told
    assert "fit 0.50 m to the left" in watch._told(Suspicion("posts_left", 0.5, 9.0, np.zeros(3)), rig(1))
