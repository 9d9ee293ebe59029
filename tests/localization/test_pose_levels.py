"""Levels of a pose by the state of a tracker: what is stated of the map, what cameras all round say of themselves."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from semloc_jax.cameras import Rig
from semloc_jax.fusion.measurements import FusedPose
from semloc_jax.localization import pose_levels
from semloc_jax.localization.other_calibrations import ASIDE, STEPS, alternatives
from semloc_jax.localization.track_config import TrackConfig
from semloc_jax.localization.watch_sums import Tried, WatchState, learned
from tests.localization.test_checkpoint import template
from tests.localization.test_watch import rig
from tests.localization.test_weighed_faults import profiles

NUM_LOOKS = 12


def all_round() -> Rig:
    """One camera that looks ahead and one that looks back."""
    two = rig(2)
    mounts = np.array(two.T_base_cam, np.float64)
    mounts[1, :3, :3] = Rotation.from_euler("z", 180.0, degrees=True).as_matrix() @ mounts[1, :3, :3]
    return two.with_places(mounts)


def levels(cameras: Rig, posts: float, map_sigma_m: float, step_costs_nats: float) -> pose_levels.PoseLevels:
    """After some looks in which posts and the right side say so much of what they do say else, and cameras that all
    look a step aside cost so much. The way has told the direction of travel to 0.5 deg."""
    config, names, watch = TrackConfig(), alternatives(len(cameras.names)), WatchState()
    said = np.array([1.0, posts, 1.0, posts])[:, None] * profiles(0.0, 0.0)
    for _ in range(NUM_LOOKS):
        moved = np.array([[0.0, 0.0, -0.013 * step] for step in STEPS])
        tried = Tried(ASIDE, np.array([-step_costs_nats, -step_costs_nats, np.nan, np.nan]), moved)
        watch = learned(watch, names, 0.0, [tried], said, config.watch)
    covariance = np.diag([0.02, 0.01, 0.01, 0.001, 0.001, 0.001]) ** 2
    fused = FusedPose(0.0, np.eye(4), covariance, 1.0, 0.0, np.zeros(2), 0.0, 0.0049, 0.0)
    state = template()._replace(watch=watch)
    return pose_levels.levels_of(
        pose_levels.known_of(state, fused, cameras, 1.0, (map_sigma_m, map_sigma_m / 20.0), config)
    )


def test_a_street_with_lines_on_one_side_alone_is_held_by_what_is_stated_of_the_map():
    open_level, held = (levels(all_round(), 0.0, sigma_m, 10.0) for sigma_m in (0.0, 0.02))
    assert open_level.protection.lateral_m > 1.3 and open_level.protection.longitudinal_m > 4.0
    assert any("--map-sigma-m" in cause for cause in open_level.causes)
    assert held.protection.lateral_m < 0.2 and held.protection.longitudinal_m < 0.29 and not held.causes
    assert levels(all_round(), 1.0, 0.0, 10.0).protection.longitudinal_m < 0.29, "posts in view tell themselves"


@pytest.mark.parametrize(("step_costs_nats", "is_held"), [(1.0, True), (0.01, False)])
def test_masks_of_cameras_all_round_hold_the_heading_where_the_way_does_not(step_costs_nats, is_held):
    assert (levels(all_round(), 1.0, 0.02, step_costs_nats).protection.heading_deg < 0.5) == is_held
    assert levels(rig(2), 1.0, 0.02, step_costs_nats).protection.heading_deg > 0.5, "cameras that look ahead alone"
