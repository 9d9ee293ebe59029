"""What a user waits for: whole commands on simulated drives, cold and warm (room: bench; host).

In: which drives and verbs. Out: DriveRun for each: CPU and wall time of the start and of a frame, its stages, memory.
Every run is a process of its own, as a user starts it: imports, programs, kernels, reading and writing are in its time.
"""

import csv
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from semloc_jax.bench import machine
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import Metric, read_metrics

VERBS = ("localize", "track")
_FEW = 3
"""Frames of the runs that tell what a start costs: after them every program is there."""
_WARM_RUNS = 2
"""Of so many the one with the least CPU time counts: what else the machine does can only add to it."""
_MASKS = "sem_net"
_OPTIONS = {"localize": ("--overlays", "0", "--min-localized-share", "0"), "track": ()}
TOLERANCE, GOOD_TOLERANCE = 0.3, 0.15
"""A cost may be above its baseline by this share, the share of good frames below by so much: few frames are driven. Our
choice; two runs on one idle machine agree within a tenth."""
BASELINE = Path(__file__).with_name("drives_baseline.json")
_START = "import jax, jax.numpy as jnp; jax.jit(lambda x: jnp.cumsum(jnp.sort(x) ** 2))(jnp.arange(64.0))"
"""A process that imports JAX and compiles one small program: what Python and the compiler are worth on this machine."""
_LOST = 3
"""Exit code of a run that worked and did not reach the share of good frames; see `semloc --help`."""


@dataclass(frozen=True)
class DriveCase:
    """A simulated drive that anyone can make."""

    name: str
    kind: str
    num_frames: int
    seed: int = 0


CASES = (DriveCase("road, 1 camera", "road", 30), DriveCase("garage, 4 fisheyes", "garage", 20))


class Spent(NamedTuple):
    """What a process and those it started have used."""

    cpu_s: float
    wall_s: float
    peak_mib: float
    """Of the largest of them."""


@dataclass(frozen=True)
class DriveRun:
    """One verb on one drive."""

    verb: str
    case: DriveCase
    cold: Spent
    """A few frames, with nothing compiled: kernels and programs are made."""
    warm: Spent
    """The same again."""
    whole: Spent
    """The whole drive, warm."""
    stages_ms: dict[str, float]
    """Median wall time of the stages of a frame."""
    yardstick_ms: float
    """CPU time of decoding the masks of one frame and two distance transforms of each: what this machine is worth."""
    good: float
    """Share of frames that are localized, or tracked."""
    start_s: float
    """CPU time of a process that imports JAX and compiles one small program, as it was around the runs."""
    spread: float
    """How far the two yardsticks, before and after, lie apart: what the load of the machine makes of CPU times."""

    @property
    def frame_cpu_ms(self) -> float:
        """CPU time of a frame, all in, without the start."""
        return 1e3 * (self.whole.cpu_s - self.warm.cpu_s) / (self.case.num_frames - _FEW)

    @property
    def frame_wall_ms(self) -> float:
        """Wall time of a frame without the start."""
        return 1e3 * (self.whole.wall_s - self.warm.wall_s) / (self.case.num_frames - _FEW)


class FleetRun(NamedTuple):
    """Two drives by one command line, warm."""

    verb: str
    jobs: int
    num_frames: int
    spent: Spent

    @property
    def per_core_hour(self) -> float:
        """Frames that one core does in an hour."""
        return 3600 * self.num_frames / self.spent.cpu_s

    @property
    def per_hour(self) -> float:
        """Frames that the machine did in an hour."""
        return 3600 * self.num_frames / self.spent.wall_s


def measure_drives(
    cases: Sequence[DriveCase], folder: Path, has_fleet: bool, say: Callable[[str], None]
) -> tuple[list[DriveRun], list[FleetRun]]:
    """Simulate the drives and run every verb on each.

    Args:
        cases: Drives.
        folder: Where they, their results and the cache of compiled programs go.
        has_fleet: Whether two drives of the first case are run with one and with two jobs as well.
        say: Called with a line on each step.
    """
    runs = []
    for case in cases:
        drive = _simulated(case, folder, say)
        for verb in VERBS:
            runs.append(_measured(verb, case, drive, folder))
            say(f"{verb} {case.name}: a frame {runs[-1].frame_cpu_ms:.0f} ms CPU")
    if not has_fleet:
        return runs, []
    first = cases[0]
    other = DriveCase(first.name, first.kind, first.num_frames, first.seed + 1)
    drives = [_simulated(case, folder, say) for case in (first, other)]
    return runs, [_fleet(verb, jobs, 2 * first.num_frames, drives, folder) for verb in VERBS for jobs in (1, 2)]


def _simulated(case: DriveCase, folder: Path, say: Callable[[str], None]) -> Path:
    drive = folder / f"{case.kind}{case.seed}"
    if not drive.is_dir():
        say(f"rendering {case.num_frames} frames: {case.name}")
        words = ("--kind", case.kind, "--seed", str(case.seed), "--num-frames", str(case.num_frames), "--masks-only")
        _run(["simulate", str(drive), *words], folder / "cache")
    return drive


