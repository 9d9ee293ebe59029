"""Recordings of other layouts, written by the tests as their documents say, come back with times, cameras and logs."""

import json

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.cameras.io import write_calibration
from semloc_jax.datasets import open_drive
from semloc_jax.datasets.in_step import odometry_from_poses
from semloc_jax.datasets.nmea import read_nmea
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import Trajectory
from semloc_jax.geometry.geodesy import enu_from_wgs84
from semloc_jax.simulation.cameras import mounted

START_NS = 1_403_636_579_763_555_584
STEP_NS = 50_000_000
FORWARD = mounted((1.6, 0.0, 1.4), 0.0, 2.0, 0.0)


def image(number, size=(64, 48)):
    return np.full((size[1], size[0], 3), 40 + 20 * number, np.uint8)


def write_images(folder, names, size=(64, 48)):
    folder.mkdir(parents=True)
    for number, name in enumerate(names):
        cv2.imwrite(str(folder / name), image(number, size))


def poses(num=5, step_m=0.5, turn_rad=0.02):
    """A vehicle on an arc: poses every 50 ms."""
    T = np.tile(np.eye(4), (num, 1, 1))
    step = np.eye(4)
    step[:3, :3] = Rotation.from_euler("z", turn_rad).as_matrix()
    step[:2, 3] = step_m * np.sinc(turn_rad / 2 / np.pi) * np.array([np.cos(turn_rad / 2), np.sin(turn_rad / 2)])
    for i in range(1, num):
        T[i] = T[i - 1] @ step
    return T


def assert_pictures(drive, camera, num):
    assert len(drive) == num
    for number, frame in enumerate(drive.frames):
        assert frame.image(camera).mean() == pytest.approx(40 + 20 * number, abs=1.0)


# ---------------------------------------------------------------- EuRoC


def write_euroc(folder, num=4):
    stamps = [START_NS + i * STEP_NS for i in range(num)]
    for name, shift_ns in (("cam0", 0), ("cam1", 2_000_000)):
        write_images(folder / "mav0" / name / "data", [f"{s + shift_ns}.png" for s in stamps])
        lines = [f"{s + shift_ns},{s + shift_ns}.png" for s in stamps]
        (folder / "mav0" / name / "data.csv").write_text("#timestamp [ns],filename\n" + "\n".join(lines) + "\n")
        T = FORWARD.copy()
        T[1, 3] = 0.1 if name == "cam0" else -0.1
        sensor = {
            "T_BS": {"rows": 4, "cols": 4, "data": T.ravel().tolist()},
            "resolution": [64, 48],
            "intrinsics": [50.0, 50.0, 31.5, 23.5],
            "distortion_model": "radial-tangential",
            "distortion_coefficients": [-0.1, 0.01, 0.0, 0.0],
        }
        (folder / "mav0" / name / "sensor.yaml").write_text(yaml.safe_dump(sensor))
    (folder / "mav0" / "imu0").mkdir()
    rows = [f"{s},0.01,0.02,0.03,0.1,0.2,9.8" for s in stamps]
    (folder / "mav0" / "imu0" / "data.csv").write_text("#timestamp [ns],w,w,w,a,a,a\n" + "\n".join(rows))
    (folder / "mav0" / "imu0" / "sensor.yaml").write_text(
        yaml.safe_dump({"T_BS": {"data": np.eye(4).ravel().tolist()}})
    )
    truth = folder / "mav0" / "state_groundtruth_estimate0"
    truth.mkdir()
    quaternion = Rotation.from_euler("z", 0.3).as_quat()[[3, 0, 1, 2]]
    rows = [f"{s},{i}.5,2.0,0.1,{','.join(map(str, quaternion))},0,0,0" for i, s in enumerate(stamps)]
    (truth / "data.csv").write_text("#timestamp, p_RS_R_x [m]\n" + "\n".join(rows))
    return folder


def test_euroc(tmp_path):
    drive = open_drive(write_euroc(tmp_path / "MH_01"))
    assert drive.rig.names == ("cam0", "cam1")
    assert_pictures(drive, "cam1", 4)
    assert drive.frames[1].time_s == pytest.approx((START_NS + STEP_NS) / 1e9, abs=3e-7)
    np.testing.assert_allclose(drive.rig.T_base_cam[1, :3, 3], [1.6, -0.1, 1.4])
    assert float(drive.rig.cameras[0].k1) == -0.1
    np.testing.assert_allclose(drive.imu.accel_mps2[2], [0.1, 0.2, 9.8])
    np.testing.assert_allclose(drive.truth_at(drive.frames[2])[:3, 3], [2.5, 2.0, 0.1])
    assert drive.truth.T_map_base[0, 1, 0] == pytest.approx(np.sin(0.3))


