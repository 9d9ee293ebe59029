"""One process for each input, forked from one that has everything imported, with bounds on time and memory."""

import faulthandler
import os
import resource
import signal
import sys
import traceback
from collections.abc import Callable
from typing import NamedTuple

MOST_S = 10
MOST_BYTES = 1 << 30


class Outcome(NamedTuple):
    """What became of one input: `read`, `refused`, `traceback`, `crash`, `hang` or `memory`; and what was said."""

    kind: str
    said: str


def run(work: Callable[[], object], refusals: tuple[type[BaseException], ...]) -> Outcome:
    """Call a function in a process of its own.

    A refusal is an exception of the given types whose text is one line. Time is that of the processor, and of the clock
    ten times as much: other processes may want the machine too.
    """
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        faulthandler.disable()
        os.close(reading)
        code, said = 1, ""
        try:
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
            resource.setrlimit(resource.RLIMIT_CPU, (MOST_S, MOST_S + 1))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            signal.alarm(10 * MOST_S)
            quiet = os.open(os.devnull, os.O_WRONLY)
            os.dup2(quiet, 1)
            os.dup2(quiet, 2)
            code, said = _called(work, refusals)
            if resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 - before > MOST_BYTES:
                code = 5
            os.write(writing, said.encode("utf-8", "replace")[:60_000])
        finally:
            os._exit(code)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        said = pipe.read().decode("utf-8", "replace")
    _, status = os.waitpid(pid, 0)
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        return Outcome("hang" if number in (signal.SIGXCPU, signal.SIGALRM, signal.SIGKILL) else "crash", str(number))
    return Outcome({0: "read", 3: "refused", 5: "memory"}.get(os.WEXITSTATUS(status), "traceback"), said)


def _called(work: Callable[[], object], refusals: tuple[type[BaseException], ...]) -> tuple[int, str]:
    try:
        work()
    except refusals as error:
        said = str(error)
        return (3, said) if said and "\n" not in said else (1, f"not one line: {said!r}")
    except BaseException:
        return 1, "".join(traceback.format_exception(*sys.exc_info(), limit=-6))
    return 0, ""
