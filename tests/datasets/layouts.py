"""Small recordings of foreign layouts, written as their documents say; for tests that read or damage them."""

import json

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.cameras.io import write_calibration
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


def write_kitti_raw(folder, num=3):
    """A day's folder with one drive, which is returned."""
    drive = folder / "2011_09_26" / "drive_0001_sync"
    names = [f"{i:010d}" for i in range(num)]
    stamps = [f"2011-09-26 13:02:25.{964389445 + 1000 * i}" for i in range(num)]
    write_images(drive / "image_02" / "data", [f"{name}.png" for name in names])
    (drive / "image_02" / "timestamps.txt").write_text("\n".join(stamps))
    (drive / "oxts" / "data").mkdir(parents=True)
    (drive / "oxts" / "timestamps.txt").write_text("\n".join(stamps))
    for i, name in enumerate(names):
        row = [49.01 + 1e-5 * i, 8.43, 112.8, 0, 0, 0, 0, 0, 9.5 + i, 0, 0, 0.1, 0.2, 9.8, 0, 0, 0, 0.01, 0.02, 0.03]
        (drive / "oxts" / "data" / f"{name}.txt").write_text(" ".join(map(str, [*row, *[0] * 10])))
    K = np.array([[50.0, 0, 31.5], [0, 50.0, 23.5], [0, 0, 1]])
    text = "calib_time: 09-Jan-2012 13:57:47\n" + kitti_line("S_rect_02", [64, 48])
    text += kitti_line("R_rect_00", np.eye(3)) + kitti_line("P_rect_02", K @ np.eye(3, 4))
    (drive.parent / "calib_cam_to_cam.txt").write_text(text)
    return drive


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