def _measured(verb: str, case: DriveCase, drive: Path, folder: Path) -> DriveRun:
    own = folder / f"{verb} {drive.name}"
    cache, out = own / "cache", own / "out"

    def run(frames: str) -> Spent:
        shutil.rmtree(out, ignore_errors=True)
        words = ["--map", str(drive / "map.geojson"), "--masks", _MASKS, "--frames", frames, "--out", str(out)]
        return _run([verb, str(drive), *words, *_OPTIONS[verb]], cache)

    masks = sorted((drive / _MASKS).rglob("*.png"))
    starts_s, units_ms = [_start_s(folder)], [yardstick(masks, case.num_frames)]
    cold = run(f":{_FEW}")
    starts_s.append(_start_s(folder))
    warm = min(run(f":{_FEW}") for _ in range(_WARM_RUNS))
    run(":")  # what the later frames alone compile
    whole = min(run(":") for _ in range(_WARM_RUNS))
    stages_ms, good = _told(verb, out)
    starts_s.append(_start_s(folder))
    units_ms.append(yardstick(masks, case.num_frames))
    spread = max(max(taken) / min(taken) - 1 for taken in (starts_s, units_ms))
    unit_ms, start_s = float(np.mean(units_ms)), float(np.mean(starts_s))
    return DriveRun(
        verb=verb,
        case=case,
        cold=cold,
        warm=warm,
        whole=whole,
        stages_ms=stages_ms,
        yardstick_ms=unit_ms,
        good=good,
        start_s=start_s,
        spread=spread,
    )


def _start_s(folder: Path) -> float:
    return _spent([sys.executable, "-c", _START], folder / "no cache").cpu_s


def _fleet(verb: str, jobs: int, num_frames: int, drives: Sequence[Path], folder: Path) -> FleetRun:
    out = folder / f"{verb} fleet {jobs}"
    words = ["--map", str(drives[0] / "map.geojson"), "--masks", _MASKS, "--jobs", str(jobs), "--out", str(out)]
    command = [verb, *map(str, drives), *words, *_OPTIONS[verb]]
    return FleetRun(verb, jobs, num_frames, _run(command, folder / f"{verb} {drives[0].name}" / "cache"))


def _run(words: Sequence[str], cache: Path) -> Spent:
    """What a command line uses; nothing of it is kept outside of the cache folder.

    Raises:
        SemlocError: it failed.
    """
    return _spent([sys.executable, "-m", "semloc_jax.cli.main", *words], cache)


def _spent(command: Sequence[str], cache: Path) -> Spent:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("JAX_")}
    environment |= machine.ONE_THREAD | {"XDG_CACHE_HOME": str(cache)}
    begun_s = time.perf_counter()
    process = subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env=environment,
        text=True,
    )
    said = process.stderr.read()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    process.stderr.close()
    if process.returncode not in (0, _LOST):
        raise SemlocError(f"{' '.join(command[1:])}: exit code {process.returncode}: {said[-300:].strip()}")
    return Spent(used.ru_utime + used.ru_stime, time.perf_counter() - begun_s, used.ru_maxrss * machine.MIB)


def yardstick(masks: Sequence[Path], num_frames: int) -> float:
    """CPU time of one frame's masks decoded and their distances to and from one class taken, by OpenCV [ms]."""
    begun_s = time.process_time()
    for path in masks:
        is_class = (cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) > 0).astype(np.uint8)
        for side in (is_class, 1 - is_class):
            cv2.distanceTransform(side, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return 1e3 * (time.process_time() - begun_s) / num_frames


def _told(verb: str, out: Path) -> tuple[dict[str, float], float]:
    """Median wall time of each stage after the first frames [ms], and the share of good frames, of a run's files."""
    with (out / "frames.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    if verb == "localize":
        times = [json.loads(line)["times"] for line in (out / "results.jsonl").read_text().splitlines()][_FEW:]
        stages = {name: float(np.median([1e3 * one[name] for one in times])) for name in times[0]}
        return stages, float(np.mean([row["localized"] == "1" for row in rows]))
    features = next(metric for metric in read_metrics(out / "metrics.json") if metric.key == "time.features.median")
    stages = {"features": features.value}
    for name in ("predict", "align", "fuse"):
        stages[name] = float(np.median([float(row[f"{name}_ms"]) for row in rows[_FEW:] if row[f"{name}_ms"]]))
    return stages, float(np.mean([row["status"] == "TRACKING" for row in rows]))


def metrics(runs: Sequence[DriveRun]) -> list[Metric]:
    """What the gate compares: costs as multiples of what the machine and the start of a process are worth, and how
    many frames are good."""
    found = []
    for run in runs:
        key, unit_s = f"{run.verb}.{run.case.kind}", 1e-3 * run.yardstick_ms
        costs = {
            "frame.over.yardstick": 1e-3 * run.frame_cpu_ms / unit_s,
            "warm.over.start": run.warm.cpu_s / run.start_s,
            "cold.over.start": run.cold.cpu_s / run.start_s,
        }
        for name, value in costs.items():
            found.append(Metric(f"{key}.{name}", value, "x", "lower", TOLERANCE * value))
        found.append(Metric(f"{key}.peak", run.whole.peak_mib, "MiB", "lower", TOLERANCE * run.whole.peak_mib))
        found.append(Metric(f"{key}.good", run.good, "share", "higher", GOOD_TOLERANCE))
        found.append(Metric(f"{key}.spread", run.spread, "share", "report"))
    return found