def test_euroc_names_what_is_wrong(tmp_path):
    folder = write_euroc(tmp_path / "a")
    csv = folder / "mav0" / "cam0" / "data.csv"
    csv.write_text(csv.read_text().replace(str(START_NS), "1403636579.76"))
    with pytest.raises(SemlocError, match=r"time '1403636579\.76'; expected whole nanoseconds"):
        open_drive(folder)
    folder = write_euroc(tmp_path / "b")
    (folder / "mav0" / "cam1" / "sensor.yaml").unlink()
    with pytest.raises(SemlocError, match=r"no sensor\.yaml"):
        open_drive(folder)


# ---------------------------------------------------------------- KITTI


def kitti_line(key, values):
    return f"{key}: {' '.join(f'{v:.12e}' for v in np.ravel(values))}\n"


def write_kitti(folder, num=4):
    write_images(folder / "image_2", [f"{i:06d}.png" for i in range(num)])
    write_images(folder / "image_0", [f"{i:06d}.png" for i in range(num)])
    K = np.array([[50.0, 0, 31.5], [0, 50.0, 23.5], [0, 0, 1]])
    P2 = K @ np.column_stack([np.eye(3), [0.06, 0.0, 0.0]])
    (folder / "calib.txt").write_text(kitti_line("P0", K @ np.eye(3, 4)) + kitti_line("P2", P2))
    (folder / "times.txt").write_text("\n".join(f"{0.1 * i:.6e}" for i in range(num)))
    ahead = np.tile(np.eye(4), (num, 1, 1))
    ahead[:, 2, 3] = 0.9 * np.arange(num)  # camera 0 drives along its z axis
    np.savetxt(folder / "poses.txt", ahead[:, :3].reshape(num, 12))
    return folder


def test_kitti_odometry(tmp_path):
    drive = open_drive(write_kitti(tmp_path / "00"))
    assert drive.rig.names == ("image_2", "image_0")
    assert drive.rig.cameras[0].resolution == (64, 48)
    assert_pictures(drive, "image_2", 4)
    assert [frame.time_s for frame in drive.frames] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    # The vehicle drives along its own x.
    np.testing.assert_allclose(drive.truth_at(drive.frames[3])[:3, 3], [2.7, 0.0, 0.0], atol=1e-9)
    (tmp_path / "00" / "times.txt").write_text("0.0\n0.1\n")
    with pytest.raises(SemlocError, match="4 pictures and 2 times"):
        open_drive(tmp_path / "00")


def test_kitti_raw(tmp_path):
    folder = tmp_path / "2011_09_26" / "drive_0001_sync"
    names = [f"{i:010d}" for i in range(3)]
    stamps = [f"2011-09-26 13:02:25.{964389445 + 1000 * i}" for i in range(3)]
    write_images(folder / "image_02" / "data", [f"{name}.png" for name in names])
    (folder / "image_02" / "timestamps.txt").write_text("\n".join(stamps))
    (folder / "oxts" / "data").mkdir(parents=True)
    (folder / "oxts" / "timestamps.txt").write_text("\n".join(stamps))
    for i, name in enumerate(names):
        row = [49.01 + 1e-5 * i, 8.43, 112.8, 0, 0, 0, 0, 0, 9.5 + i, 0, 0, 0.1, 0.2, 9.8, 0, 0, 0, 0.01, 0.02, 0.03]
        (folder / "oxts" / "data" / f"{name}.txt").write_text(" ".join(map(str, [*row, *[0] * 10])))
    K = np.array([[50.0, 0, 31.5], [0, 50.0, 23.5], [0, 0, 1]])
    text = "calib_time: 09-Jan-2012 13:57:47\n" + kitti_line("S_rect_02", [64, 48])
    text += kitti_line("R_rect_00", np.eye(3)) + kitti_line("P_rect_02", K @ np.eye(3, 4))
    (tmp_path / "2011_09_26" / "calib_cam_to_cam.txt").write_text(text)
    drive = open_drive(folder)
    assert drive.rig.names == ("image_02",)
    assert drive.frames[0].time_s == pytest.approx(1317042145.964389, abs=1e-6)
    np.testing.assert_allclose(drive.odometry.speed_mps, [9.5, 10.5, 11.5])
    np.testing.assert_allclose(drive.odometry.yaw_rate_radps, 0.03)
    np.testing.assert_allclose(drive.imu.accel_mps2[0], [0.1, 0.2, 9.8])
    np.testing.assert_allclose(drive.gnss.p_enu[1] - drive.gnss.p_enu[0], [0.0, 1.112, 0.0], atol=1e-3)


