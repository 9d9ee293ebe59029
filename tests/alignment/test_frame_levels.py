"""Levels of one frame: its noise, its mounts, its map, places and faults that may be the right ones instead."""

import numpy as np
import pytest

from semloc_jax.alignment.candidates import planar
from semloc_jax.alignment.fault_modes import FaultConfig, FaultMode
from semloc_jax.alignment.frame_levels import FrameLevels, levels_of, mount_variance
from semloc_jax.alignment.result import FoundModes, Mode
from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.evaluation.metrics import ALERT_LIMITS
from semloc_jax.structs import SolveStatus

STREET = ALERT_LIMITS[0]
SIGMA = np.array([0.02, 0.01, 0.05, 0.01, 0.01, 0.0005])


def mode(weight: float = 1.0, ahead_m: float = 0.0) -> Mode:
    T = planar(np.array([ahead_m]), np.zeros(1), 0.0)[0]
    return Mode(weight, T, np.diag(SIGMA**2), 0.0, 0.2, 0.9, 0.8, np.eye(6)[0])


def found(*modes: Mode, faults: tuple[FaultMode, ...] = ()) -> FoundModes:
    sound = np.diag(SIGMA[[0, 1, 5]] ** 2)
    return FoundModes(modes, SolveStatus.CONVERGED, 1, sound, faults)


def test_a_sure_pose_is_bounded_by_what_a_survey_leaves_open_and_nothing_by_nothing():
    levels = levels_of(found(mode()), np.zeros(3), STREET)
    assert levels.protection == (0.15, 0.25, 0.3) and levels.misleading < 1e-6
    assert levels_of(FoundModes((), SolveStatus.NO_EVIDENCE, 0), np.zeros(3), STREET) == FrameLevels()


def test_a_rival_place_is_within_the_level_as_long_as_it_is_more_probable_than_the_risk():
    near = levels_of(found(mode(0.95), mode(0.05, 12.0)), np.zeros(3), STREET)
    assert near.protection[1] == pytest.approx(12.0, abs=0.1) and near.misleading == pytest.approx(0.05, rel=1e-3)
    assert levels_of(found(mode(1.0 - 1e-5), mode(1e-5, 12.0)), np.zeros(3), STREET).protection[1] == 0.25


def test_a_fault_that_is_as_probable_as_none_reaches_to_its_pose():
    moved = FaultMode(1.0, 0.003, np.array([-2.0, 0.3, 0.0]), np.diag([0.05, 0.05, 0.001]) ** 2, "posts")
    levels = levels_of(found(mode(), faults=(moved,)), np.zeros(3), STREET)
    assert levels.misleading == pytest.approx(0.5 + 0.5 * 0.57, abs=0.05)  # along for sure, across by its noise
    assert 2.1 < levels.protection[1] < 2.4 and 0.4 < levels.protection[0] < 0.7


def test_what_mounts_and_map_leave_open_has_the_tails_of_a_gaussian():
    """A camera 1.5 m ahead and 1.2 m high that may be turned by 0.15 deg, in a map that is right to 5 cm."""
    T_base_cam = np.eye(4)[None].copy()
    T_base_cam[0, :3, 3] = [1.5, 0.0, 1.2]
    rig = Rig([PinholeCamera(500.0, 500.0, 320.0, 200.0, 640, 400)], T_base_cam, ["front"])
    of_mount = mount_variance(rig, FaultConfig(mount_sigma_deg=0.15))
    assert np.sqrt(of_mount) == pytest.approx(np.deg2rad(0.15) * np.array([1.2, np.hypot(1.5, 1.2), 1.0]))
    levels = levels_of(found(mode()), of_mount + np.array([0.05, 0.05, 0.0]) ** 2, STREET)
    assert levels.protection[2] == pytest.approx(3.59 * 0.15, rel=0.03)
    assert levels.protection[0] == pytest.approx(3.59 * np.hypot(0.051, 0.005), rel=0.03)
