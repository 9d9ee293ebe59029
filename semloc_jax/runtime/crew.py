"""Work spread over processes of this machine, or over a Ray cluster (room: runtime; host).

In: tasks, a function of one. Out: its results, as they come. Nothing but the task decides a result, so that where and
in which order tasks run changes nothing; what a killed worker had in hand is done again.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from importlib.util import find_spec
from itertools import islice
from multiprocessing import get_context
from typing import Any, TypeVar

from semloc_jax.errors import SemlocError

Task, Result = TypeVar("Task"), TypeVar("Result")
_AHEAD = 2
"""So many tasks for each worker are under way or wait: what streams in is held back."""
_MOST_DEATHS = 5
"""Workers may die so often in a row without any result between."""


def spread(
    work: Callable[[Task], Result], tasks: Iterable[tuple[str, Task]], jobs: int, on_ray: bool = False
) -> Iterator[tuple[str, Result]]:
    """Yields the name and the result of each task, in the order in which they end.

    Args:
        work: a function of a module; it and its results are sent between processes.
        tasks: each with a name of its own; taken as workers become free.
        jobs: workers; 1 works in this process.
        on_ray: on the Ray cluster of RAY_ADDRESS, else one on this machine, instead of processes.

    Raises:
        SemlocError: Ray is not installed, or workers die again and again; and what `work` raises.
    """
    if on_ray:
        yield from _on_ray(work, tasks, jobs)
    elif jobs > 1:
        yield from _in_processes(work, tasks, jobs)
    else:
        yield from ((name, work(task)) for name, task in tasks)


def _in_processes(
    work: Callable[[Task], Result], tasks: Iterable[tuple[str, Task]], jobs: int
) -> Iterator[tuple[str, Result]]:
    waiting, held, deaths = iter(tasks), dict[str, Task](), 0
    while True:
        pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"))
        running: dict[Future, str] = {}
        try:
            while True:
                held.update(islice(waiting, max(_AHEAD * jobs - len(held), 0)))
                for name in held.keys() - running.values():
                    running[pool.submit(work, held[name])] = name
                if not running:
                    return
                for done in wait(running, return_when=FIRST_COMPLETED).done:
                    result, name = done.result(), running.pop(done)
                    del held[name]
                    deaths = 0
                    yield name, result
        except BrokenProcessPool as error:
            deaths += 1
            if deaths >= _MOST_DEATHS:
                raise _died(deaths, next(iter(held))) from error
        finally:
            pool.shutdown(cancel_futures=True)


def require_ray() -> None:
    """Nothing where Ray is installed; to be asked before work that may not need it after all.

    Raises:
        SemlocError: it is not.
    """
    if find_spec("ray") is None:
        raise SemlocError("Ray is not installed; pip install 'semloc-jax[ray]', or leave --ray out")


def _on_ray(
    work: Callable[[Task], Result], tasks: Iterable[tuple[str, Task]], jobs: int
) -> Iterator[tuple[str, Result]]:
    require_ray()
    import ray

    is_ours = not ray.is_initialized()
    if is_ours:
        ray.init(num_cpus=jobs if jobs > 1 else None, include_dashboard=False, log_to_driver=False)
    try:
        remote: Any = ray.remote(max_retries=_MOST_DEATHS)(work)
        waiting, names = iter(tasks), dict[Any, str]()
        workers = max(int(ray.cluster_resources().get("CPU", 1)), 1)
        while True:
            for name, task in islice(waiting, max(_AHEAD * workers - len(names), 0)):
                names[remote.remote(task)] = name
            if not names:
                return
            (done,), _ = ray.wait(list(names), num_returns=1)
            name = names.pop(done)
            try:
                result = ray.get(done)
            except ray.exceptions.WorkerCrashedError as error:
                raise _died(_MOST_DEATHS, name) from error
            yield name, result
    finally:
        if is_ours:
            ray.shutdown()


def _died(deaths: int, name: str) -> SemlocError:
    return SemlocError(f"workers died {deaths} times over {name}; is memory short? give fewer --jobs")
