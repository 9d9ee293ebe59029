"""`semloc track` on a simulated drive: files, resuming, exit codes, and one line for bad input."""

import csv
import json
import shutil

import numpy as np
import pytest

from semloc_jax.cli.main import FAILED, LOST, OK, USAGE, main
from semloc_jax.evaluation import pose_errors, read_trajectory
from semloc_jax.simulation import SimulationConfig, simulate

SMALL = ["--masks", "sem", "--fusion", "kalman", "--overlays", "1", "--search.num-hypotheses", "256"]


def rows_of(folder):
    with (folder / "frames.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def drive_dir(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drives") / "road"
    simulate("road", 5, folder, SimulationConfig(num_frames=9, rate_hz=5.0, width_px=480, height_px=300))
    return folder


@pytest.fixture(scope="module")
def tracked(drive_dir, tmp_path_factory):
    out = tmp_path_factory.mktemp("tracked")
    assert main(["track", str(drive_dir), *SMALL, "--video", "--min-tracking-share", "0.2", "--out", str(out)]) == OK
    return out


def test_the_trajectory_is_the_truth_to_centimetres(tracked, drive_dir):
    found = read_trajectory(tracked / "trajectory.tum")
    truth = read_trajectory(drive_dir / "poses_body.tum")
    errors = pose_errors(found.T_map_base, truth.interpolate(found.time_s))
    assert len(found) >= 8
    assert np.abs(errors["lateral_m"][2:]).max() < 0.03
    assert np.abs(errors["longitudinal_m"][2:]).max() < 0.10


def test_every_frame_has_a_row_with_status_and_times(tracked):
    rows = rows_of(tracked)
    assert [row["frame"] for row in rows] == [f"{k:06d}" for k in range(9)]
    assert {row["status"] for row in rows} <= {"INITIALIZING", "TRACKING", "DEGRADED", "LOST"}
    assert rows[-1]["status"] == "TRACKING"
    assert all(float(row["align_ms"]) >= 0.0 for row in rows)


def test_metrics_and_pictures_are_written(tracked):
    metrics = {m["key"]: m["value"] for m in json.loads((tracked / "metrics.json").read_text())["metrics"]}
    assert metrics["tracking.false"] == 0.0
    assert metrics["status.tracking"] > 0.2
    assert metrics["lateral.mean"] < 0.03
    for name in ("tracking.png", "track.mp4", "config.yaml", "map_changes.csv", "state.npz"):
        assert (tracked / name).stat().st_size > 0, name


def test_a_killed_run_goes_on_where_it_stopped(tracked, drive_dir, tmp_path):
    out = tmp_path / "killed"
    words = ["track", str(drive_dir), *SMALL, "--min-tracking-share", "0"]
    assert main([*words, "--frames", ":6", "--out", str(out)]) == OK
    with (out / "frames.csv").open("a") as file:
        file.write("000006,torn")  # the line that was being written when the power went
    assert main([*words, "--resume", str(out)]) == OK
    whole, resumed = rows_of(tracked), rows_of(out)
    times = [key for key in whole[0] if key.endswith("_ms")]
    for one, two in zip(whole, resumed, strict=True):
        assert {k: v for k, v in one.items() if k not in times} == {k: v for k, v in two.items() if k not in times}


@pytest.mark.parametrize(
    ("change", "words", "text"),
    [
        (lambda out: None, ["--masks", "sem_net"], "began with other masks"),
        (lambda out: None, ["--fusion", "single"], "began with other options"),
        (lambda out: _shorten(out / "frames.csv", 4), [], "line 4 of frames.csv is not that of frame 000003"),
        (lambda out: (out / "inputs.json").unlink(), [], "has no inputs.json"),
        (lambda out: None, ["--frames", ":5"], "9 frames are done and the drive has 5"),
    ],
)
def test_a_run_is_resumed_with_the_same_only(tracked, drive_dir, tmp_path, capsys, change, words, text):
    out = shutil.copytree(tracked, tmp_path / "killed")
    change(out)
    assert main(["track", str(drive_dir), *SMALL, *words, "--resume", str(out)]) == FAILED
    assert text in capsys.readouterr().err.splitlines()[-1]


def _shorten(path, num_lines):
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:num_lines]))


