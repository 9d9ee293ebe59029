"""Every kind of recording, each small, with the files of it that are damaged, and what must hold of what is opened."""

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from semloc_jax.datasets import Drive, open_drive, overlap_report, write_bag
from semloc_jax.maps import GeoOrigin
from semloc_jax.storage import npz_arrays
from tests.datasets.layouts import (
    nmea_lines,
    write_av2,
    write_euroc,
    write_images,
    write_kitti,
    write_kitti_raw,
    write_nuscenes,
    write_rig,
    write_video,
)
from tests.fuzz.readers import Reader

GPS = "t_ms,lat,lon,alt\n1000,48.0,11.0,500\n1200,48.00001,11.0,500\n"
ODOMETRY = "t,v_m_s,yaw_rate_rad_s\n0.9,5,0.1\n1.2,5,0.1\n1.5,5,0.1\n"
POSES = "1.0 0 0 0 0 0 0 1\n1.2 1 0 0 0 0 0 1\n1.5 2 0 0 0 0 0 1\n"
IMU = "t,gx,gy,gz,ax,ay,az\n" + "".join(f"{1.0 + 0.01 * k:.2f},0,0,0.1,0,0,9.81\n" for k in range(40))
ORIGIN = GeoOrigin(48.1, 11.6, 520.0)
EVERY_N_POINTS, NUM_SWEEPS = 40, 12


def recordings(simulated: Path, data: Path | None, place: Path) -> Iterator[Reader]:
    """Readers of recordings.

    Args:
        simulated: a small simulated drive.
        data: folder of the shared data; PandaSet is read only where it is there.
        place: where inputs are written.
    """
    for name in ("frames.csv", "gps.csv", "imu.csv", "wheel_odom.csv", "meta.json", "poses_body.tum", "calib.yaml"):
        yield Reader(f"drive {name}", simulated / name, use_drive, simulated)
    yield from _made(place)
    yield from _bags(simulated, place)
    if data is not None and (data / "pandaset_002").is_dir():
        yield from _pandaset(data / "pandaset_002", place)


def _made(place: Path) -> Iterator[Reader]:
    euroc = write_euroc(place / "euroc")
    for name in ("cam0/data.csv", "cam1/sensor.yaml", "imu0/data.csv", "imu0/sensor.yaml",
                 "state_groundtruth_estimate0/data.csv"):  # fmt: skip
        yield Reader(f"EuRoC {name}", euroc / "mav0" / name, use_drive, euroc)
    kitti = write_kitti(place / "kitti")
    for name in ("times.txt", "poses.txt", "calib.txt", "image_2/000000.png"):
        yield Reader(f"KITTI {name}", kitti / name, use_drive, kitti)
    raw = write_kitti_raw(place / "raw")
    for name in ("image_02/timestamps.txt", "oxts/timestamps.txt", "oxts/data/0000000001.txt"):
        yield Reader(f"KITTI raw {name}", raw / name, use_drive, raw.parent, raw)
    yield Reader("KITTI raw calibration", raw.parent / "calib_cam_to_cam.txt", use_drive, raw.parent, raw)
    nuscenes = write_nuscenes(place / "nuscenes")
    for name in ("scene", "sensor", "calibrated_sensor", "sample", "sample_data", "ego_pose"):
        yield Reader(f"nuScenes {name}", nuscenes / "v1.0-mini" / f"{name}.json", use_drive, nuscenes)
    av2, _ = write_av2(place / "av2")
    for name in ("calibration/intrinsics", "calibration/egovehicle_SE3_sensor", "city_SE3_egovehicle"):
        yield Reader(f"Argoverse 2 {name}", av2 / f"{name}.feather", use_drive, av2)
    yield from _video_and_folder(place)


