"""`semloc learn eyes`: its words beside `semloc learn`, and a whole run on a tiny drive."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from semloc_jax.cli.main import OK, USAGE, main

ROOT = Path(__file__).resolve().parents[2]


def test_nothing_to_learn_from_is_wrong_usage(capsys):
    assert main(["learn", "eyes"]) == USAGE
    assert "no drives to learn from" in capsys.readouterr().err


def test_help_tells_what_is_written(capsys):
    assert main(["learn", "eyes", "--help"]) == OK
    said = capsys.readouterr().out
    assert "semloc learn eyes" in said and "--held-out-frames" in said and "eyes.weights" in said


def test_frames_that_judge_do_not_teach(simulated_road, capsys):
    assert main(["learn", "eyes", str(simulated_road), "--masks", "sem", "--held-out-frames", ":"]) == USAGE
    assert "all of its frames judge; give other --frames or --held-out-frames" in capsys.readouterr().err


@pytest.mark.slow
def test_a_round_is_taught_judged_and_told(simulated_road, tmp_path):
    """Exact masks teach for three steps: nothing is better than they are, and nothing is kept but the round's file."""
    out = tmp_path / "out"
    words = ["--masks", "sem", "--held-out-frames", "2", "--rounds", "1", "--training.num-steps", "3"]
    command = [sys.executable, "-m", "semloc_jax.cli.main", "learn", "eyes", str(simulated_road), *words]
    done = subprocess.run([*command, "--out", str(out)], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == OK, done.stderr
    assert "no round was better than what there was" in done.stdout
    rounds = json.loads((out / "rounds.json").read_text())
    assert rounds["best"] == 0 and [one["num_accepted"] for one in rounds["rounds"]] == [1, 0]
    made = {path.name for path in out.iterdir()}
    assert {"round_1.weights", "report.md", "rounds.png", "frames.png", "labels.png", "config.yaml"} <= made
    assert not made & {"eyes.weights", "round_1.checkpoint"}
    again = [*command[:3], "localize", str(simulated_road), "--masks", str(out / "round_1.weights"), "--overlays", "0"]
    told = subprocess.run([*again, "--out", str(tmp_path / "l")], capture_output=True, text=True, cwd=ROOT, check=False)
    assert "masks are empty" in told.stderr + told.stdout