def test_a_drive_that_never_tracks_ends_with_3(drive_dir, tmp_path):
    assert main(["track", str(drive_dir), *SMALL, "--frames", ":1", "--out", str(tmp_path)]) == LOST


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (["--area", "1,2"], USAGE, "expected X,Y,RADIUS"),
        (["--resume", "nowhere"], FAILED, "no such folder; give that of an unfinished run"),
        (["--fault", "gremlins"], FAILED, "not known; expected one of"),
        (["--fusion", "magic"], USAGE, "magic"),
    ],
)
def test_bad_input_is_one_line(drive_dir, tmp_path, monkeypatch, capsys, words, code, text):
    monkeypatch.chdir(tmp_path)
    assert main(["track", str(drive_dir), *SMALL, *words]) == code
    said = capsys.readouterr().err.strip().splitlines()
    assert text in said[-1]


def test_a_drive_without_fixes_says_what_it_needs(drive_dir, tmp_path, capsys):
    blind = tmp_path / "blind"
    shutil.copytree(drive_dir, blind)
    (blind / "gps.csv").unlink()
    assert main(["track", str(blind), *SMALL, "--out", str(tmp_path / "out")]) == FAILED
    assert "--area X,Y,RADIUS" in capsys.readouterr().err


def test_fixes_are_not_needed_once_the_vehicle_is_tracked(drive_dir, tmp_path):
    words = ["--no-gnss-after-init", "--out", str(tmp_path), "--min-tracking-share", "0.2"]
    assert main(["track", str(drive_dir), *SMALL, *words]) == OK
    last = rows_of(tmp_path)[-1]
    assert last["status"] == "TRACKING"
    assert abs(float(last["error_lateral_m"])) < 0.03 and abs(float(last["error_longitudinal_m"])) < 0.10


@pytest.mark.slow
def test_an_area_is_searched_where_there_are_no_fixes(drive_dir, tmp_path):
    blind = tmp_path / "blind"
    shutil.copytree(drive_dir, blind)
    (blind / "gps.csv").unlink()
    x, y = read_trajectory(drive_dir / "poses_body.tum").T_map_base[0, :2, 3] + [1.5, -2.0]
    words = [f"--area={x},{y},5", "--out", str(tmp_path / "out"), "--min-tracking-share", "0.2"]
    assert main(["track", str(blind), *SMALL, *words]) == OK
    last = rows_of(tmp_path / "out")[-1]
    assert abs(float(last["error_lateral_m"])) < 0.03 and abs(float(last["error_longitudinal_m"])) < 0.10


@pytest.mark.slow
def test_every_fusion_on_the_same_features(drive_dir, tmp_path):
    words = ["track", str(drive_dir), *SMALL, "--fusion", "all", "--out", str(tmp_path)]
    assert main(words) == OK
    with (tmp_path / "fusions.csv").open() as file:
        rows = {row["fusion"]: row for row in csv.DictReader(file)}
    assert set(rows) == {"window", "dropping", "kalman", "inertial", "single"}
    assert all(float(row["lateral_mean_m"]) < 0.03 and int(row["false"]) == 0 for row in rows.values())


@pytest.fixture
def without_wheels(drive_dir, tmp_path):
    drive = tmp_path / "drive"
    shutil.copytree(drive_dir, drive)
    (drive / "wheel_odom.csv").unlink()
    return drive


def test_without_wheels_the_inertial_sensor_takes_over_and_the_console_says_so(without_wheels, tmp_path, caplog):
    words = [*SMALL[:2], *SMALL[4:], "--prior", "truth", "--min-tracking-share", "0.2", "--out", str(tmp_path / "out")]
    assert main(["track", str(without_wheels), *words]) == OK
    assert "motion: inertial sensor; cameras gave no start: the drive is too short" in caplog.text
    found = read_trajectory(tmp_path / "out" / "trajectory.tum")
    truth = read_trajectory(without_wheels / "poses_body.tum")
    errors = pose_errors(found.T_map_base, truth.interpolate(found.time_s))
    assert len(found) >= 8
    assert np.abs(errors["lateral_m"][2:]).max() < 0.03 and np.abs(errors["longitudinal_m"][2:]).max() < 0.15


def test_motion_that_the_drive_does_not_have_is_refused_in_one_line(without_wheels, capsys):
    def refused(code, *words):
        assert main(["track", str(without_wheels), "--masks", "sem", *words]) == code
        error = capsys.readouterr().err.strip().splitlines()[-1]
        assert error.startswith("semloc track:") and "Traceback" not in error
        return error

    assert "knows no velocity; use --fusion inertial" in refused(USAGE, "--motion", "vio", "--fusion", "window")
    for choice in ("wheels", "both"):
        assert "no wheel odometry" in refused(FAILED, "--motion", choice)
    (without_wheels / "imu.csv").unlink()
    error = refused(FAILED, "--motion", "vio")
    assert "has no inertial data" in error and "--motion wheels" not in error, "there are no wheels either"
