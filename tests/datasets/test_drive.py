"""Reading drives: what is there is found, what is absent is None, what is wrong is named."""

import shutil

import numpy as np
import pytest

from semloc_jax.datasets import WheelOdometry, open_drive, read_drive
from semloc_jax.errors import SemlocError


def test_rendered_road_is_read_whole(road_dir):
    drive = open_drive(road_dir)
    assert len(drive) == 150
    assert drive.variants == ("noon", "lowsun", "nightwet")
    assert drive.mask_sources == ("sem", "sem_net")
    assert drive.table_name == "drive" and drive.class_ids["lane_dashed"] == 11
    assert drive.map_path is not None and drive.map_path.name == "map.geojson"
    frame = drive.frames[3]
    assert frame.image("front").shape == (600, 960, 3)
    assert frame.mask("sem", "front").shape == (600, 960)
    np.testing.assert_allclose(drive.truth_at(frame)[:3, 3], drive.truth.T_map_base[3, :3, 3])
    assert frame.dynamic_mask("front") is None


def test_wheel_odometry_follows_the_truth_over_one_second(road_dir):
    drive = read_drive(road_dir)
    misses = []
    for first in range(0, 140, 10):
        a, b = drive.frames[first], drive.frames[first + 10]
        true_motion = np.linalg.inv(drive.truth_at(a)) @ drive.truth_at(b)
        motion = drive.odometry.relative_motion(a.time_s, b.time_s)
        misses.append(np.linalg.norm((motion - true_motion)[:2, 3]) / np.linalg.norm(true_motion[:2, 3]))
    assert np.median(misses) < 0.015


def test_garage_has_four_cameras(garage_dir):
    drive = open_drive(garage_dir)
    assert drive.rig.names == ("front", "left", "rear", "right")
    assert [mask.shape for mask in drive.frames[0].masks("sem_net")] == [(480, 640)] * 4


def test_dead_reckoning_of_a_circle_closes():
    time = np.linspace(0.0, 2 * np.pi, 400)
    odometry = WheelOdometry(time, np.full(400, 5.0), np.ones(400))
    start, half, end = odometry.dead_reckon(np.array([0.0, np.pi, 2 * np.pi]))
    np.testing.assert_allclose(end - start, [0.0, 0.0, 2 * np.pi], atol=1e-9)
    np.testing.assert_allclose(half, [0.0, 10.0, np.pi], atol=1e-3)
    T = odometry.relative_motion(0.0, np.pi / 2)
    np.testing.assert_allclose(T[:2, 3], [5.0, 5.0], atol=1e-3)
    np.testing.assert_allclose(
        T @ odometry.relative_motion(np.pi / 2, np.pi), odometry.relative_motion(0.0, np.pi), atol=1e-3
    )


def make_bare_drive(road_dir, folder, num_frames=2):
    (folder / "sem" / "front").mkdir(parents=True)
    shutil.copy(road_dir / "calib.yaml", folder)
    lines = (road_dir / "frames.csv").read_text().splitlines()[: num_frames + 1]
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")
    for line in lines[1:]:
        name = line.split(",")[0] + ".png"
        shutil.copy(road_dir / "sem" / "front" / name, folder / "sem" / "front" / name)


def test_a_drive_of_masks_only_opens(road_dir, tmp_path):
    make_bare_drive(road_dir, tmp_path)
    drive = open_drive(tmp_path)
    assert drive.mask_sources == ("sem",)
    assert drive.truth is None and drive.gnss is None and drive.map_path is None
    with pytest.raises(SemlocError, match="no satellite fixes"):
        drive.gnss_prior(0.5)
    with pytest.raises(SemlocError, match="no 'rgb'; expected one of sem"):
        drive.frames[0].image("front")
    with pytest.raises(SemlocError, match="no camera 'rear'"):
        drive.frames[0].mask("sem", "rear")


def test_wrong_files_are_named(road_dir, tmp_path):
    make_bare_drive(road_dir, tmp_path)
    (tmp_path / "gps.csv").write_text("t,east\n1,2\n")
    with pytest.raises(SemlocError, match="gps.csv: no position in its columns; expected t, lat_deg.* or t, east_m"):
        open_drive(tmp_path)
    (tmp_path / "gps.csv").unlink()
    (tmp_path / "sem" / "front" / "000000.png").write_bytes(b"x")
    with pytest.raises(SemlocError, match="cannot be decoded"):
        open_drive(tmp_path).frames[0].mask("sem", "front")
    with pytest.raises(SemlocError, match="no such folder"):
        open_drive(tmp_path / "none")


def test_plain_folder_with_one_camera(road_dir, tmp_path):
    make_bare_drive(road_dir, tmp_path, num_frames=3)
    (tmp_path / "frames.csv").unlink()
    shutil.move(tmp_path / "sem" / "front", tmp_path / "masks")
    shutil.rmtree(tmp_path / "sem")
    (tmp_path / "times.csv").write_text("frame,t\n000000,5.0\n000001,5.1\n000002,5.2\n")
    drive = open_drive(tmp_path)
    assert [frame.time_s for frame in drive.frames] == [5.0, 5.1, 5.2]
    assert drive.frames[1].mask("masks", "front").shape == (600, 960)
    shutil.copytree(tmp_path / "masks", tmp_path / "images")
    (tmp_path / "images" / "000001.png").unlink()
    assert [frame.id for frame in open_drive(tmp_path).frames] == ["000000", "000002"]
