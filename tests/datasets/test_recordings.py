"""Recordings of other layouts, written by the tests as their documents say, come back with times, cameras and logs."""

import numpy as np
import pytest

from semloc_jax.datasets import open_drive
from semloc_jax.datasets.beside import maps_beside
from semloc_jax.datasets.in_step import odometry_from_poses
from semloc_jax.datasets.nmea import read_nmea
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import Trajectory
from semloc_jax.geometry.geodesy import enu_from_wgs84
from semloc_jax.maps.io.formats import MAP_SUFFIXES
from tests.datasets.layouts import (
    START_NS,
    STEP_NS,
    nmea_lines,
    poses,
    write_av2,
    write_euroc,
    write_images,
    write_kitti,
    write_kitti_raw,
    write_nuscenes,
    write_rig,
    write_video,
)


def assert_pictures(drive, camera, num):
    assert len(drive) == num
    for number, frame in enumerate(drive.frames):
        assert frame.image(camera).mean() == pytest.approx(40 + 20 * number, abs=1.0)


def test_a_map_of_any_format_is_found_beside_a_recording(tmp_path):
    """Whatever has a row in the table of formats; the nearest of one format, the first row first."""
    (tmp_path / "drive").mkdir()
    for suffix in MAP_SUFFIXES:
        (tmp_path / f"map{suffix}").touch()
    (tmp_path / "drive" / "map.osm").touch()
    found = maps_beside(tmp_path / "drive")
    assert {f".{name}" for name in found} == set(MAP_SUFFIXES) and found["osm"].parent.name == "drive"
    assert list(maps_beside(tmp_path / "video.mp4"))[:4] == ["geojson", "gpkg", "osm", "xodr"]


# ---------------------------------------------------------------- EuRoC


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


@pytest.mark.parametrize("place", ["nan", "inf", "1e300"])
def test_euroc_truth_is_on_the_earth(tmp_path, place):
    path = write_euroc(tmp_path / "euroc")
    table = path / "mav0" / "state_groundtruth_estimate0" / "data.csv"
    lines = table.read_text().splitlines()
    cells = lines[2].split(",")
    lines[2] = ",".join([cells[0], place, *cells[2:]])
    table.write_text("\n".join(lines) + "\n")
    with pytest.raises(SemlocError, match="no number or beyond the earth"):
        open_drive(path)


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
    folder = write_kitti_raw(tmp_path)
    drive = open_drive(folder)
    assert drive.rig.names == ("image_02",)
    assert drive.frames[0].time_s == pytest.approx(1317042145.964389, abs=1e-6)
    np.testing.assert_allclose(drive.odometry.speed_mps, [9.5, 10.5, 11.5])
    np.testing.assert_allclose(drive.odometry.yaw_rate_radps, 0.03)
    np.testing.assert_allclose(drive.imu.accel_mps2[0], [0.1, 0.2, 9.8])
    np.testing.assert_allclose(drive.gnss.p_enu[1] - drive.gnss.p_enu[0], [0.0, 1.112, 0.0], atol=1e-3)


# ---------------------------------------------------------------- Argoverse 2


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


def test_frames_listed_out_of_order_are_taken_by_time(tmp_path, caplog):
    write_rig(tmp_path)
    write_images(tmp_path / "images", [f"{k:03d}.png" for k in range(4)])
    (tmp_path / "times.csv").write_text("frame,t\n000.png,1.0\n001.png,1.3\n002.png,1.2\n003.png,1.4\n")
    drive = open_drive(tmp_path)
    assert [frame.id for frame in drive.frames] == ["000", "002", "001", "003"]
    assert "frame '001' is listed before an earlier one" in caplog.text


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