# ---------------------------------------------------------------- Argoverse 2


def write_av2(folder, num=5):
    pa, feather = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.feather")
    (folder / "calibration").mkdir(parents=True)

    def write(path, columns):
        feather.write_feather(pa.table(columns), path)

    names = ["ring_front_center", "ring_side_left"]
    write(
        folder / "calibration" / "intrinsics.feather",
        {"sensor_name": names, "fx_px": [50.0] * 2, "fy_px": [50.0] * 2, "cx_px": [31.5] * 2, "cy_px": [23.5] * 2,
         "k1": [0.1] * 2, "k2": [0.0] * 2, "k3": [0.0] * 2, "height_px": [48] * 2, "width_px": [64] * 2},
    )  # fmt: skip
    mounts = [FORWARD, mounted((1.3, 0.3, 1.4), 90.0, 0.0, 0.0)]
    quaternions = np.array([Rotation.from_matrix(T[:3, :3]).as_quat() for T in mounts])
    places = np.array([T[:3, 3] for T in mounts])
    write(
        folder / "calibration" / "egovehicle_SE3_sensor.feather",
        {"sensor_name": names, **{f"q{k}": quaternions[:, i] for i, k in enumerate("xyzw")},
         **{f"t{k}_m": places[:, i] for i, k in enumerate("xyz")}},
    )  # fmt: skip
    T = poses(num)
    T[:, :3, 3] += [5172.0, 2419.0, 66.9]
    quaternions = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    stamps = np.array([315966253572412942 + i * STEP_NS for i in range(num)])
    write(
        folder / "city_SE3_egovehicle.feather",
        {"timestamp_ns": stamps, **{f"q{k}": quaternions[:, i] for i, k in enumerate("xyzw")},
         **{f"t{k}_m": T[:, i, 3] for i, k in enumerate("xyz")}},
    )  # fmt: skip
    for name, late_ns in zip(names, (0, 10_000_000), strict=True):
        write_images(folder / "sensors" / "cameras" / name, [f"{s + late_ns}.jpg" for s in stamps])
    return folder, T


def test_argoverse2(tmp_path):
    folder, T = write_av2(tmp_path / "log")
    drive = open_drive(folder)
    assert drive.rig.names == ("ring_front_center", "ring_side_left")
    assert_pictures(drive, "ring_side_left", 5)
    np.testing.assert_allclose(drive.truth_at(drive.frames[1])[:3, 3], T[1, :3, 3] - [0, 0, 0.33], atol=1e-6)
    # The side camera triggers 10 ms later: 0.1 m of driving lie in between.
    moved = np.asarray(drive.frames[2].rig.T_base_cam[1])[:3, 3] - np.asarray(drive.rig.T_base_cam[1])[:3, 3]
    np.testing.assert_allclose(moved[0], 0.1, atol=5e-3)
    motion = drive.odometry.relative_motion(drive.frames[0].time_s, drive.frames[4].time_s)
    np.testing.assert_allclose(motion[:3, 3], (np.linalg.inv(T[0]) @ T[4])[:3, 3], atol=2e-3)


def test_odometry_of_an_arc_is_exact():
    T = poses(40)
    odometry = odometry_from_poses(Trajectory(0.05 * np.arange(40), T))
    np.testing.assert_allclose(odometry.speed_mps, 10.0, rtol=1e-9)
    np.testing.assert_allclose(odometry.yaw_rate_radps, 0.4, rtol=1e-9)
    np.testing.assert_allclose(odometry.relative_motion(0.0, 1.95), np.linalg.inv(T[0]) @ T[39], atol=1e-9)


# ---------------------------------------------------------------- nuScenes


