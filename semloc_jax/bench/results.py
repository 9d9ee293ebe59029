"""What the measurements say: ratios with their spread, the table, the JSON file, the gate (room: bench; host).

In: Measurements of a run. Out: text, plain data, Metrics for `evaluation.report`.
Times depend on the machine and its load; the gate compares ratios within one run and success rates only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from semloc_jax.bench.peer import OURS, PEERS, entry
from semloc_jax.bench.runner import Measurement
from semloc_jax.evaluation import Metric

BASELINE = Path(__file__).with_name("baseline.json")
TOLERANCE = 0.3
"""A ratio may be lower than its baseline by this share; our choice. Repeats on one machine agree within a few percent;
compilers, JAX versions and processors move the ratios of programs by more."""
SUCCESS_TOLERANCE = 0.03
DOUBT = 0.1
"""A success rate so much below the median of all solvers is not that of the same problem."""


@dataclass(frozen=True)
class Ratio:
    """How many times as much a peer costs as we do."""

    ours: str
    our_task: str
    peer: str
    peer_task: str
    value: float
    low: float
    high: float
    """Least and largest value of all rounds."""

    @property
    def key(self) -> str:
        """Name in the gate."""
        return f"{self.ours}.{self.our_task}.over.{self.peer}.{self.peer_task}"


class Results:
    """All measurements of a run, by peer and task."""

    def __init__(self, measurements: Sequence[Measurement]) -> None:
        self.measurements = [m for m in measurements if not m.failed]
        self.failed = [m for m in measurements if m.failed]
        self._by_key = {(m.peer, m.task.key): m for m in self.measurements}

    def find(self, peer: str, task: str) -> Measurement | None:
        """The measurement of a task by a peer."""
        return self._by_key.get((peer, task))

    @property
    def peers(self) -> list[str]:
        """Peers that measured anything, in the order of the list."""
        there = {m.peer for m in self.measurements}
        return [known.name for known in PEERS if known.name in there]

    def ratio(self, ours: str, our_task: str, peer: str, peer_task: str) -> Ratio | None:
        """Cost of a peer over our cost, by rounds; a search is compared with one solve of the peer."""
        a, b = self.find(ours, our_task), self.find(peer, peer_task)
        if a is None or b is None:
            return None
        num = min(len(a.each_ms), len(b.each_ms))
        rounds = b.each_ms[:num] / a.each_ms[:num]
        rounds = rounds[np.isfinite(rounds)]
        if not len(rounds):
            return None
        return Ratio(ours, our_task, peer, peer_task, float(np.median(rounds)), rounds.min(), rounds.max())

    def batch(self, peer: str) -> Measurement | None:
        """Solves of many starts at once: 1024 for ours, 64 for a peer."""
        keys = ("many-1024", "many-64") if peer in OURS else ("many-64",)
        return next((m for key in keys if (m := self.find(peer, key))), None)

    def checked(self, peer: str) -> Measurement | None:
        """What the success rate of a peer is read from: the most starts that all peers have solved."""
        return self.find(peer, "check-256") or self.batch(peer)

    def doubts(self) -> list[str]:
        """Peers that succeed clearly less often than the others: whatever they cost, they solve something else."""
        rates = {peer: m.success for peer in self.peers if (m := self.checked(peer))}
        usual = float(np.median(list(rates.values()))) if rates else 0.0
        return [
            f"{entry(peer).text}: success {rate:.2f} where {usual:.2f} is usual; its cost does not compare"
            for peer, rate in rates.items()
            if rate < usual - DOUBT
        ]

    def evaluation_us(self) -> dict[str, float]:
        """CPU time of a solve over its evaluations [us], by peer: an evaluation with all that is around it."""
        times = {}
        for peer in self.peers:
            best = self.batch(peer)
            if best is not None and np.isfinite(best.median_ms):
                times[entry(peer).text] = 1e3 * best.median_ms / best.evaluations
        return times

    def ratios(self) -> list[Ratio]:
        """Every peer against each of our paths: one start, 64 together, tracking, and our 1024 against its best."""
        pairs = [("one-16", "one-16"), ("many-64", "many-64"), ("many-1024", "many-64"), ("tracking-16", "tracking-16")]
        found = [
            self.ratio(ours, our_task, peer, peer_task)
            for ours in OURS
            for peer in self.peers
            if peer not in OURS
            for our_task, peer_task in pairs
        ]
        found += [self.ratio(ours, "search-1024", "optimistix", "many-64") for ours in OURS]
        return [ratio for ratio in found if ratio is not None]


GATED = (
    ("optimistix", "many-64"),
    ("scipy-jacobian", "many-64"),
    ("scipy-jacobian", "one-16"),
    ("scipy-jacobian", "tracking-16"),
)
"""Ratios to these are gated: both libraries are wherever the package is."""


def metrics(results: Results) -> list[Metric]:
    """Ratios and success rates of a run as metrics; those to peers that may be missing take no part in the gate."""
    found = []
    for ratio in results.ratios():
        gated = (ratio.peer, ratio.peer_task) in GATED
        direction, tolerance = ("higher", TOLERANCE * ratio.value) if gated else ("report", 0.0)
        found.append(Metric(ratio.key, round(ratio.value, 6), "x", direction, round(tolerance, 6)))
    for ours in OURS:
        for task in ("many-1024", "tracking-16", "search-1024"):
            measured = results.find(ours, task)
            if measured is not None:
                found.append(Metric(f"{ours}.{task}.success", measured.success, "share", "higher", SUCCESS_TOLERANCE))
    return found


def comparable(baseline: Sequence[Metric], asked: Sequence[str], missing: Sequence[str]) -> list[Metric]:
    """The baseline of what this run was to measure; what it failed to measure stays, and fails.

    Args:
        baseline: Metrics of the baseline.
        asked: Names `peer.task` of all that the run was asked for.
        missing: Peers that are not here.
    """

    def is_asked(key: str) -> bool:
        parts = key.removesuffix(".success").split(".over.")
        return all(part in asked and part.split(".")[0] not in missing for part in parts)

    return [metric for metric in baseline if is_asked(metric.key)]


def table(results: Results) -> str:
    """One line for each peer: milliseconds of CPU a solve by number of starts, spread, accuracy, memory."""
    columns = ["one-16", "many-64", "many-1024", "many-4096", "tracking-16"]
    columns = [key for key in columns if any(results.find(peer, key) for peer in results.peers)]
    titles = {"one-16": "N=1", "tracking-16": "tracking"}
    width = 2 + max(len(entry(peer).text) for peer in results.peers)
    head = "".join(f"{titles.get(key, key.replace('many-', 'N=')):>14}" for key in columns)
    lines = [f"{'CPU ms a solve':<{width}}{head}{'success':>9}{'evals':>7}{'first s':>9}{'MiB':>7}"]
    for peer in results.peers:
        shown, batch = results.checked(peer), results.batch(peer)
        cells = "".join(f"{_cell(results.find(peer, key)):>14}" for key in columns)
        tail = f"{shown.success:>9.2f}{shown.evaluations:>7.1f}" if shown else " " * 16
        tail += f"{batch.first_call_s:>9.2f}{batch.peak_mib:>7.0f}" if batch else ""
        lines.append(f"{entry(peer).text:<{width}}{cells}{tail}")
    for m in results.measurements:
        if m.task.kind == "search":
            text = f"search of {m.task.starts} starts, {entry(m.peer).text}"
            lines.append(f"{text:<{width + 20}}{m.median_ms:8.2f} ms ±{100 * m.spread:.0f} %  success {m.success:.0f}")
    return "\n".join(lines)


def ratio_table(results: Results) -> str:
    """How many times as much a solve of each peer costs as one of ours, with the range over rounds."""
    ours = [name for name in OURS if name in results.peers]
    width = 2 + max(len(entry(peer).text) for peer in results.peers)
    lines = [f"{'times our cost: N = 64 over our 1024':<{width}}" + "".join(f"{name:>24}" for name in ours)]
    for peer in results.peers:
        cells = [results.ratio(name, "many-1024", peer, "many-64") for name in ours if peer not in OURS]
        if any(cells):
            texts = [f"{r.value:.1f} ({r.low:.1f} - {r.high:.1f})" if r else "-" for r in cells]
            lines.append(f"{entry(peer).text:<{width}}" + "".join(f"{text:>24}" for text in texts))
    return "\n".join(lines)


def _cell(measured: Measurement | None) -> str:
    if measured is None or not np.isfinite(measured.median_ms):
        return "-"
    return f"{measured.median_ms:.3f} ±{100 * measured.spread:.0f} %"


def as_data(results: Results) -> dict[str, list]:
    """Measurements and ratios as plain data for a JSON file."""
    rows = [
        {
            "peer": m.peer,
            "text": entry(m.peer).text,
            "task": m.task.key,
            "kind": m.task.kind,
            "starts": m.task.starts,
            "points": m.task.points,
            "median_ms": _number(m.median_ms),
            "spread": _number(m.spread),
            "rounds_ms": [_number(value) for value in m.each_ms],
            "starts_per_second": _number(1e3 / m.median_ms * (m.task.starts if m.task.kind == "search" else 1)),
            "first_call_s": _number(m.first_call_s),
            "success": _number(m.success),
            "evaluations": _number(m.evaluations),
            "peak_mib": _number(m.peak_mib),
            "before_mib": _number(m.before_mib),
        }
        for m in results.measurements
    ]
    ratios = [
        {"key": r.key, "value": _number(r.value), "low": _number(r.low), "high": _number(r.high)}
        for r in results.ratios()
    ]
    failed = [{"peer": m.peer, "task": m.task.key, "failed": m.failed} for m in results.failed]
    return {"rows": rows, "ratios": ratios, "failed": failed}


def _number(value: float) -> float | None:
    return round(float(value), 6) if np.isfinite(value) else None
