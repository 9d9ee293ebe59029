"""Runs the tasks: one pinned process for each peer, one at a time, peers in turn in every round (room: bench; host).

In: peers and tasks. Out: Measurements. The load of a machine changes within seconds: peers that take turns see the same
machine, so that the ratio of two of them holds where the times of neither do.
"""

import contextlib
import json
import os
import queue
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from semloc_jax.bench import machine
from semloc_jax.bench.peer import entry
from semloc_jax.bench.problem import make_problem, write_problem
from semloc_jax.bench.tasks import ENOUGH_S, Task

Say = Callable[[str], None]


@dataclass
class Measurement:
    """All repeats of one task by one peer."""

    peer: str
    task: Task
    first_call_s: float = float("nan")
    """CPU time of the first call, which compiles."""
    cpu_s: list[float] = field(default_factory=list)
    """CPU time of each repeat, the first call left out; by round, nan where a round was left out."""
    wall_s: list[float] = field(default_factory=list)
    success: float = float("nan")
    evaluations: float = float("nan")
    peak_mib: float = float("nan")
    before_mib: float = float("nan")
    """Resident memory before the first call."""
    failed: str = ""

    @property
    def each_ms(self) -> np.ndarray:
        """CPU time [ms] by round of one start, or of the whole search."""
        return np.asarray(self.cpu_s) * 1e3 / (1 if self.task.kind == "search" else self.task.starts)

    @property
    def median_ms(self) -> float:
        """Median CPU time of one start, or of the whole search [ms]."""
        return float(np.nanmedian(self.each_ms)) if np.isfinite(self.each_ms).any() else float("nan")

    @property
    def spread(self) -> float:
        """Half the distance of the quartiles as a share of the median."""
        times = self.each_ms[np.isfinite(self.each_ms)]
        low, high = np.percentile(times, [25, 75]) if len(times) else (np.nan, np.nan)
        return float(high - low) / 2 / self.median_ms


class PeerProcess:
    """A worker that waits for tasks."""

    def __init__(self, name: str, core: int | None, environment: dict[str, str]) -> None:
        self.name = name
        words = [sys.executable, "-m", "semloc_jax.bench.worker", name, *([] if core is None else [str(core)])]
        self.process = subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment, text=True
        )
        said = self.process.stdout.readline()
        self.missing = json.loads(said).get("missing", "") if said else "its process ended at once"

    def ask(self, problem: Path, task: Task) -> dict:
        """What one repeat of a task took."""
        return self._send({"problem": str(problem), "kind": task.kind, "starts": task.starts})

    def pin(self, core: int | None) -> None:
        """Move the process to a core."""
        self._send({"pin": core})

    def _send(self, request: dict) -> dict:
        try:
            self.process.stdin.write(json.dumps(request) + "\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            return {"failed": "its process has ended"}
        said = self.process.stdout.readline()
        return json.loads(said) if said else {"failed": f"its process ended with code {self.process.wait()}"}

    def close(self) -> None:
        """End the process."""
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()
        self.process.stdout.close()
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.process.kill()


def run(
    names: Sequence[str], todo: Sequence[Task], folder: Path, core: int | None, fresh: bool, say: Say, seed: int = 0
) -> tuple[list[Measurement], dict[str, str]]:
    """Measurements of every task by every peer that can do it, and why the other peers are missing.

    First calls, which compile, run on all cores; then all peers move to one core and take turns there in every round.

    Args:
        names: Peers.
        todo: Tasks.
        folder: Where the problems are written.
        core: Core to measure on; None pins nothing.
        fresh: Whether first calls compile, without a cache of compiled programs.
        say: Gets a line for every first call and every round.
        seed: Of the problem.
    """
    problems = {}
    for points in sorted({task.points for task in todo}):
        problems[points] = folder / f"problem-{seed}-{points}.npz"
        write_problem(make_problem(points, seed), problems[points])
    environment = os.environ | machine.ONE_THREAD | ({"JAX_ENABLE_COMPILATION_CACHE": "false"} if fresh else {})
    started: list[PeerProcess] = []

    def prepare(name: str, core: int | None) -> list[tuple[PeerProcess, Measurement]]:
        process = PeerProcess(name, core, environment)
        started.append(process)
        mine = [] if process.missing else [Measurement(name, task) for task in todo if task.suits(entry(name))]
        for measured in mine:
            _first(process, measured, problems[measured.task.points])
            what = measured.failed or f"{measured.first_call_s:.2f} s, success {measured.success:.2f}"
            say(f"first call   {measured.task.key:<16}{name:<16}{what}")
        return [(process, measured) for measured in mine]

    try:
        prepared = _on_all_cores(prepare, names, core)
        for process in started:
            if not process.missing:
                process.pin(core)
        # Rounds over everything: what is compared later was measured close together.
        pairs = sorted((pair for part in prepared for pair in part), key=lambda pair: todo.index(pair[1].task))
        for number in range(max(task.repeats for task in todo)):
            for process, measured in pairs:
                if number < measured.task.repeats and not measured.failed:
                    _again(process, measured, problems[measured.task.points])
            say(f"round {number + 1} done")
        return [measured for _, measured in pairs], {p.name: p.missing for p in started if p.missing}
    finally:
        for process in started:
            process.close()


def _on_all_cores(prepare: Callable, names: Sequence[str], core: int | None) -> list:
    """prepare(name, core) for all names, as many at a time as there are cores."""
    cores = machine.cores() if core is not None else [None]
    free: queue.Queue = queue.Queue()
    for one in cores:
        free.put(one)

    def on_free_core(name: str) -> list:
        mine = free.get()
        try:
            return prepare(name, mine)
        finally:
            free.put(mine)

    with ThreadPoolExecutor(len(cores)) as pool:
        return list(pool.map(on_free_core, names))


def _first(process: PeerProcess, measured: Measurement, problem: Path) -> None:
    answer = process.ask(problem, measured.task)
    measured.failed = answer.get("failed", "")
    if not measured.failed:
        measured.first_call_s, measured.before_mib = answer["cpu_s"], answer["before_mib"]
        _take(measured, answer)


def _again(process: PeerProcess, measured: Measurement, problem: Path) -> None:
    if measured.task.kind == "check" or sum(measured.wall_s) > ENOUGH_S:
        measured.cpu_s.append(float("nan"))
        return
    answer = process.ask(problem, measured.task)
    measured.failed = answer.get("failed", "")
    if not measured.failed:
        measured.cpu_s.append(answer["cpu_s"])
        measured.wall_s.append(answer["wall_s"])
        _take(measured, answer)


def _take(measured: Measurement, answer: dict) -> None:
    """The numbers that do not change from repeat to repeat, and the memory of the last one."""
    measured.success, measured.evaluations = answer["success"], answer["evaluations"]
    measured.peak_mib = answer["peak_mib"]