def write_nuscenes(folder):
    tables = folder / "v1.0-mini"
    tables.mkdir(parents=True)

    def write(name, rows):
        (tables / f"{name}.json").write_text(json.dumps(rows))

    quaternion = Rotation.from_matrix(FORWARD[:3, :3]).as_quat()[[3, 0, 1, 2]].tolist()
    write("scene", [{"token": "s1", "name": "scene-0061"}, {"token": "s2", "name": "scene-0103"}])
    write("sensor", [{"token": "f", "channel": "CAM_FRONT", "modality": "camera"},
                     {"token": "l", "channel": "LIDAR_TOP", "modality": "lidar"}])  # fmt: skip
    mount = {"token": "m", "sensor_token": "f", "translation": FORWARD[:3, 3].tolist(), "rotation": quaternion,
             "camera_intrinsic": [[50.0, 0, 31.5], [0, 50.0, 23.5], [0, 0, 1]]}  # fmt: skip
    write("calibrated_sensor", [mount, {**mount, "token": "n", "sensor_token": "l", "camera_intrinsic": []}])
    write("sample", [{"token": f"{s}{i}", "scene_token": s} for s in ("s1", "s2") for i in range(3)])
    data, ego = [], []
    for s, start in (("s1", 1532402927), ("s2", 1533151603)):
        for i in range(3):
            stamp = (start * 1000 + 500 * i) * 1000
            name = f"samples/CAM_FRONT/{s}_{i}.jpg"
            picture = {"token": f"d{s}{i}", "sample_token": f"{s}{i}", "ego_pose_token": f"e{s}{i}"}
            picture |= {"calibrated_sensor_token": "m", "filename": name, "is_key_frame": True}
            data.append(picture | {"timestamp": stamp, "width": 64, "height": 48})
            pose = {"token": f"e{s}{i}", "timestamp": stamp, "rotation": [1, 0, 0, 0]}
            ego.append(pose | {"translation": [411.0 + 4 * i, 1181.0, 0.0]})
    write("sample_data", data)
    write("ego_pose", ego)
    (folder / "samples" / "CAM_FRONT").mkdir(parents=True)
    for row in data:
        cv2.imwrite(str(folder / row["filename"]), image(int(row["filename"][-5])))
    return folder


def test_nuscenes(tmp_path):
    drive = open_drive(write_nuscenes(tmp_path / "nuscenes"))
    assert drive.name == "scene-0061" and drive.rig.names == ("CAM_FRONT",)
    assert_pictures(drive, "CAM_FRONT", 3)
    assert drive.frames[1].time_s == pytest.approx(1532402927.5, abs=1e-6)
    np.testing.assert_allclose(drive.odometry.speed_mps, 8.0)
    np.testing.assert_allclose(drive.truth_at(drive.frames[2])[:3, 3], [419.0, 1181.0, 0.0])
    from semloc_jax.datasets.nuscenes import read_nuscenes

    assert read_nuscenes(tmp_path / "nuscenes", scene="scene-0103").frames[0].time_s == pytest.approx(1533151603.0)
    with pytest.raises(SemlocError, match="no scene 'x'; expected one of scene-0061, scene-0103"):
        read_nuscenes(tmp_path / "nuscenes", scene="x")


def test_nuscenes_refuses_paths_that_leave_the_data_set(tmp_path):
    folder = write_nuscenes(tmp_path / "nuscenes")
    table = folder / "v1.0-mini" / "sample_data.json"
    table.write_text(table.read_text().replace("samples/CAM_FRONT/s1_1.jpg", "../../etc/passwd"))
    with pytest.raises(SemlocError, match="leaves the data set"):
        open_drive(folder)


# ---------------------------------------------------------------- video, folder, NMEA


def write_rig(folder, name="front"):
    folder.mkdir(parents=True, exist_ok=True)
    write_calibration(
        Rig([PinholeCamera(50.0, 50.0, 31.5, 23.5, 64, 48)], FORWARD[None], [name]), folder / "calib.yaml"
    )


def write_video(path, num=8):
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 20.0, (64, 48))
    for number in range(num):
        writer.write(image(number))
    writer.release()


def test_video_with_times(tmp_path):
    write_rig(tmp_path)
    write_video(tmp_path / "drive.avi")
    (tmp_path / "drive.csv").write_text("t_ms\n" + "\n".join(str(1000 + 50 * i) for i in range(8)))
    (tmp_path / "gps.csv").write_text("t_ms,latitude,longitude,altitude\n1000,48.0,11.0,500\n1200,48.00001,11.0,500\n")
    drive = open_drive(tmp_path / "drive.avi")
    assert [frame.time_s for frame in drive.frames] == pytest.approx(1.0 + 0.05 * np.arange(8))
    np.testing.assert_allclose(drive.gnss.time_s, [1.0, 1.2])
    np.testing.assert_allclose(drive.gnss.p_enu[1], [0.0, 1.112, 0.0], atol=1e-3)
    for number in (6, 1, 2, 7, 0):  # forward, backward, skipping
        assert drive.frames[number].image("front").mean() == pytest.approx(40 + 20 * number, abs=3.0)
    (tmp_path / "drive.csv").write_text("t\n0.0\n0.1\n")
    with pytest.raises(SemlocError, match=r"2 times for 8 pictures .* were pictures dropped\?"):
        open_drive(tmp_path / "drive.avi")
    (tmp_path / "drive.csv").unlink()
    assert open_drive(tmp_path / "drive.avi").frames[4].time_s == pytest.approx(0.2)
    (tmp_path / "broken.mp4").write_bytes(b"\0" * 500)
    with pytest.raises(SemlocError, match=r"broken\.mp4: cannot be decoded"):
        open_drive(tmp_path / "broken.mp4")


