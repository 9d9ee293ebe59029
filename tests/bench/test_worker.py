"""What is asked of a peer: made and loaded once for each problem, short tasks over enough starts to be timed."""

import numpy as np
import pytest

from semloc_jax.bench.peer import Solved
from semloc_jax.bench.problem import FULL_LEVELS, TRACKING_LEVELS, make_problem, write_problem
from semloc_jax.bench.worker import Worker


class Oracle:
    """Answers with the truth, and claims a second of CPU time for every start."""

    def __init__(self):
        self.calls = []

    def load(self, problem):
        self.problem = problem

    def solve(self, Ts_init, levels):
        self.calls.append((len(Ts_init), levels))
        return Solved(np.broadcast_to(self.problem.T_true, Ts_init.shape), 7.0, float(len(Ts_init)))


@pytest.fixture
def paths(tmp_path):
    for seed in (0, 1):
        write_problem(make_problem(64, seed), tmp_path / f"{seed}.npz")
    return [str(tmp_path / f"{seed}.npz") for seed in (0, 1)]


def test_a_peer_is_made_once_for_each_problem(paths):
    made = []
    worker = Worker(lambda: made.append(Oracle()) or made[-1])
    for path in (paths[0], paths[1], paths[0], paths[1]):
        worker.answer({"problem": path, "kind": "many", "starts": 64})
    # One that compiles would else compile again whenever the problems take turns.
    assert len(made) == 2
    assert [len(peer.calls) for peer in made] == [2, 2]


@pytest.mark.parametrize(
    ("kind", "starts", "sizes", "levels", "cpu_s"),
    [
        ("one", 5, [1] * 5, FULL_LEVELS, 5.0),
        ("tracking", 3, [1] * 3, TRACKING_LEVELS, 3.0),
        ("many", 4, [4] * 16, FULL_LEVELS, 4.0),
        ("many", 100, [100], FULL_LEVELS, 100.0),
        ("check", 100, [64, 36], FULL_LEVELS, 100.0),
    ],
)
def test_tasks_are_cut_into_calls(paths, kind, starts, sizes, levels, cpu_s):
    peer = Oracle()
    answer = Worker(lambda: peer).answer({"problem": paths[0], "kind": kind, "starts": starts})
    assert peer.calls == [(size, levels) for size in sizes]
    assert answer["cpu_s"] == pytest.approx(cpu_s), "the time is that of the starts that were asked for"
    assert answer["success"] == 1.0 and answer["evaluations"] == 7.0
    assert answer["peak_mib"] >= answer["before_mib"] > 10
