"""`semloc odometry`: files, figures and refusals; the way itself is tested in the rooms below."""

import json
import shutil

import numpy as np
import pytest

from semloc_jax.cli.main import main
from semloc_jax.evaluation import read_trajectory


def metrics_of(folder):
    rows = json.loads((folder / "metrics.json").read_text())["metrics"]
    return {row["key"]: row["value"] for row in rows}


def test_wheels_alone_give_a_way_its_drift_and_a_picture(simulated_road, tmp_path, capsys):
    assert main(["odometry", str(simulated_road), "--motion", "wheels", "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "drift.translation" in said and str(tmp_path) in said
    way = read_trajectory(tmp_path / "trajectory.tum")
    assert len(way) == 3 and np.allclose(way.T_map_base[0, :3, 3], 0.0)
    found = metrics_of(tmp_path)
    assert found["frames.estimated"] == found["frames.drive"] == 3
    assert found["drift.translation"] < 3.0 and found["drift.way"] > 2.0
    assert {"config.yaml", "frames.csv", "odometry.png"} <= {path.name for path in tmp_path.iterdir()}


def test_what_cannot_be_done_is_refused_in_one_line(simulated_road, tmp_path, capsys):
    drive = tmp_path / "drive"
    shutil.copytree(simulated_road, drive)

    def refused(*words):
        assert main(["odometry", str(drive), "--out", str(tmp_path / "out"), *words]) == 1
        error = capsys.readouterr().err.strip().splitlines()[-1]
        assert error.startswith("semloc odometry:") and "Traceback" not in error
        return error

    assert "shorter than 3 s or 12 images" in refused("--masks", "none")
    assert "not in the calibration" in refused("--cameras", "roof")
    (drive / "wheel_odom.csv").unlink()
    assert "no wheel odometry" in refused("--motion", "both")
    (drive / "imu.csv").unlink()
    assert "no inertial data" in refused("--motion", "vio")
    assert "no wheel odometry" in refused(), "auto has nothing to take"


@pytest.mark.slow
def test_a_rendered_town_road_drifts_little_and_says_how_much(road_dir, tmp_path):
    """Noon, low sun and a wet night with two jumps of light: 15 s of camera and inertial sensor alone."""
    words = ["odometry", str(road_dir), "--masks", "sem_net", "--motion", "vio", "--out", str(tmp_path)]
    assert main(words) == 0
    found = metrics_of(tmp_path)
    assert found["drift.translation"] < 0.8 and found["drift.rotation"] < 0.003
    assert found["start"] <= 2.0
