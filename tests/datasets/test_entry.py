"""What a recording says wrongly is told where it enters: units, axes, names, times."""

import logging
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.datasets import open_drive
from semloc_jax.datasets.entry import check_units
from semloc_jax.datasets.sensors import GnssTrack, Imu
from semloc_jax.errors import SemlocError

SPEED_MPS, END_S = 9.0, 60.0


def _csv(path, header, *columns):
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.9f")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, simulated_road):
    """A drive of a minute on a winding road: tables only, with fixes that jitter by a metre."""
    folder = tmp_path_factory.mktemp("entry") / "winding"
    folder.mkdir()
    shutil.copy(simulated_road / "calib.yaml", folder)
    time_s = np.arange(0.0, END_S, 0.02)
    rate = 0.25 * np.sin(0.25 * time_s)
    yaw = 3.0 + np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * 0.02)])
    xy = np.cumsum(np.column_stack([np.cos(yaw), np.sin(yaw)]) * SPEED_MPS * 0.02, axis=0)
    zeros, ones = np.zeros_like(time_s), np.ones_like(time_s)
    _csv(folder / "wheel_odom.csv", "t,v_m_s,yaw_rate_rad_s", time_s, SPEED_MPS * ones, rate)
    _csv(folder / "imu.csv", "t,gx_rad_s,gy,gz,ax_m_s2,ay,az", time_s, zeros, zeros, rate, zeros, zeros, 9.81 * ones)
    rows = np.arange(0, len(time_s), 10)
    jitter = np.random.default_rng(3).normal(size=(len(rows), 2))
    gps = "t,east_m,north_m,up_m,sigma_e,sigma_n,sigma_u"
    still, sigma = zeros[rows], np.tile([1.3, 1.3, 2.5], (len(rows), 1))
    _csv(folder / "gps.csv", gps, time_s[rows], *(xy[rows] + jitter).T, still, *sigma.T)
    poses = [time_s[rows], *xy[rows].T, still, still, still, np.sin(yaw / 2)[rows], np.cos(yaw / 2)[rows]]
    np.savetxt(folder / "poses_body.tum", np.column_stack(poses), fmt="%.9f")
    frames = "\n".join(f"{k:06d},{5.0 + 0.1 * k:.3f},noon" for k in range(20))
    (folder / "frames.csv").write_text(f"frame,t,variant\n{frames}\n")
    return folder


@pytest.fixture
def drive(recorded, tmp_path):
    return shutil.copytree(recorded, tmp_path / "drive")


def _scaled(path, column, factor, rows=slice(None)):
    header = path.read_text().splitlines()[0]
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    table[rows, column] *= factor
    _csv(path, header, *table.T)


def _cell(path, row, column, text):
    lines = path.read_text().splitlines()
    cells = lines[row + 1].split(",")
    cells[column] = text
    lines[row + 1] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n")


def test_a_drive_without_faults_enters_without_a_word(drive, caplog):
    found = open_drive(drive)
    assert len(found) == 20 and found.odometry is not None and found.imu is not None
    assert not caplog.records


@pytest.mark.parametrize(
    ("file", "column", "factor", "words"),
    [
        ("wheel_odom.csv", 1, 3.6, "times as fast as the positions move.* is it in km/h"),
        ("wheel_odom.csv", 1, 2.237, "is it in mph"),
        ("wheel_odom.csv", 2, 180.0 / np.pi, "yaw rate of the wheel odometry .* deg/s"),
        ("wheel_odom.csv", 2, -1.0, "yaw rate of the wheel odometry .* left positive"),
        ("imu.csv", 3, 180.0 / np.pi, "yaw rate of the imu .* deg/s"),
        ("imu.csv", 3, -1.0, "yaw rate of the imu .* left positive"),
        ("gps.csv", 4, -1.0, "standard deviations .* expected positive"),
        ("gps.csv", 5, 0.0, "standard deviations .* expected positive"),
    ],
)
def test_wrong_units_and_signs_are_named(drive, file, column, factor, words):
    _scaled(drive / file, column, factor)
    with pytest.raises(SemlocError, match=words):
        open_drive(drive)


