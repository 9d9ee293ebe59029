"""Broken recordings: opened, or refused in one line, in bounded time; never another exception."""

from dataclasses import replace
from pathlib import Path

import pytest

from semloc_jax.datasets import open_drive, overlap_report, write_bag
from semloc_jax.datasets.nmea import read_nmea
from semloc_jax.maps import read_map
from tests.datasets.layouts import nmea_lines, write_euroc, write_kitti, write_nuscenes, write_rig, write_video
from tests.maps.io.mutations import COUNTS, break_often


def use(path: Path):
    """What every verb does with a recording before its work starts."""
    drive = open_drive(path)
    overlap_report(drive)
    for frame in (drive.frames[0], drive.frames[-1]):
        for kind in frame.files:
            for camera in drive.rig.names:
                frame.image(camera) if kind == "rgb" else frame.mask(kind, camera)
    if drive.gnss is not None:
        drive.in_map_of((48.0, 11.0, 500.0)).gnss_prior(drive.frames[0].time_s)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A recording of each kind with the files that are broken in it."""
    root = tmp_path_factory.mktemp("recordings")
    euroc = write_euroc(root / "euroc") / "mav0"
    kitti = write_kitti(root / "kitti")
    tables = write_nuscenes(root / "nuscenes") / "v1.0-mini"
    write_rig(root / "video")
    write_video(root / "video" / "drive.avi")
    (root / "video" / "drive.csv").write_text("t_ms\n" + "\n".join(str(1000 + 50 * i) for i in range(8)))
    (root / "video" / "gps.csv").write_text("t_ms,lat,lon,alt\n1000,48.0,11.0,500\n1200,48.00001,11.0,500\n")
    (root / "video" / "wheel_odom.csv").write_text("t,v_m_s,yaw_rate_rad_s\n0.9,5,0.1\n1.2,5,0.1\n1.5,5,0.1\n")
    (root / "video" / "poses.tum").write_text("1.0 0 0 0 0 0 0 1\n1.2 1 0 0 0 0 0 1\n1.5 2 0 0 0 0 0 1\n")
    video = root / "video" / "drive.avi"
    return {
        "euroc": (root / "euroc", [euroc / "cam0" / "data.csv", euroc / "cam1" / "sensor.yaml",
                                   euroc / "imu0" / "data.csv", euroc / "state_groundtruth_estimate0" / "data.csv"]),
        "kitti": (kitti, [kitti / "times.txt", kitti / "poses.txt", kitti / "calib.txt"]),
        "nuscenes": (root / "nuscenes", [tables / f"{name}.json" for name in ("sample_data", "ego_pose", "scene")]),
        "video": (video, [video, *(root / "video" / name for name in
                                   ("drive.csv", "gps.csv", "wheel_odom.csv", "poses.tum"))]),
    }  # fmt: skip


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("kind", ["euroc", "kitti", "nuscenes", "video"])
def test_broken_files_of_recordings(folders, kind, count):
    path, files = folders[kind]
    use(path)
    for file in files:
        original = file.read_bytes()
        break_often(original, max(count // len(files), 3), lambda content, file=file: used(path, file, content))
        file.write_bytes(original)


@pytest.mark.parametrize("count", COUNTS)
def test_broken_nmea(tmp_path, count):
    path = tmp_path / "log.nmea"

    def read(content):
        path.write_bytes(content)
        read_nmea(path)

    break_often("\n".join(nmea_lines(20)).encode(), count, read)


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("kind", ["ros1", "mcap", "sqlite3"])
def test_broken_bags(simulated_road, tmp_path, kind, count):
    pytest.importorskip("rosbags")
    drive = open_drive(simulated_road)
    small = replace(drive, imu=None, frames=drive.frames[:2])
    name = "drive.bag" if kind == "ros1" else "drive"
    path = write_bag(small, tmp_path / name, kind, read_map(drive.map_path).origin, compressed=True, clock_offset_s=1e9)
    file = path if kind == "ros1" else next(f for f in path.iterdir() if f.suffix in (".mcap", ".db3"))
    use(file)
    break_often(file.read_bytes(), count, lambda content: used(file, file, content))


def used(path, file, content):
    """Uses a recording of which one file is broken."""
    file.write_bytes(content)
    use(path)
