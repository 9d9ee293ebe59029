"""`semloc learn`: files that localize and track take, a table of drives, one line for what cannot be learned from."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from semloc_jax.alignment.frame_localizer import LocalizeConfig
from semloc_jax.cli import localize, track
from semloc_jax.cli.arguments import read_settings
from semloc_jax.cli.main import FAILED, OK, USAGE, main
from semloc_jax.localization.localizer import TrackConfig
from semloc_jax.reports.learning import LEARNED, changes

ROOT = Path(__file__).resolve().parents[2]


def test_only_what_differs_is_written():
    before = LocalizeConfig()
    after = replace(before, cost_maps=replace(before.cost_maps, ramp_px=(40.0, 14.0, 8.0, 4.5)))
    assert changes(before, after) == {"cost_maps": {"ramp_px": [40.0, 14.0, 8.0, 4.5]}}
    assert changes(before, before) == {}


def test_nothing_to_learn_from_is_wrong_usage(capsys):
    assert main(["learn"]) == USAGE
    assert "no drives to learn from" in capsys.readouterr().err


def test_a_drive_without_truth_is_refused(simulated_road, tmp_path, capsys):
    drive = tmp_path / "drive"
    drive.mkdir()
    for file in simulated_road.iterdir():
        if file.name != "poses_body.tum":
            (drive / file.name).symlink_to(file)
    assert main(["learn", str(drive), "--masks", "sem", "--out", str(tmp_path / "out")]) == FAILED
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "truth" in said


@pytest.mark.slow
def test_learned_files_are_taken_by_localize_and_track(simulated_road, tmp_path):
    """In a process of its own: what other tests compiled in float64 does not go with what runs in float32."""
    out = tmp_path / "out"
    words = ["--masks", "sem", "--num-frames", "2", "--num-steps", "2", "--out", str(out)]
    command = [sys.executable, "-m", "semloc_jax.cli.main", "learn", str(simulated_road), *words]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == OK, done.stderr
    assert "| road | learned from | 2 |" in done.stdout
    single, _ = read_settings(str(out / LEARNED), localize.Options, LocalizeConfig())
    tracking, _ = read_settings(str(out / LEARNED), track.Options, TrackConfig())
    assert single.view.class_weight == tracking.scene.view.class_weight != ()
    assert single.cost_maps.ramp_px == tracking.scene.cost_maps.ramp_px
    assert (out / "report.json").is_file()
    assert yaml.safe_load((out / "config.yaml").read_text())["masks"] == "sem"
