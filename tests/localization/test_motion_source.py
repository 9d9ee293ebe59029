"""Which sensors say how a vehicle moved, and what cameras and inertial sensor become for a localizer and for a map."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.datasets import open_drive
from semloc_jax.errors import SemlocError
from semloc_jax.fusion.inertial_motion import Moving
from semloc_jax.fusion.inertial_states import STATE
from semloc_jax.fusion.velocity_sample import VelocitySample
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.localization import motion_source
from semloc_jax.localization.motion_source import (
    SeenMotion,
    motion_log,
    resolved,
    resolved_without_map,
    scenery_of,
    with_seen_speed,
)
from semloc_jax.localization.odometry import OdometryFrame
from semloc_jax.mapping.chain import drive_chain
from semloc_jax.perception import load_class_table

GYRO_BIAS = 0.01
"""About z, as the odometry found it [rad/s]."""


@pytest.fixture(scope="module")
def drive(simulated_road):
    return open_drive(simulated_road)


@pytest.fixture(scope="module")
def masks(drive):
    return mask_source("sem", drive)


def seen_of(drive, num_start=1, num_followed=50):
    """What perfect cameras would say of the frames."""
    time_s = np.array([frame.time_s for frame in drive.frames])
    Ts = np.stack([drive.truth_at(frame) for frame in drive.frames])
    velocity = np.gradient(Ts[:, :3, 3], time_s, axis=0)
    bias = np.array([0.0, 0.0, GYRO_BIAS, 0.0, 0.0, 0.0])
    frames = [
        OdometryFrame(float(t), T, v, bias, np.full(STATE, np.nan), num_followed, 30, False)
        for t, T, v in zip(time_s, Ts, velocity, strict=True)
    ]
    for k in range(num_start - 1, len(frames)):
        sample = VelocitySample(Ts[k, :3, :3].T @ velocity[k], np.full(3, 0.05), np.full(3, 0.1), np.full(3, 8.0))
        frames[k] = frames[k]._replace(velocity=sample)
    return SeenMotion(tuple(frames), num_start, "")


def test_auto_takes_wheels_then_the_inertial_sensor_then_nothing(drive, caplog):
    caplog.set_level("INFO", logger="semloc_jax")
    bare = replace(drive, odometry=None)
    assert [resolved(one, "auto") for one in (drive, bare, replace(bare, imu=None))] == ["wheels", "vio", "wheels"]
    assert resolved(drive, "both") == "both"
    without = [drive, bare, replace(drive, imu=None), replace(bare, imu=None)]
    assert [resolved_without_map(one, "auto", ("front",)) for one in without] == ["both", "vio", "wheels", "wheels"]
    assert [record.message for record in caplog.records][-4:] == [
        "motion: wheels, cameras (front), inertial sensor",
        "motion: cameras (front), inertial sensor",
        "motion: wheels; no inertial data for --motion vio",
        "motion: wheels; no inertial data for --motion vio",
    ]
    with pytest.raises(SemlocError, match="no wheel odometry"):
        resolved(bare, "both")
    in_g = replace(bare, imu=replace(drive.imu, accel_mps2=drive.imu.accel_mps2 / 9.81))
    with pytest.raises(SemlocError, match="the unit is g"):
        resolved(in_g, "auto")
    assert resolved(replace(in_g, odometry=drive.odometry), "auto") == "wheels", "forces are not used there"
    with pytest.raises(SemlocError, match="no inertial data .* use --motion wheels"):
        resolved(replace(drive, imu=None), "vio")


def test_cameras_give_each_frame_after_the_start_one_velocity(drive, masks, monkeypatch, caplog):
    monkeypatch.setattr(motion_source, "with_images", lambda drive, cameras: tuple(cameras))
    monkeypatch.setattr(motion_source, "seen_motion", lambda *_: seen_of(drive, num_start=2))
    caplog.set_level("INFO")
    log = motion_log(drive, "vio", masks)
    first_s, second_s, third_s = (frame.time_s for frame in drive.frames)
    assert f"motion: cameras (front) from {second_s:.1f} s on, inertial sensor" in caplog.text
    T = drive.truth_at(drive.frames[0])
    moving = Moving(T[:3, :3], np.zeros(3), np.zeros(6), np.zeros((3, 3)))
    middle_s = 0.5 * (second_s + third_s)
    found = [log.increment(*ends, moving=moving).velocity for ends in ((first_s, second_s), (second_s, middle_s))]
    assert found[1] is None, "no image ends there"
    truth = seen_of(drive).frames[1]
    assert found[0].velocity_base == pytest.approx(truth.T_odom_base[:3, :3].T @ truth.velocity_odom)
    assert found[0].lasting_sigma == pytest.approx(0.1) and found[0].lasts_s == pytest.approx(8.0)
    monkeypatch.setattr(motion_source, "seen_motion", lambda *_: seen_of(drive, num_followed=3))
    blind = motion_log(drive, "vio", masks).increment(first_s, second_s, moving=moving)
    assert blind.velocity is None, "the inertial sensor is not counted twice, and wheels are not vio"


def test_a_map_is_made_of_the_speeds_of_cameras_less_the_bias_they_found(drive, masks, monkeypatch):
    monkeypatch.setattr(motion_source, "seen_motion", lambda *_: seen_of(drive))
    seen = with_seen_speed(replace(drive, odometry=None), masks, False)
    time_s, truth = seen.odometry.time_s, seen_of(drive).frames
    assert seen.odometry.speed_mps[0] == pytest.approx(np.linalg.norm(truth[0].velocity_odom), rel=1e-2)
    gyro = np.interp(time_s, drive.imu.time_s, drive.imu.gyro_radps[:, 2])
    assert seen.odometry.yaw_rate_radps == pytest.approx(gyro - GYRO_BIAS)
    way_m = np.linalg.norm(truth[-1].T_odom_base[:3, 3] - truth[0].T_odom_base[:3, 3])
    assert drive_chain(seen).way_m[-1] == pytest.approx(way_m, rel=0.01)


def test_a_map_without_wheels_and_without_a_start_says_both(drive, masks, monkeypatch):
    monkeypatch.setattr(motion_source, "seen_motion", lambda *_: SeenMotion((), 0, "the images are dark"))
    with pytest.raises(SemlocError, match="no wheel odometry, and .* no start: the images are dark"):
        with_seen_speed(replace(drive, odometry=None), masks, False)


@pytest.mark.parametrize("share", [1, 2])
def test_masks_hide_sky_and_traffic_and_say_where_the_road_is(drive, share):
    """In the size of the image: a pixel is usable, or road, where all of its part of the mask is. Beside traffic by as
    much as a patch reaches it is not: the skyline stands still, and is."""
    road, building, sky, car, unknown = 0, 2, 10, 13, 255
    camera, frame = drive.rig.names[0], replace(drive.frames[0], draw_dynamic=None)
    width, height = drive.rig.cameras[0].resolution
    ids = np.array([road, building, sky, car, unknown], np.uint8)
    mask = ids[np.random.default_rng(0).choice(5, (height * share, width * share), p=[0.65, 0.2, 0.1, 0.0, 0.05])]
    mask[60 * share : 70 * share, 90 * share : 110 * share] = car
    masks = MaskSource("drawn", load_class_table("cityscapes"), (camera,), lambda frame, name: mask)
    scenery = scenery_of(masks)(frame, camera)
    parts = mask.reshape(height, share, width, share)
    expected = ~(parts == sky).any(axis=(1, 3))
    expected[60 - 8 : 70 + 8, 90 - 8 : 110 + 8] = False
    np.testing.assert_array_equal(scenery.usable, expected)
    np.testing.assert_array_equal(scenery.road, (parts == road).all(axis=(1, 3)))
    assert scenery.usable.dtype == scenery.road.dtype == bool