def _video_and_folder(place: Path) -> Iterator[Reader]:
    video, folder = place / "video", place / "folder"
    write_rig(video)
    write_video(video / "drive.avi")
    write_rig(folder)
    write_images(folder / "images", [f"{k:03d}.png" for k in range(4)])
    (video / "drive.csv").write_text("t_ms\n" + "\n".join(str(1000 + 50 * i) for i in range(8)))
    rows = "".join(f"{k:03d}.png,{1.0 + 0.1 * k}\n" for k in range(4))
    (folder / "times.csv").write_text(f"frame,t\n{rows}")
    (folder / "gps.nmea").write_text("\n".join(nmea_lines()))
    for where in (video, folder):
        (where / "wheel_odom.csv").write_text(ODOMETRY)
        (where / "poses.tum").write_text(POSES)
        (where / "imu.csv").write_text(IMU)
    (video / "gps.csv").write_text(GPS)
    for name in ("drive.avi", "drive.csv", "gps.csv", "wheel_odom.csv", "poses.tum"):
        yield Reader(f"video {name}", video / name, use_drive, video, video / "drive.avi")
    for name in ("times.csv", "calib.yaml", "imu.csv", "gps.nmea", "images/000.png"):
        yield Reader(f"folder {name}", folder / name, use_drive, folder)


def _bags(simulated: Path, place: Path) -> Iterator[Reader]:
    drive = open_drive(simulated)
    # Raw pictures make up nearly all of a bag: two of them leave damage for the rest.
    small = replace(drive, frames=drive.frames[:2], rig=drive.rig)
    bags = place / "bags"
    bags.mkdir()
    for kind, name in (("ros1", "drive.bag"), ("mcap", "mcap"), ("sqlite3", "db3")):
        path = write_bag(small, bags / name, kind, ORIGIN, compressed=True, clock_offset_s=1e9)
        if path.is_file():
            yield Reader("bag of ROS 1", path, use_drive)
            continue
        for file in sorted(path.iterdir()):
            yield Reader(f"bag {kind} {file.suffix}", file, use_drive, path)


def _pandaset(whole: Path, place: Path) -> Iterator[Reader]:
    """The first sweeps of a sequence, with few points: all of them are looked at in each opening."""
    made = place / "pandaset"
    shutil.copytree(whole, made, copy_function=lambda source, target: Path(target).symlink_to(Path(source).resolve()))
    points = made / "semantic_points_per_sweep.npz"
    arrays = npz_arrays(points, "points")
    points.unlink()
    np.savez_compressed(points, data=arrays["data"][::EVERY_N_POINTS])
    for path in [*made.glob("camera/*/poses.json"), *made.glob("*/timestamps.json"), *made.glob("meta/*.json"),
                 *made.glob("camera/*/timestamps.json")]:  # fmt: skip
        rows = json.loads(path.read_text())
        if path.is_symlink() and isinstance(rows, list):
            path.unlink()
            path.write_text(json.dumps(rows[:NUM_SWEEPS]))
    for name in ("camera/front_camera/poses.json", "camera/front_camera/intrinsics.json", "meta/gps.json",
                 "camera/front_camera/timestamps.json", points.name):  # fmt: skip
        yield Reader(f"PandaSet {Path(name).name}", made / name, use_drive, made)


def use_drive(path: Path) -> Drive:
    """Opens a drive, looks at pictures, and whether names are plain, times increase and numbers are numbers."""
    found = open_drive(path)
    overlap_report(found)
    for frame in (found.frames[0], found.frames[-1]):
        for kind in frame.files:
            for camera in found.rig.names:
                if frame.has(kind, camera):
                    frame.image(camera) if kind == "rgb" else frame.mask(kind, camera)
    ids, times = [frame.id for frame in found.frames], [frame.time_s for frame in found.frames]
    assert len(set(ids)) == len(ids) and not any("/" in name or name in ("", ".", "..") for name in ids), "names"
    assert np.all(np.diff(times) > 0.0), "times that do not increase"
    R = np.asarray(found.rig.T_base_cam)[:, :3, :3]
    assert np.allclose(R @ R.transpose(0, 2, 1), np.eye(3), atol=1e-3), "a mount that is no rotation"
    for log in (found.truth, found.gnss, found.odometry, found.imu):
        numbers = [] if log is None else [v for v in vars(log).values() if isinstance(v, np.ndarray)]
        assert all(np.isfinite(v).all() for v in numbers), f"{type(log).__name__} with what is no number"
    return found


def needs() -> None:
    """Skip where an extra is missing that a recording is written with."""
    pytest.importorskip("rosbags")
    pytest.importorskip("pyarrow")
    pytest.importorskip("pyogrio")
