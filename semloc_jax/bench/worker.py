"""The process of one peer, pinned to one core: runs one task at a time and reports its cost (room: bench).

usage: python -m semloc_jax.bench.worker PEER CORE
In: one JSON object in each line of the standard input. Out: one JSON object for each.
"""

import json
import os
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from semloc_jax.bench import machine

if TYPE_CHECKING:
    from semloc_jax.bench.peer import Peer
    from semloc_jax.bench.problem import Problem


def main(name: str, core: int | None) -> None:
    """Answer until the input ends."""
    machine.pin(core)
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print must not be taken for an answer
    from semloc_jax.bench.peer import PeerMissing, create

    worker = Worker(lambda: create(name))
    try:
        create(name)
    except PeerMissing as missing:
        print(json.dumps({"missing": str(missing)}), file=answers, flush=True)
        return
    print(json.dumps({"ready": name}), file=answers, flush=True)
    for line in sys.stdin:
        try:
            answer = worker.answer(json.loads(line))
        except Exception as error:  # a peer that cannot do one task may do the next
            answer = {"failed": f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"}
        print(json.dumps(answer), file=answers, flush=True)
    worker.close()


class Worker:
    """The peer, one for each problem, so that it compiles once for each problem."""

    def __init__(self, make: "Callable[[], Peer]") -> None:
        self.make = make
        self.loaded: dict = {}
        """Problem and peer by path."""

    def answer(self, request: dict) -> dict:
        """CPU and wall time [s], evaluations of a start, share of successes, memory [MiB]."""
        if "pin" in request:
            self._pin(request["pin"])
            return {}
        problem, peer = self._of(request["problem"])
        process = getattr(peer, "process", None)
        pid = "self" if process is None else process.pid
        calls, share = _calls(problem, peer, request["kind"], request["starts"])
        machine.forget_peak(pid)
        before_mib, _ = machine.memory_mib(pid)
        cpu_s, wall_s = time.process_time(), time.perf_counter()
        solved = [call() for call in calls]
        cpu_s, wall_s = time.process_time() - cpu_s, time.perf_counter() - wall_s
        if solved[0].cpu_s is not None:
            cpu_s = sum(one.cpu_s for one in solved)
        if getattr(peer, "on_accelerator", False):
            cpu_s = wall_s  # the processor only waits
        success = [float(ok) for one in solved for ok in problem.succeeded(one.Ts_map_base)]
        return {
            "cpu_s": cpu_s * share,
            "wall_s": wall_s * share,
            "evaluations": sum(one.evaluations for one in solved) / len(solved),
            "success": sum(success) / len(success),
            "before_mib": before_mib,
            "peak_mib": machine.memory_mib(pid)[1],
        }

    def close(self) -> None:
        """End what the peers have started."""
        for _, peer in self.loaded.values():
            if hasattr(peer, "close"):
                peer.close()

    def _of(self, path: str) -> "tuple[Problem, Peer]":
        if path not in self.loaded:
            from pathlib import Path

            from semloc_jax.bench.problem import read_problem

            problem, peer = read_problem(Path(path)), self.make()
            peer.load(problem)
            self.loaded[path] = problem, peer
        return self.loaded[path]

    def _pin(self, core: int | None) -> None:
        machine.pin(core)
        for _, peer in self.loaded.values():
            if getattr(peer, "process", None) is not None:
                machine.pin(core, peer.process.pid)


def _calls(problem: "Problem", peer: "Peer", kind: str, num: int) -> tuple[list, float]:
    """The calls of a task with their starts ready, and the share of their time that is the task's.

    A call of few starts is too short to be timed alone: so many are made that 64 starts are solved.
    """
    from semloc_jax.bench.problem import FULL_LEVELS, TRACKING_LEVELS

    tracking = kind == "tracking"
    levels = TRACKING_LEVELS if tracking else FULL_LEVELS
    total = max(num, 64) if kind == "many" else num
    Ts = problem.starts(total, tracking)
    if kind == "search":
        return [lambda: peer.search(Ts)], 1.0
    size = {"one": 1, "tracking": 1, "check": 64}.get(kind, num)
    parts = [Ts[k : k + size] for k in range(0, total, size)]
    return [lambda part=part: peer.solve(part, levels) for part in parts], num / total


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else None)