@pytest.mark.parametrize("how", ["names", "timestamps.txt", "times.csv"])
def test_folder_with_times_in_nanoseconds(tmp_path, how):
    stamps = [START_NS + i * STEP_NS for i in range(4)]
    names = [str(s) for s in stamps] if how == "names" else [f"{i:04d}" for i in range(4)]
    write_rig(tmp_path)
    write_images(tmp_path / "images", [f"{name}.png" for name in names])
    if how == "timestamps.txt":
        (tmp_path / how).write_text("\n".join(map(str, stamps)))
    elif how == "times.csv":
        rows = [f"{name}.png,{stamp}" for name, stamp in zip(names, stamps, strict=True)]
        (tmp_path / how).write_text("filename,timestamp_ns\n" + "\n".join(rows))
    drive = open_drive(tmp_path)
    np.testing.assert_allclose([f.time_s for f in drive.frames], np.array(stamps) / 1e9, rtol=0, atol=3e-7)
    assert_pictures(drive, "front", 4)


def sentence(body):
    total = 0
    for character in body:
        total ^= ord(character)
    return f"${body}*{total:02X}"


def nmea_lines(num=5, prefix=""):
    """48.07 N, 11.65 E, moving north by 1 m every 0.2 s, from 23:59:59.6 on over midnight."""
    lines = [sentence("GPRMC,235959.40,A,4804.2000,N,01139.0000,E,0.0,0.0,230394,,")]
    for i in range(num):
        second = 86399.6 + 0.2 * i
        hours = f"{int(second // 3600) % 24:02d}{int(second // 60) % 60:02d}{second % 60:05.2f}"
        minutes = 4.2 + i / 1852.2  # a minute of latitude is 1853.2 m here
        quality = 0 if i == 3 else 4
        lines.append(
            (f"{prefix and f'{100.0 + 0.2 * i:.3f} '}")
            + sentence(f"GPGGA,{hours},48{minutes:09.6f},N,01139.000000,E,{quality},12,0.8,500.0,M,46.0,M,,")
        )
    return lines


def test_nmea_over_midnight(tmp_path):
    (tmp_path / "log.nmea").write_text("\n".join([*nmea_lines(), "$GPGGA,garbage", "$GPGSV,3,1,11*7F"]))
    gnss = read_nmea(tmp_path / "log.nmea")
    midnight = 764467200.0  # 1994-03-24
    np.testing.assert_allclose(gnss.time_s - midnight, [-0.4, -0.2, 0.0, 0.4], atol=1e-6)
    np.testing.assert_allclose(gnss.p_enu[:, 1], [0.0, 1.0, 2.0, 4.0], atol=5e-3)
    assert gnss.origin[2] == 546.0  # above the ellipsoid
    np.testing.assert_allclose(gnss.sigma_m[0], [0.016, 0.016, 0.032])
    lat_deg = 48.07 + np.array([0, 1, 2, 4]) / 1852.2 / 60.0
    expected = enu_from_wgs84(lat_deg, 11.65, 546.0, gnss.origin)
    np.testing.assert_allclose(gnss.p_enu, expected, atol=1e-3)


def test_nmea_takes_the_clock_of_the_logger_and_drops_what_is_damaged(tmp_path):
    lines = nmea_lines(prefix="logger")
    (tmp_path / "log.nmea").write_text("\n".join([*lines[:2], lines[2].replace("48", "58", 1), *lines[3:]]))
    gnss = read_nmea(tmp_path / "log.nmea")
    np.testing.assert_allclose(gnss.time_s, [100.0, 100.4, 100.8])
    (tmp_path / "empty.nmea").write_text("$GPGGA,000000,,,,,0,,,,,,,*66\n")
    with pytest.raises(SemlocError, match="no fix in it"):
        read_nmea(tmp_path / "empty.nmea")


def test_unknown_paths_are_one_line(tmp_path):
    with pytest.raises(SemlocError, match="no such folder or file; expected one of drive, bag, PandaSet, EuRoC"):
        open_drive(tmp_path / "none")
    (tmp_path / "drive.rar").write_bytes(b"x")
    with pytest.raises(SemlocError, match=r"unknown type '\.rar'"):
        open_drive(tmp_path / "drive.rar")
