"""Several drives in one command line: the results are those of single runs, in any number of processes."""

import csv
import shutil
import subprocess
import sys

import pytest

from semloc_jax.cli.main import FAILED, LOST, OK, USAGE, main
from tests.effort import environment_of_users

TABLES = ("trajectory.tum", "hypotheses.csv")


@pytest.fixture(scope="module")
def drives(simulated_road, tmp_path_factory):
    """Two drives of two frames and one without masks."""
    folder = tmp_path_factory.mktemp("fleet")
    for name in ("one", "two", "broken"):
        shutil.copytree(simulated_road, folder / name)
    shutil.rmtree(folder / "broken" / "masks", ignore_errors=True)
    for masks in (folder / "broken").glob("sem*"):
        shutil.rmtree(masks)
    return folder


def localize(drives, names, *options):
    """The light localizer of the literature on two frames: it compiles next to nothing."""
    own = ["--method", "icp", "--masks", "sem", "--prior", "truth", "--frames", ":2", "--overlays", "0"]
    return main(["localize", *(str(drives / name) for name in names), *own, *map(str, options)])


def rows(folder):
    with (folder / "fleet.csv").open(newline="") as file:
        return {row["drive"]: row for row in csv.DictReader(file)}


@pytest.mark.slow
def test_processes_give_what_single_runs_give(drives, tmp_path, capsys):
    for name in ("one", "two"):
        localize(drives, [name], "--out", tmp_path / "alone" / name, "--min-localized-share", 0)
    fleet = tmp_path / "fleet"
    capsys.readouterr()
    assert localize(drives, ["one", "two"], "--out", fleet, "--jobs", 2, "--min-localized-share", 0) == OK
    said = {words[0]: words[1:] for words in map(str.split, capsys.readouterr().out.splitlines())}
    for name in ("one", "two"):
        for table in TABLES:
            assert (fleet / name / table).read_bytes() == (tmp_path / "alone" / name / table).read_bytes()
        assert rows(fleet)[name]["num_frames"] == "2" and rows(fleet)[name]["result"] == "done"
        assert said[name][:2] == ["done", "2"]
        assert "localized" in (fleet / name / "console.txt").read_text()
    assert said["all"][0] == "4"


@pytest.mark.slow
@pytest.mark.parametrize(("verb", "frames"), [("localize", ":1"), ("track", ":3")])
def test_the_search_and_the_tracker_give_in_processes_what_they_give_alone(drives, tmp_path, verb, frames):
    def run(names, *options):
        given = (*(drives / name for name in names), "--masks", "sem", "--frames", frames, *options)
        command = [sys.executable, "-m", "semloc_jax.cli.main", verb, *map(str, given)]
        assert subprocess.run(command, env=environment_of_users(), check=False).returncode in (OK, LOST)

    for name in ("one", "two"):
        run([name], "--out", tmp_path / name)
    run(["one", "two"], "--jobs", 2, "--out", tmp_path / "fleet")
    for name in ("one", "two"):
        alone, together = (folder / name / "trajectory.tum" for folder in (tmp_path, tmp_path / "fleet"))
        assert alone.read_bytes() == together.read_bytes() and len(alone.read_text().splitlines()) > 1


def test_a_drive_that_fails_costs_itself_only_and_is_tried_again(drives, tmp_path, capsys):
    out = tmp_path / "fleet"
    assert localize(drives, ["broken", "one"], "--out", out, "--min-localized-share", 0) == FAILED
    assert rows(out)["broken"]["result"] == "failed" and "sem" in rows(out)["broken"]["why"]
    assert rows(out)["one"]["result"] == "done"
    written = (out / "one" / "frames.csv").stat().st_mtime_ns
    shutil.copytree(drives / "one" / "sem", drives / "broken" / "sem")
    assert localize(drives, ["broken", "one"], "--resume", out, "--min-localized-share", 0) == OK
    assert [row["result"] for row in rows(out).values()] == ["done", "done"]
    assert (out / "one" / "frames.csv").stat().st_mtime_ns == written


def test_what_cannot_be_is_said_in_one_line(drives, simulated_road, tmp_path, capsys):
    assert localize(drives, ["one", "one"], "--out", tmp_path) == FAILED
    assert "several are called one" in capsys.readouterr().err
    assert localize(drives, ["one", "two"], "--out", tmp_path, "--jobs", 0) == USAGE
    (tmp_path / "fleet.csv").write_text("drive,other\none,1\n")
    assert localize(drives, ["one", "two"], "--resume", tmp_path) == FAILED
    assert "fleet.csv: expected the columns drive, result" in capsys.readouterr().err
