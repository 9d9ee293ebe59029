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
import yaml

from semloc_jax.cameras.io import read_calibration, write_calibration
from semloc_jax.evaluation import Trajectory, read_trajectory, write_tum
from semloc_jax.maps import SemanticMap, read_map
from semloc_jax.maps.elements import MapElement
from semloc_jax.maps.io import write_map
from semloc_jax.reports.tables import write_csv
from semloc_jax.simulation import SimulationConfig, simulate
from semloc_jax.storage import write_sealed, write_text
from semloc_jax.structs import ElementClass
from semloc_jax.viz import save
from tests.perception.onnx_files import red_or_blue

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
ROOT = Path(__file__).resolve().parents[2]


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


@pytest.fixture(scope="module")
def material(simulated_road, tmp_path_factory) -> Path:
    """A folder with a drive for all verbs, longer ones for `calibrate` and `map` and a network for `segment`."""
    folder = tmp_path_factory.mktemp("material")
    (folder / "drive").symlink_to(simulated_road)
    longer = SimulationConfig(num_frames=6, rate_hz=2.0, width_px=240, height_px=150)
    simulate("road", 5, folder / "longer", longer)
    mapped = SimulationConfig(num_frames=14, rate_hz=8.0, width_px=240, height_px=150, has_images=False)
    simulate("road", 5, folder / "mapped", mapped)
    red_or_blue(folder / "net.onnx", size=(120, 76))
    preset = {"model": "net.onnx", "class_table": "drive"}
    (folder / "preset.yaml").write_text(json.dumps(preset))
    return folder


def _verbs(material: Path, out: Path) -> dict[str, list[str]]:
    """Words of each verb that writes, for a small drive; outputs go below the folder `out`."""
    drive, to = str(material / "drive"), ["--out", str(out)]
    small, search = ["--masks", "sem", "--overlays", "2"], ["--search.num-hypotheses", "256"]
    size = ["--num-frames", "3", "--width-px", "240", "--height-px", "150"]
    return {
        "simulate": ["simulate", str(out), *size],
        "convert": ["convert", f"{drive}/map.geojson", str(out / "map.gpkg")],
        "segment": ["segment", drive, "--preset", str(material / "preset.yaml"), *to],
        "localize": ["localize", drive, "--hypotheses", "256", *small, *to],
        "track": ["track", drive, "--fusion", "kalman", "--video", *search, *small, *to],
        "map": ["map", str(material / "mapped"), "--masks", "sem", "--start", "truth", "--overlays", "1", *to],
        "calibrate": ["calibrate", str(material / "longer"), *small, *to],
        "learn": ["learn", drive, "--masks", "sem", "--num-frames", "2", "--num-steps", "2", *to],
    }


RESUMABLE = ("localize", "track", "map")


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["simulate", "convert", "segment", "localize", "track", "map", "calibrate", "learn"])
def test_verbs_killed_at_random_leave_nothing_broken(material, tmp_path, verb):
    """Half of the kills come at a random time within a run, half at a random change of a file; into a new folder and
    one that holds what earlier runs left."""
    rng, count = random.Random(verb), int(os.environ.get("SEMLOC_KILLS", "20"))
    out = tmp_path / "out"
    words = _verbs(material, out)[verb]
    changes, whole_s = _measured(out, words)
    broken, killed, tries = _broken(out), 0, 0
    while killed < count:
        tries += 1
        assert tries <= 3 * count, f"{killed} of {tries} runs were killed before their end"
        if tries % 4 < 2 or (verb == "simulate" and (out / "frames.csv").exists()):  # it overwrites no drive
            shutil.rmtree(out, ignore_errors=True)
            out.mkdir()
        chosen = _resuming(words, out) if verb in RESUMABLE and tries % 8 > 5 else words
        if tries % 2:
            done = _run(out, rng.randint(1, changes), chosen)
        else:
            done = _run(out, 0, chosen, rng.uniform(0.0, 1.0) * whole_s)
        assert done.returncode in (-signal.SIGKILL, 0, 3) or _is_unbegun(done.stderr), done.stderr
        killed += done.returncode == -signal.SIGKILL
        broken += _broken(out)
        print(f"{verb}: kill {killed} of {count}, run {tries}, {len(broken)} broken", file=sys.stderr, flush=True)
    print(f"{verb}: {killed} kills in runs of {whole_s:.1f} s with {changes} changes of files", file=sys.stderr)
    assert broken == []
    if verb in RESUMABLE:
        done = _run(out, 0, _resuming(words, out))
        assert done.returncode in (0, 3) or _is_unbegun(done.stderr), done.stderr
        table = out / "frames.csv"
        assert _is_unbegun(done.stderr) or not table.exists() or len(table.read_text().splitlines()) == 4
    if verb != "simulate" or not (out / "frames.csv").exists():
        done = _run(out, 0, words)
        assert done.returncode in (0, 3), done.stderr
    assert _broken(out) == [] and [path.name for path in out.rglob(".*")] == []


def _measured(out: Path, words: list[str]) -> tuple[int, float]:
    """Changes of files and seconds of a whole run, after one that compiles what all later ones load."""
    for _ in range(2):
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir()
        started = time.perf_counter()
        whole = _run(out, 0, words)
        assert whole.returncode in (0, 3), whole.stderr
    changes = int(whole.stderr.split()[-1])
    assert changes > 1 and list(out.rglob("*.*"))
    return changes, time.perf_counter() - started


def _resuming(words: list[str], out: Path) -> list[str]:
    return [*(word for word in words if word not in ("--out", str(out))), "--resume", str(out)]


def _is_unbegun(said: str) -> bool:
    """Whether a run could not be resumed because the kill came before it had begun."""
    return any(words in said for words in ("has no inputs.json", "no such folder", "has no folder 'parts'"))


COMMAND = [sys.executable, "-m", "semloc_jax.cli.main"]


def _run(out: Path, at: int, words: list[str], timeout_s: float | None = None) -> subprocess.CompletedProcess:
    """A verb that is killed at a change of a file below `out` (0: at none), or when its time is over."""
    command = [sys.executable, "-m", "tests.storage.killed_verb", str(out), str(at), *words]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=ROOT) as process:
        try:
            said = process.communicate(timeout=timeout_s)[1]
        except subprocess.TimeoutExpired:
            process.kill()
            said = process.communicate()[1]
    return subprocess.CompletedProcess(command, process.returncode, stderr=said)


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
    elif path.suffix in (".yaml", ".yml"):
        assert yaml.safe_load(path.read_text()) is not None
    elif path.suffix == ".mp4":
        assert cv2.VideoCapture(str(path)).read()[0]
    elif path.suffix == ".jsonl":
        for line in path.read_text().split("\n")[:-1]:
            json.loads(line)
    elif path.suffix == ".csv":
        rows = list(csv.reader(path.read_text().splitlines()))
        assert rows and all(len(row) == len(rows[0]) for row in (rows[:-1] if growing else rows))
