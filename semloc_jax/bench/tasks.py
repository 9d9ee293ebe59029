"""What is measured: tasks by kind, number of starts and number of points (room: bench; host).

In: the extent of a run. Out: Tasks, and the measurements that come back for them.
"""

from dataclasses import dataclass
from typing import Literal

from semloc_jax.bench.peer import OURS, PEERS, Entry

Kind = Literal["one", "many", "tracking", "search", "check"]
HYPOTHESES = (1, 4, 16, 64, 256, 1024, 4096, 16384, 65536)
POINTS = (128, 512, 2048, 8192, 32768)
NUM_POINTS = 1000
OVER_STARTS = ("semloc-analytic", "semloc-xla", "ceres-tiny", "ceres-autodiff")
OVER_POINTS = (*OVER_STARTS, "optimistix")
"""Peers with curves; the others would compile for minutes."""
ENOUGH_S = 15.0
"""A task is not repeated once it has taken so much time in all."""


@dataclass(frozen=True)
class Task:
    """One task for a peer."""

    kind: Kind
    """one: full solves, a start in each call. many: full solves, all starts in one call. tracking: solves from near on
    the fine levels, a start in each call. search: one search that culls. check: many, for the success rate only."""
    starts: int
    points: int = NUM_POINTS
    repeats: int = 1
    only: tuple[str, ...] = ()
    """Peers that do it; none: all that can. A brief run spares what compiles and is not compared."""

    @property
    def key(self) -> str:
        """Name of the task in results."""
        return f"{self.kind}-{self.starts}" + (f"-{self.points}" if self.points != NUM_POINTS else "")

    def suits(self, entry: Entry) -> bool:
        """Whether a peer can and need do it."""
        if self.only and entry.name not in self.only:
            return False
        if self.kind == "search":
            return entry.searches
        return self.kind == "check" or self.starts <= entry.largest


def tasks(quick: bool, curves: bool, repeats: int) -> list[Task]:
    """The tasks of a run: a minute's worth, or all; those of the first are among those of the second."""
    if quick:
        others = tuple(entry.name for entry in PEERS if entry.name not in OURS)
        return [
            Task("many", 64, repeats=repeats, only=others),
            Task("many", 1024, repeats=repeats, only=OURS),
            Task("search", 1024, repeats=repeats, only=OURS[:1]),
        ]
    main = [
        Task("one", 16, repeats=repeats),
        Task("many", 64, repeats=repeats),
        Task("many", 1024, repeats=repeats),
        Task("search", 1024, repeats=repeats),
        Task("many", 4096, repeats=repeats),
        Task("tracking", 16, repeats=repeats),
        Task("search", 4096, repeats=repeats),
        Task("check", 256),
    ]
    if not curves:
        return main
    known = {task.starts for task in main if task.kind == "many"}
    main += [Task("many", num, repeats=3, only=OVER_STARTS) for num in HYPOTHESES if num not in known]
    return main + [Task("many", 64, points, 3, only=OVER_POINTS) for points in POINTS]
