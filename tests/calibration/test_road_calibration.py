"""Cameras calibrated by the road alone: lines that are known exactly, and the shared drives with mounts knocked off."""

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from semloc_jax.calibration import CalibrationPriors, Knowledge, SelfCalibrationConfig
from semloc_jax.calibration.road_calibration import calibrate_on_road
from semloc_jax.calibration.road_fit import RoadCalibrationConfig, fit_to_lines, observability, start_fit
from semloc_jax.calibration.road_lines import laid, match_lines
from semloc_jax.calibration.road_spots import SpotFinder
from semloc_jax.calibration.road_streaks import Streak
from semloc_jax.calibration.self_calibration import mount_change
from semloc_jax.cameras import Rig
from semloc_jax.cli.main import main
from semloc_jax.datasets import Frame, open_drive
from semloc_jax.errors import SemlocError
from semloc_jax.fusion.prediction import MotionIncrement, MotionQuality
from semloc_jax.geometry.rigid import planar_pose
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.perception import load_class_table
from semloc_jax.structs import ElementClass
from tests.perception.four_fisheyes import four_fisheyes, photographed, road_picture

NUM = 12
REACH_M = 6.0


def knocked(rig, seed=1, deg=1.0, shift_m=0.1):
    """The rig with each mount turned by a degree and shifted by 10 cm, in directions of their own."""
    rng, T = np.random.default_rng(seed), np.array(rig.T_base_cam, np.float64)
    for pose in T:
        axis, way = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        pose[:3, :3] = Rotation.from_rotvec(np.deg2rad(deg) * axis).as_matrix() @ pose[:3, :3]
        pose[:3, 3] += shift_m * way
    return Rig(rig.cameras, T, rig.names)