def test_degrees_are_named_where_the_path_hardly_bends(drive):
    """Fixes that jitter hide the bends of such a road, and the rates stay below those that no vehicle reaches."""
    rng, found = np.random.default_rng(3), open_drive(drive)
    time_s, imu_s = np.arange(0.0, 20.0, 0.2), np.arange(0.0, 20.0, 0.01)
    fixes = np.column_stack([9.0 * time_s, np.zeros_like(time_s), np.zeros_like(time_s)])
    fixes[:, :2] += rng.normal(scale=0.5, size=(len(time_s), 2))
    gyro = np.zeros((len(imu_s), 3))
    gyro[:, 2] = 0.02 * np.sin(0.4 * imu_s)
    gnss = GnssTrack(time_s, fixes, np.ones((len(time_s), 3)))
    straight = replace(found, odometry=None, truth=None, gnss=gnss, imu=Imu(imu_s, gyro, np.zeros_like(gyro)))
    check_units(straight)
    with pytest.raises(SemlocError, match="the imu turns by .* is it in deg/s"):
        check_units(replace(straight, imu=Imu(imu_s, np.degrees(gyro), np.zeros_like(gyro))))


def test_units_are_checked_against_the_truth_where_there_are_no_fixes(drive):
    (drive / "gps.csv").unlink()
    open_drive(drive)
    _scaled(drive / "wheel_odom.csv", 1, 3.6)
    with pytest.raises(SemlocError, match="km/h"):
        open_drive(drive)


@pytest.mark.parametrize("text", ["nan", "inf", ""])
def test_no_number_in_the_imu_is_told_with_its_row(drive, text):
    _cell(drive / "imu.csv", 41, 3, text)
    with pytest.raises(SemlocError, match="imu: row 42 holds NaN"):
        open_drive(drive)


def test_time_that_goes_back_in_the_imu_is_told(drive):
    _cell(drive / "imu.csv", 41, 0, "0.1")
    with pytest.raises(SemlocError, match="imu: row 42 is not later"):
        open_drive(drive)


def test_an_unknown_accuracy_is_that_of_a_plain_receiver(drive):
    _cell(drive / "gps.csv", 7, 4, "")
    np.testing.assert_array_equal(open_drive(drive).gnss.sigma_m[7], [3.0, 1.3, 2.5])


def test_quaternions_with_the_real_part_first_are_told(drive):
    table = np.loadtxt(drive / "poses_body.tum")
    np.savetxt(drive / "poses_body.tum", table[:, [0, 1, 2, 3, 7, 4, 5, 6]], fmt="%.9f")
    with pytest.raises(SemlocError, match="put qw last"):
        open_drive(drive)


@pytest.mark.parametrize(
    ("row", "column", "text", "num_left", "words"),
    [
        (3, 1, "nan", 19, "frame '000003' is left out: its time is nan"),
        (3, 1, "inf", 19, "frame '000003' is left out: its time is inf"),
        (3, 0, "000007", 18, "frame '000007' is left out: 2 frames have this name"),
        (3, 0, "../../../etc/passwd", 19, "its name is no name of a file"),
        (3, 0, "/etc/passwd", 19, "its name is no name of a file"),
        (3, 1, "5.700", 18, "2 frames are of 5.700 s"),
        (3, 1, "5.750", 20, None),
    ],
)
def test_a_bad_frame_costs_itself_only(drive, caplog, row, column, text, num_left, words):
    _cell(drive / "frames.csv", row, column, text)
    with caplog.at_level(logging.WARNING):
        found = open_drive(drive)
    assert len(found) == num_left
    assert np.all(np.diff([frame.time_s for frame in found.frames]) > 0.0)
    assert (words is None and not caplog.records) or words in caplog.text


def test_without_a_usable_frame_there_is_no_drive(drive):
    (drive / "frames.csv").write_text("frame,t\na,nan\n../b,1\n")
    with pytest.raises(SemlocError, match="no other is left"):
        open_drive(drive)


@pytest.mark.parametrize("name", ["../cam", "/tmp/cam"])
def test_camera_names_are_names_of_folders(drive, name):
    text = (drive / "calib.yaml").read_text()
    (drive / "calib.yaml").write_text(re.sub("name: .*", f"name: {name}", text, count=1))
    with pytest.raises(SemlocError, match="expected one that can name a folder"):
        open_drive(drive)


def test_camera_names_that_differ_by_case_only_are_told(drive):
    text = (drive / "calib.yaml").read_text()
    (name,) = open_drive(drive).rig.names
    second = text[text.index("cam0:") :].replace("cam0:", "cam1:")
    (drive / "calib.yaml").write_text(text + "\n" + re.sub("name: .*", f"name: {name.upper()}", second, count=1))
    with pytest.raises(SemlocError, match="differ by more than case"):
        open_drive(drive)


NO_TABLES = "null", "[]", '{"classes": null}', '{"classes": {"road": 1e999}}', '{"classes": {"road": 300}}', "[" * 9999


@pytest.mark.parametrize("text", NO_TABLES, ids=range(len(NO_TABLES)))
def test_what_is_no_class_table_is_told(drive, text):
    (drive / "meta.json").write_text(text)
    with pytest.raises(SemlocError, match=r"meta\.json"):
        open_drive(drive)
