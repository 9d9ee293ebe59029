"""One synthetic recording, points before a camera, as an EuRoC folder with Kalibr's files and as a ROS bag."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from semloc_jax.calibration.inertial_plausibility import compared, implausible_inertial
from semloc_jax.calibration.turns_of_cameras import turns_of_cameras
from semloc_jax.cli.main import OK, main
from semloc_jax.datasets import Imu, open_drive, write_bag
from semloc_jax.datasets.inertial import imu_yaml
from semloc_jax.evaluation import read_trajectory
from semloc_jax.geometry import rigid
from tests.fusion.inertial_world import AHEAD, FRAME_S, World

WIDTH, HEIGHT, FOCAL = 640, 480, 400.0
START_NS, LATE_S, NUM = 1_403_636_579_000_000_000, 0.015, 46


def picture(T_map_cam, points, grey):
    """Points as discs of their own grey, the nearest last."""
    image = np.full((HEIGHT, WIDTH), 40, np.uint8)
    p_cam = (points - T_map_cam[:3, 3]) @ T_map_cam[:3, :3]
    for k in np.argsort(-p_cam[:, 2]):
        x, y, z = p_cam[k]
        if 2.0 < z < 60.0:
            u, v = FOCAL * x / z + (WIDTH - 1) / 2, FOCAL * y / z + (HEIGHT - 1) / 2
            if abs(u) < 2 * WIDTH and abs(v) < 2 * HEIGHT:
                centre = round(16 * u), round(16 * v)
                cv2.circle(image, centre, max(round(16 * FOCAL * 0.12 / z), 12), int(grey[k]), -1, cv2.LINE_AA, 4)
    return cv2.GaussianBlur(image, (0, 0), 0.7)


def write_recording(folder):
    """mav0 with cam0, imu0 and truth; beside it camchain-imucam.yaml and imu.yaml. Body and sensor are the base."""
    world, rng = World(seed=3, delay_s=LATE_S), np.random.default_rng(3)
    time_s = FRAME_S * np.arange(NUM)
    imu, _ = world.imu(time_s[-1], rng)
    length_m = world.speed_mps * time_s[-1] + 70.0
    num = int(10 * length_m)
    x, side = rng.uniform(0, length_m, num), rng.choice([-1.0, 1.0], num)
    points = np.column_stack([x, side * rng.uniform(3.0, 12.0, num), rng.uniform(0.0, 7.0, num)])
    grey = rng.integers(90, 255, num)
    root = folder / "mav0"
    for part in ("cam0/data", "imu0", "state_groundtruth_estimate0"):
        (root / part).mkdir(parents=True)
    stamps = [START_NS + round(1e9 * t) for t in time_s]
    for stamp, T in zip(stamps, world.pose(time_s), strict=True):
        cv2.imwrite(str(root / "cam0" / "data" / f"{stamp}.png"), picture(T @ AHEAD, points, grey))
    (root / "cam0" / "data.csv").write_text("#timestamp [ns],filename\n" + "".join(f"{s},{s}.png\n" for s in stamps))
    rows = [
        f"{START_NS + round(1e9 * t)},{','.join(f'{v:.9f}' for v in (*w, *a))}"
        for t, w, a in zip(imu.time_s, imu.gyro_radps, imu.accel_mps2, strict=True)
    ]
    (root / "imu0" / "data.csv").write_text("#timestamp [ns],w,w,w,a,a,a\n" + "\n".join(rows) + "\n")
    rows = []
    for stamp, T in zip(stamps, world.pose(time_s), strict=True):
        w = np.sqrt(1.0 + np.trace(T[:3, :3])) / 2.0
        q = np.array([T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1]]) / (4.0 * w)
        rows.append(f"{stamp},{','.join(f'{v:.9f}' for v in (*T[:3, 3], w, *q))}")
    (root / "state_groundtruth_estimate0" / "data.csv").write_text("#timestamp, p\n" + "\n".join(rows) + "\n")
    camera = {
        "camera_model": "pinhole",
        "distortion_model": "radtan",
        "distortion_coeffs": [0.0, 0.0, 0.0, 0.0],
        "intrinsics": [FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2],
        "resolution": [WIDTH, HEIGHT],
        "T_cam_imu": rigid.inverse(AHEAD).tolist(),
        "timeshift_cam_imu": LATE_S,
    }
    (folder / "camchain-imucam.yaml").write_text(yaml.safe_dump({"cam0": camera}))
    (folder / "imu.yaml").write_text(imu_yaml(world.sensor) + "update_rate: 100.0\n")
    return folder


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("euroc"))


def test_check_calib_names_clock_unit_axes_and_noise(recording, tmp_path, capsys):
    chain, noise = recording / "camchain-imucam.yaml", recording / "imu.yaml"

    def said(calib, imu=noise, path=recording):
        words = ["check-calib", str(path), "--calib", str(calib), "--imu", str(imu), "--out", str(tmp_path / "out")]
        assert main(words) == OK
        return capsys.readouterr().out

    right = said(chain)
    assert "imu:" not in right, "the shift of the clocks is in the calibration"
    content = yaml.safe_load(chain.read_text())
    del content["cam0"]["timeshift_cam_imu"]
    unshifted, per_sample = tmp_path / "camchain.yaml", tmp_path / "imu.yaml"
    unshifted.write_text(yaml.safe_dump(content))
    stated = yaml.safe_load(noise.read_text())
    per_sample.write_text(yaml.safe_dump(stated | {"gyroscope_noise_density": 10 * stated["gyroscope_noise_density"]}))
    late = said(unshifted, per_sample)
    ms, sigma_ms = (
        float(late.split(word)[1].split(end)[0]) for word, end in (("the clock is ", " ms"), ("sigma ", ")"))
    )
    assert ms == pytest.approx(1e3 * LATE_S, abs=3.0 * sigma_ms) and sigma_ms < 1.5
    assert "gyroscope_noise_density" in late and "accelerometer_noise_density" not in late


def test_units_and_axes_are_told_by_turns_and_forces(recording):
    drive = open_drive(recording, recording / "camchain-imucam.yaml")
    turns, imu = turns_of_cameras(drive.frames, drive.rig.names[0]), drive.imu

    def told(gyro, accel=imu.accel_mps2):
        return " ".join(finding.text for finding in implausible_inertial(Imu(imu.time_s, gyro, accel), turns))

    assert told(imu.gyro_radps) == ""
    standing = 1e-3 * np.random.default_rng(0).normal(size=imu.gyro_radps.shape)
    assert told(standing) == "", "rates of noise are not compared"
    assert "the unit is deg/s" in told(np.rad2deg(imu.gyro_radps))
    assert "the unit is g" in told(imu.gyro_radps, imu.accel_mps2 / 9.81)
    turned = told(imu.gyro_radps[:, [1, 0, 2]] * [1, -1, 1])
    assert "its y shows minus x" in turned and "its x shows y" in turned
    assert "points down" in told(imu.gyro_radps, -imu.accel_mps2)
    R = rigid.exp(np.concatenate([np.zeros(3), np.deg2rad([0.0, 0.0, 8.0])]))[:3, :3]
    found = compared(Imu(imu.time_s, imu.gyro_radps @ R, imu.accel_mps2), turns)
    assert found.turn_deg[2] == pytest.approx(8.0, abs=4 * found.turn_sigma_deg[2]) and not found.swapped


@pytest.mark.slow
def test_folder_and_bag_drift_little_and_alike(recording, tmp_path):
    pytest.importorskip("rosbags")
    chain, noise = str(recording / "camchain-imucam.yaml"), str(recording / "imu.yaml")
    # A drive that is open is in the clock of its cameras, and so is a bag that is written of it.
    bag = write_bag(open_drive(recording, chain), tmp_path / "bag", "mcap")
    content = yaml.safe_load(Path(chain).read_text())
    del content["cam0"]["timeshift_cam_imu"]
    (tmp_path / "camchain.yaml").write_text(yaml.safe_dump(content))
    ways = {}
    for name, path, calib in (("folder", recording, chain), ("bag", bag, str(tmp_path / "camchain.yaml"))):
        out = tmp_path / name
        words = ["odometry", str(path), "--calib", calib, "--imu", noise, "--masks", "none", "--out", str(out)]
        assert main(words) == OK
        ways[name] = read_trajectory(out / "trajectory.tum")
        rows = {row["key"]: row["value"] for row in json.loads((out / "metrics.json").read_text())["metrics"]}
        assert rows["drift.translation"] < 3.0 and rows["drift.rotation"] < 0.02
    apart = ways["folder"].T_map_base - ways["bag"].T_map_base
    assert len(ways["folder"]) == len(ways["bag"]) and np.abs(apart).max() < 1e-3
