"""A vehicle calibrated by small simulated drives: what comes back, and what is said where something is missing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from semloc_jax.alignment.frame_localizer import LocalizeConfig
from semloc_jax.alignment.scene import ViewLimits
from semloc_jax.calibration import Knowledge, SelfCalibrationConfig, self_calibrate
from semloc_jax.calibration.frames import StartPoses, motion_between
from semloc_jax.calibration.self_calibration import calibrate_from, mount_change
from semloc_jax.cameras import Rig
from semloc_jax.datasets import open_drive
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.inputs.priors import prior_source
from semloc_jax.maps import read_map
from semloc_jax.simulation import SimulationConfig, simulate

CONFIG = SelfCalibrationConfig(LocalizeConfig(view=ViewLimits(capacity=512)), levels=(1, 3))
TURN_DEG, SHIFT_M = np.array([1.0, -1.0, 1.5]), np.array([0.03, 0.03, 0.026])


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """Ten frames of one front camera over 50 m."""
    size = SimulationConfig(num_frames=10, rate_hz=2.0, width_px=480, height_px=300, has_images=False)
    return simulate("road", 7, tmp_path_factory.mktemp("calibration") / "road", size)


def turned(drive):
    """The drive with a calibration that is off by TURN_DEG and SHIFT_M."""
    T = np.array(drive.rig.T_base_cam)
    T[:, :3, :3] = Rotation.from_euler("xyz", TURN_DEG, degrees=True).as_matrix() @ T[:, :3, :3]
    T[:, :3, 3] += SHIFT_M
    rig = Rig(drive.rig.cameras, T, drive.rig.names)
    return replace(drive, rig=rig, frames=tuple(replace(frame, rig=rig) for frame in drive.frames))


def calibrated(drive, seed=0):
    """The result from start poses that are off by 30 cm and 1 deg, without the localizer that finds them."""
    rng = np.random.default_rng(seed)
    poses = np.stack([drive.truth_at(frame) for frame in drive.frames])
    poses[:, :2, 3] += rng.normal(0.0, 0.3, (len(poses), 2))
    turns = Rotation.from_rotvec(np.radians(rng.normal(0.0, 1.0, len(poses)))[:, None] * [0.0, 0.0, 1.0])
    poses[:, :3, :3] = poses[:, :3, :3] @ turns.as_matrix()
    start = StartPoses(drive.frames, poses, motion_between(drive, drive.frames, CONFIG))
    return calibrate_from(start, drive, read_map(drive.map_path), mask_source("sem", drive), CONFIG)


@pytest.mark.slow
def test_a_turned_camera_comes_back_and_where_it_sits_is_named_unobservable(drive):
    found = calibrated(turned(drive))
    off = mount_change(np.asarray(drive.rig.T_base_cam[0]), np.asarray(found.rig.T_base_cam[0]))
    assert found.converged
    assert np.abs(np.degrees(off[3:])).max() < 0.1
    assert abs(off[2]) < 0.02
    verdicts = {name: found.observability.parameter(f"front {name}").verdict for name in ("x", "y", "pitch", "yaw")}
    assert verdicts == {
        "x": Knowledge.HELD,
        "y": Knowledge.HELD,
        "pitch": Knowledge.OBSERVABLE,
        "yaw": Knowledge.OBSERVABLE,
    }
    scale, sigma = found.vehicle["odometer_scale"], found.observability.parameter("odometer_scale").sigma
    assert abs(scale - 1.0) > 5 * sigma  # the wheels of the simulation are off, and it is seen


@pytest.mark.slow
def test_without_wheels_the_mount_is_found_and_the_scale_stays(drive):
    found = calibrated(replace(turned(drive), odometry=None, imu=None))
    off = mount_change(np.asarray(drive.rig.T_base_cam[0]), np.asarray(found.rig.T_base_cam[0]))
    yaw = found.observability.parameter("front yaw")
    # Frames 5 m apart: between them the turn may have changed, which the sigma knows.
    assert abs(np.degrees(off[5])) < 3 * yaw.sigma < 0.6
    assert np.abs(np.degrees(off[3:5])).max() < 0.15
    assert found.vehicle["odometer_scale"] == pytest.approx(1.0, abs=1e-9)
    assert found.observability.parameter("odometer_scale").verdict is Knowledge.HELD
    assert [note for note in found.notes if note.startswith("no wheel odometry: ")]


@pytest.mark.slow
def test_a_standing_vehicle_is_told_that_it_has_to_move(drive):
    first, num = turned(drive).frames[3], len(drive)
    still = drive.truth_at(drive.frames[3])
    times = drive.frames[0].time_s + 0.5 * np.arange(num)
    odometry = replace(drive.odometry, speed_mps=0.0 * drive.odometry.speed_mps)
    odometry = replace(odometry, yaw_rate_radps=0.0 * odometry.yaw_rate_radps)
    standing = replace(
        turned(drive),
        frames=tuple(replace(first, time_s=float(time)) for time in times),
        truth=replace(drive.truth, T_map_base=np.tile(still, (len(drive.truth.time_s), 1, 1))),
        odometry=odometry,
        imu=None,
        gnss=None,
    )
    found = calibrated(standing)
    assert found.observability.parameter("front yaw").verdict is not Knowledge.OBSERVABLE
    assert "no satellite fixes: the GNSS offset stays" in found.notes
    assert any("moved 0.0 m only" in note for note in found.notes)


def test_too_few_frames_are_refused(simulated_road):
    short = open_drive(simulated_road)
    masks, prior = mask_source("sem", short), prior_source("truth", short)
    with pytest.raises(SemlocError, match="has 3 frames; expected at least 5 to calibrate with; record a longer drive"):
        self_calibrate(short, read_map(short.map_path), masks, prior)
