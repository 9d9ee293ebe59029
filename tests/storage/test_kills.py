"""A kill at any point leaves every output old, new or resumable.

By default each writer is killed at the worst place: with everything written and not yet renamed. The slow test kills
whole verbs at random times; SEMLOC_KILLS is how often each (20 where it is not set).
"""

import csv
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from semloc_jax.cameras.io import read_calibration, write_calibration
from semloc_jax.evaluation import Trajectory, read_trajectory, write_tum
from semloc_jax.maps import SemanticMap, read_map
from semloc_jax.maps.elements import MapElement
from semloc_jax.maps.io import write_map
from semloc_jax.reports.tables import write_csv
from semloc_jax.storage import write_sealed, write_text
from semloc_jax.structs import ElementClass
from semloc_jax.viz import save

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")


def _map(num: int) -> SemanticMap:
    points = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0]])
    lines = (MapElement(f"{k}", ElementClass.LANE_MARKING, points + k, width_m=0.1, style="solid") for k in range(num))
    return SemanticMap(tuple(lines))


def _trajectory(num: int) -> Trajectory:
    return Trajectory(np.arange(float(num)), np.tile(np.eye(4), (num, 1, 1)))


WRITERS = {
    "text.json": lambda path, num: write_text(path, json.dumps([0] * num)),
    "table.csv": lambda path, num: write_csv(path, ["a", "b"], [(1, 2)] * num),
    "poses.tum": lambda path, num: write_tum(_trajectory(num), path),
    "picture.png": lambda path, num: save(np.zeros((num, num, 3), np.uint8), path),
    "program.bin": lambda path, num: write_sealed(path, bytes(num)),
    **{
        f"map{suffix}": lambda path, num: write_map(_map(num), path)
        for suffix in (".geojson", ".gpkg", ".osm", ".smap")
    },
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_writer_killed_before_the_end_leaves_the_old_file(tmp_path, name):
    path = tmp_path / name
    WRITERS[name](path, 3)
    old = path.read_bytes()
    pid = os.fork()
    if pid == 0:
        os.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
        try:
            WRITERS[name](path, 50)
        finally:
            os._exit(1)
    _, status = os.waitpid(pid, 0)
    assert os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL
    assert path.read_bytes() == old
    WRITERS[name](path, 50)
    assert path.read_bytes() != old


def test_a_calibration_killed_before_the_end_leaves_the_old_one(tmp_path, simulated_road):
    rig, path = read_calibration(simulated_road / "calib.yaml"), tmp_path / "calib.yaml"
    write_calibration(rig, path)
    old = path.read_bytes()
    pid = os.fork()
    if pid == 0:
        os.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
        try:
            write_calibration(rig, path)
        finally:
            os._exit(1)
    os.waitpid(pid, 0)
    assert path.read_bytes() == old


def _verbs(drive: Path, folder: Path) -> dict[str, list[str]]:
    """Words of each verb that writes, for one small drive; outputs go below the folder."""
    small = ["--overlays", "2", "--out", str(folder / "out")]
    search = ["--acquisition.search.num-hypotheses", "256"]
    return {
        "simulate": [
            "simulate",
            "road",
            str(folder / "out"),
            "--frames",
            "3",
            "--width-px",
            "240",
            "--height-px",
            "150",
        ],
        "convert": ["convert", str(drive / "map.geojson"), str(folder / "out" / "map.gpkg")],
        "localize": ["localize", str(drive), "--masks", "sem", "--hypotheses", "256", *small],
        "track": ["track", str(drive), "--masks", "sem", "--fusion", "kalman", *search, *small],
    }


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["simulate", "convert", "localize", "track"])
def test_verbs_killed_at_random_leave_nothing_broken(simulated_road, tmp_path, verb):
    rng, count = random.Random(verb), int(os.environ.get("SEMLOC_KILLS", "20"))
    words = _verbs(simulated_road, tmp_path)[verb]
    command, out = [sys.executable, "-m", "semloc_jax.cli.main"], tmp_path / "out"
    out.mkdir()
    started = time.perf_counter()
    subprocess.run([*command, *words], capture_output=True, check=False)
    whole_s = time.perf_counter() - started
    broken = _broken(out)
    for _ in range(count):
        if verb == "simulate":  # which wants an empty folder
            shutil.rmtree(out, ignore_errors=True)
        with subprocess.Popen([*command, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            time.sleep(rng.uniform(0.0, 1.1) * whole_s)
            process.kill()
        broken += _broken(out)
    assert broken == []
    if verb in ("localize", "track"):
        again = [word for word in words if word not in ("--out", str(out))]
        done = subprocess.run([*command, *again, "--resume", str(out)], capture_output=True, text=True, check=False)
        assert done.returncode in (0, 3), done.stderr
        assert len((out / "frames.csv").read_text().splitlines()) == 4


def _broken(folder: Path) -> list[str]:
    """Files that cannot be read as what their names say; of files that grow, the last line may be cut."""
    found = []
    for path in sorted(folder.rglob("*")):
        if path.is_dir() or path.name.startswith("."):
            continue
        try:
            _read(path)
        except Exception as error:
            found.append(f"{path.name}: {error!r}")
    return found


def _read(path: Path) -> None:
    growing = path.name in ("frames.csv", "results.jsonl")
    if path.suffix in (".png", ".jpg"):
        assert cv2.imread(str(path)) is not None
    elif path.suffix in (".gpkg", ".geojson", ".osm"):
        assert read_map(path).extent.shape == (2, 3)
    elif path.suffix == ".tum":
        assert path.read_text().count("\n") < 2 or len(read_trajectory(path)) > 0
    elif path.suffix == ".json":
        json.loads(path.read_text())
    elif path.suffix == ".jsonl":
        for line in path.read_text().split("\n")[:-1]:
            json.loads(line)
    elif path.suffix == ".csv":
        rows = list(csv.reader(path.read_text().splitlines()))
        assert rows and all(len(row) == len(rows[0]) for row in (rows[:-1] if growing else rows))
