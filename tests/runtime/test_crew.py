"""Work over processes: every result comes once, what a killed worker had in hand is done again, nothing runs ahead."""

import os
import time

import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.runtime.crew import spread
from tests.runtime.crew_work import always_dies, dies_once, doubled

pytestmark = pytest.mark.skipif(os.name != "posix", reason="kills its workers")


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_task_has_its_result(jobs):
    tasks = [(f"t{k}", k) for k in range(7)]
    assert dict(spread(doubled, tasks, jobs)) == {f"t{k}": 2 * k for k in range(7)}


def test_what_a_killed_worker_had_in_hand_is_done_again(tmp_path):
    tasks = [(f"t{k}", (str(tmp_path / "mark") if k == 2 else "", k)) for k in range(7)]
    found = list(spread(dies_once, tasks, 2))
    assert sorted(found) == [(f"t{k}", 2 * k) for k in range(7)]
    assert (tmp_path / "mark").exists()


def test_workers_that_always_die_are_an_error_in_one_line():
    with pytest.raises(SemlocError, match="give fewer --jobs"):
        list(spread(always_dies, [("t0", 0)], 2))


def test_tasks_are_taken_as_workers_become_free():
    """A country does not fit into memory: what streams in is held back."""
    taken = []

    def tasks():
        for k in range(40):
            taken.append(k)
            yield f"t{k}", k

    results = spread(doubled, tasks(), 2)
    next(results)
    time.sleep(0.2)
    assert len(taken) <= 6
    assert len(list(results)) == 39


def test_ray_that_is_not_there_is_said():
    try:
        import ray  # noqa: F401
    except ImportError:
        with pytest.raises(SemlocError, match=r"semloc-jax\[ray\]"):
            list(spread(doubled, [("t", 1)], 2, on_ray=True))
    else:
        assert dict(spread(doubled, [("t", 1)], 2, on_ray=True)) == {"t": 2}
