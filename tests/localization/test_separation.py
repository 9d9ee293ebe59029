"""A pose between the right one with a fault and the right one without it: its levels are half as far."""

import numpy as np
import pytest

from semloc_jax.fusion.measurements import FusedPose
from semloc_jax.localization.course import Course, heading_level_deg, turn_rad, turned
from semloc_jax.localization.integrity import ProtectionLevels
from semloc_jax.localization.separation import Separation, farthest, least_move, reach, separated, with_faults

OWN = ProtectionLevels(0.05, 0.1, 0.12)
ROOM = (0.29, 0.29, 0.4)


def test_what_has_a_side_reaches_there_only():
    lens = separated(np.array([0.3, -0.1, np.deg2rad(0.2)]), "lens")
    np.testing.assert_allclose(reach([lens]), [[-0.1, 0.0, 0.0], [0.0, 0.3, 0.2]])
    np.testing.assert_allclose(reach([lens, Separation(0.0, 0.2, 0.0, "motion")])[:, 1], [-0.2, 0.3])
    posts = separated(np.array([0.3, 0.0, 0.0]), "posts", is_sided=False)
    np.testing.assert_allclose(reach([posts])[:, 1], [-0.3, 0.3])


@pytest.mark.parametrize(
    ("ahead_m", "behind_m", "move_m"),
    [(0.15, 0.0, 0.0), (0.25, 0.0, 0.06), (0.0, 0.25, -0.06), (0.3, 0.05, 0.11), (0.25, 0.2, 0.0), (0.5, 0.0, 0.0)],
)
def test_a_pose_is_moved_as_little_as_its_level_asks_and_not_where_nothing_helps(ahead_m, behind_m, move_m):
    """0.29 m less 0.1 m of its own leave 0.19 m to either side; 0.5 m are more than both, as are 0.25 and 0.2 m."""
    faults = [separated(np.array([ahead_m, 0.0, 0.0]), ""), separated(np.array([-behind_m, 0.0, 0.0]), "")]
    move = least_move(OWN, reach(faults), ROOM)
    np.testing.assert_allclose(move, [0.0, move_m, 0.0], atol=1e-12)
    level = with_faults(OWN, farthest(reach(faults), move)).longitudinal_m
    assert (level <= 0.29 + 1e-9) == (ahead_m + behind_m < 0.38)
    # Whichever explanation is right, the pose that goes out is within its level of it.
    assert max(abs(ahead_m - move_m), abs(behind_m + move_m)) + OWN.longitudinal_m <= level + 1e-9


@pytest.mark.parametrize("aside_deg", [0.45, -0.45, 0.8, 0.1])
def test_a_heading_is_turned_towards_the_course_as_far_as_its_level_asks(aside_deg):
    """0.1 deg with two sigmas; beyond 0.3 deg of course the level would be beyond 0.5 deg."""
    way = Course(float(np.deg2rad(aside_deg)), float(np.deg2rad(0.1)))
    turn = turn_rad(0.0, way, np.inf, 0.02275, 0.5)
    wanted = max(abs(aside_deg) + 0.2 - 0.5, 0.0)
    assert np.degrees(turn) == pytest.approx(np.sign(aside_deg) * wanted, abs=1e-4)
    level_deg = heading_level_deg(*turned(0.0, way, turn), np.inf, 0.02275)
    assert level_deg <= 0.5 + 1e-6
    assert turn_rad(0.0, way._replace(sigma_rad=0.01), np.inf, 0.02275, 0.5) == 0.0  # 1.1 deg to both sides


def test_a_moved_pose_drives_where_it_did():
    pose = FusedPose(0.0, np.eye(4), np.eye(6), 1.0, 0.0, np.zeros(2), 0.01)
    moved = pose.moved(0.2, -0.1, np.degrees(0.004))
    np.testing.assert_allclose(moved.T_map_base[:2, 3], [-0.1, 0.2], atol=1e-3)
    assert np.arctan2(moved.T_map_base[1, 0], moved.T_map_base[0, 0]) + moved.travel_rad == pytest.approx(0.01)