def way(turn_deg):
    """Poses 0.8 m apart, straight ahead first, then along an arc."""
    poses = [np.eye(4)]
    for step in range(NUM - 1):
        poses.append(poses[-1] @ planar_pose(0.8, 0.0, np.deg2rad(turn_deg) * (step > NUM // 2)))
    return np.stack(poses)


def driven(poses):
    """What perfect wheels and a gyroscope say of the way, with the derivative by their scale and bias."""
    found = []
    for first, second in pairwise(poses):
        step = np.linalg.inv(first) @ second
        jacobian = np.zeros((6, 3))
        jacobian[0, 0], jacobian[5, 1] = 0.8, -0.4
        sigma = np.array([0.005, 0.003, 0.003, 5e-4, 5e-4, 5e-4])
        found.append(MotionIncrement(step, np.diag(sigma**2), 0.0, 0.4, jacobian, MotionQuality.OK))
    return found


def painted_slots():
    """Slot lines to both sides of the way: dividers, and bars across their mouths; start and end [m]."""
    lines = []
    for x in np.arange(-6.0, 16.0, 2.5):
        for side in (1.0, -1.0):
            lines += [((x, side * 2.6), (x, side * 5.0)), ((x - 0.7, side * 2.6), (x + 0.7, side * 2.6))]
    return np.array(lines)


def seen(rig, poses, lines):
    """What each camera sees of each line: rays along it and to the ends that are near."""
    streaks = []
    for frame, T_odom_base in enumerate(poses):
        for camera, T_base_cam in enumerate(np.asarray(rig.T_base_cam)):
            T = T_odom_base @ T_base_cam
            for start, end in lines:
                s = np.linspace(0.0, 1.0, 9)[:, None]
                points = np.column_stack([start + s * (end - start), np.zeros(9)])
                p_cam = (points - T[:3, 3]) @ T[:3, :3]
                rays = p_cam / np.linalg.norm(p_cam, axis=1, keepdims=True)
                near = np.linalg.norm(points[:, :2] - T[:2, 3], axis=1) < REACH_M
                kept = near & (rays[:, 2] > 0.1)
                if kept.sum() >= 4:
                    ends = np.where(kept[[0, -1], None], rays[[0, -1]], np.nan)
                    streaks.append(Streak(frame, camera, ElementClass.SLOT_LINE, rays[kept], ends))
    return streaks


def off(rig, T_base_cam):
    """Place [m] and turn [deg] that each mount is off, float64[c 6]."""
    found = np.array([mount_change(np.asarray(a), b) for a, b in zip(rig.T_base_cam, T_base_cam, strict=True)])
    found[:, 3:] = np.rad2deg(found[:, 3:])
    return found


@pytest.mark.slow
def test_mounts_come_back_on_a_curve_and_what_is_free_is_named_on_a_straight():
    rig = four_fisheyes()
    start_rig, config = knocked(rig), RoadCalibrationConfig()
    for turn_deg, num_held in ((12.0, 1), (0.0, 3)):
        poses = way(turn_deg)
        motion, streaks = driven(poses), seen(rig, poses, painted_slots())
        fit = fit_to_lines(start_fit(start_rig, motion), start_rig, motion, streaks, config)
        error = off(rig, fit.T_base_cam)
        assert np.abs(error[:, 3:]).max() < 0.08  # deg, of 1
        # Scale: heights and wheels alike, of which the priors alone know.
        scale = fit.odometer[0]
        np.testing.assert_allclose(fit.T_base_cam[:, 2, 3] / scale, 0.9, atol=0.005)
        between = fit.T_base_cam[:, :2, 3] - fit.T_base_cam[0, :2, 3]
        true = np.asarray(rig.T_base_cam)[:, :2, 3] - np.asarray(rig.T_base_cam)[0, :2, 3]
        np.testing.assert_allclose(between / scale, true, atol=0.008)
        known = observability(start_rig, fit, config.calibration)
        assert known.parameter("front pitch").verdict is Knowledge.OBSERVABLE
        # A smaller world with slower wheels looks the same; straight ahead, so does a car whose origin is elsewhere.
        held = [d.text for d in known.directions if d.verdict is Knowledge.HELD]
        assert len(held) == num_held
        assert any("odometer_scale" in text for text in held)
        assert any("only the wheels and the measured heights" in d.reason for d in known.directions)
        assert known.parameter("front x").sigma > 0.03  # m, of 0.05


@pytest.mark.slow
def test_what_is_known_stays():
    rig, poses = four_fisheyes(), way(0.0)
    motion, streaks = driven(poses), seen(rig, poses, painted_slots())
    start_rig = knocked(rig, shift_m=0.0)
    settings = SelfCalibrationConfig(priors=CalibrationPriors(mount_m=0.0, odometer_scale=0.0))
    config = RoadCalibrationConfig(calibration=settings)
    fit = fit_to_lines(start_fit(start_rig, motion), start_rig, motion, streaks, config)
    np.testing.assert_allclose(fit.T_base_cam[:, :3, 3], np.asarray(start_rig.T_base_cam)[:, :3, 3], atol=1e-9)
    assert fit.odometer[0] == 1.0 and fit.converged
    assert np.abs(off(rig, fit.T_base_cam)[:, 3:]).max() < 0.05  # deg, of 1
    names = [p.name for p in observability(start_rig, fit, settings).parameters]
    assert names == [f"{c} {axis}" for c in rig.names for axis in ("roll", "pitch", "yaw")] + ["gyro_bias"]


def test_spots_of_two_pictures_are_one_place_under_the_true_mounts(tmp_path):
    rig, start_rig = four_fisheyes(), knocked(four_fisheyes(), deg=0.4, shift_m=0.02)
    files = {name: tmp_path / f"{name}.png" for name in rig.names}
    for path, picture in zip(files.values(), photographed(rig, road_picture()), strict=True):
        cv2.imwrite(str(path), picture)
    frame = Frame(0, "0", 0.0, "", rig, {"rgb": files})
    masks = MaskSource("sem", load_class_table("drive"), rig.names, lambda *_: np.ones((480, 640), np.uint8))
    spots = SpotFinder([frame], masks, rig).found(np.asarray(start_rig.T_base_cam, np.float64), np.eye(4)[None])
    apart_m = {}
    for name, T in (("true", np.asarray(rig.T_base_cam)), ("start", np.asarray(start_rig.T_base_cam))):
        ray = np.einsum("nkij,nkj->nki", T[spots.camera][..., :3, :3], spots.ray_cam)
        at = T[spots.camera][..., :3, 3]
        places = at[..., :2] - at[..., 2:] / ray[..., 2:] * ray[..., :2]
        apart_m[name] = np.median(np.linalg.norm(places[:, 0] - places[:, 1], axis=1))
    assert len(spots.camera) > 40 and len({tuple(pair) for pair in spots.camera.tolist()}) >= 4
    assert apart_m["true"] < 0.008 and apart_m["start"] > 3 * apart_m["true"]


def test_lines_of_several_images_are_matched_and_neighbours_are_not():
    rig, poses = four_fisheyes(), way(0.0)
    streaks = seen(rig, poses, painted_slots())
    on_road = [laid(s, poses[s.frame] @ np.asarray(rig.T_base_cam)[s.camera]) for s in streaks]
    lines = match_lines(streaks, on_road, 0.5)
    for line in lines:
        xy = np.concatenate([on_road[k].xy for k in line.streaks])
        normal = np.array([-line.along[1, 1], line.along[1, 0]])
        assert np.abs((xy - line.along[0]) @ normal).max() < 1e-6
    near = {tuple(np.round(line.along[0], 0)) for line in lines}
    assert len(lines) >= 20 and len(near) > 15


def test_a_road_without_paint_is_refused_in_one_line():
    rig, motion = four_fisheyes(), driven(way(0.0))
    with pytest.raises(SemlocError, match="0 painted lines that two images show, of 0 seen"):
        fit_to_lines(start_fit(rig, motion), rig, motion, [])


@pytest.mark.data
def test_a_map_and_the_road_exclude_each_other(data_dir, capsys):
    if not (data_dir / "lot_seed4").is_dir():
        pytest.skip(f"no drive lot_seed4 in {data_dir}")
    assert main(["calibrate", str(data_dir / "lot_seed4"), "--against", "road", "--map", "map.osm"]) == 2
    assert "--against road takes no map" in capsys.readouterr().err
    words = ["calibrate", str(data_dir / "lot_seed4"), "--against", "road", "--intrinsics", "focal"]
    assert main(words) == 1
    assert "expected none: the road tells mounts only" in capsys.readouterr().err


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("name", ["lot_seed4", "rendered_garage"])
def test_shared_drives_without_a_map(data_dir, name, capsys):
    if not (data_dir / name).is_dir():
        pytest.skip(f"no drive {name} in {data_dir}")
    drive = open_drive(data_dir / name)
    rig = knocked(drive.rig)
    moved = replace(drive, rig=rig, frames=tuple(replace(frame, rig=rig) for frame in drive.frames))
    found = calibrate_on_road(moved, mask_source("sem_net", moved), RoadCalibrationConfig())
    error = off(drive.rig, np.asarray(found.rig.T_base_cam))
    with capsys.disabled():
        print(f"\n{name}, place [cm] and turn [deg] off the truth:\n{np.round(error * [100, 100, 100, 1, 1, 1], 2)}")
    assert np.abs(error[:, 3:]).mean() < 0.12 and np.abs(error[:, 3:]).max() < 0.4
    assert found.after_m < 0.25 * found.before_m
    assert found.observability.parameter("odometer_scale").verdict is not Knowledge.OBSERVABLE
