"""The process of one peer, pinned to one core: does one task when it is told to, and tells what it took (room: bench).

usage: python -m semloc_jax.bench.worker PEER CORE
In: one JSON object in each line of the standard input. Out: one JSON object for each.
"""

import json
import os
import sys
import time

from semloc_jax.bench import machine


def main(name: str, core: int | None) -> None:
    """Answer until the input ends."""
    machine.pin(core)
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print must not be taken for an answer
    from semloc_jax.bench.peer import PeerMissing, create

    try:
        peer = create(name)
    except PeerMissing as missing:
        print(json.dumps({"missing": str(missing)}), file=answers, flush=True)
        return
    print(json.dumps({"ready": name}), file=answers, flush=True)
    worker = Worker(peer)
    for line in sys.stdin:
        try:
            answer = worker.answer(json.loads(line))
        except Exception as error:  # a peer that cannot do one task may do the next
            answer = {"failed": f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"}
        print(json.dumps(answer), file=answers, flush=True)
    if hasattr(peer, "close"):
        peer.close()


class Worker:
    """A peer with the problem that it has loaded."""

    def __init__(self, peer) -> None:
        self.peer, self.path, self.problem = peer, None, None

    def answer(self, request: dict) -> dict:
        """CPU and wall time [s], evaluations of a start, share of successes, memory [MiB]."""
        from pathlib import Path

        from semloc_jax.bench.problem import read_problem

        if "pin" in request:
            machine.pin(request["pin"])
            if hasattr(self.peer, "process") and self.peer.process is not None:
                machine.pin(request["pin"], self.peer.process.pid)
            return {}
        if request["problem"] != self.path:
            self.path, self.problem = request["problem"], read_problem(Path(request["problem"]))
            self.peer.load(self.problem)
        process = getattr(self.peer, "process", None)
        pid = "self" if process is None else process.pid
        calls = self._calls(request["kind"], request["starts"])
        machine.forget_peak(pid)
        before_mib, _ = machine.memory_mib(pid)
        cpu_s, wall_s = time.process_time(), time.perf_counter()
        solved = [call() for call in calls]
        cpu_s, wall_s = time.process_time() - cpu_s, time.perf_counter() - wall_s
        if solved[0].cpu_s is not None:
            cpu_s = sum(one.cpu_s for one in solved)
        if getattr(self.peer, "on_accelerator", False):
            cpu_s = wall_s  # the processor only waits
        success = [float(ok) for one in solved for ok in self.problem.succeeded(one.Ts_map_base)]
        return {
            "cpu_s": cpu_s,
            "wall_s": wall_s,
            "evaluations": sum(one.evaluations for one in solved) / len(solved),
            "success": sum(success) / len(success),
            "before_mib": before_mib,
            "peak_mib": machine.memory_mib(pid)[1],
        }

    def _calls(self, kind: str, num: int) -> list:
        """The calls of a task, with their starts ready."""
        from semloc_jax.bench.problem import FULL_LEVELS, TRACKING_LEVELS

        tracking = kind == "tracking"
        levels = TRACKING_LEVELS if tracking else FULL_LEVELS
        Ts = self.problem.starts(num, tracking)
        if kind == "search":
            return [lambda: self.peer.search(Ts)]
        size = {"one": 1, "tracking": 1, "check": 64}.get(kind, num)
        parts = [Ts[k : k + size] for k in range(0, num, size)]
        return [lambda part=part: self.peer.solve(part, levels) for part in parts]


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else None)
