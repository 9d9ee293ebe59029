"""What workers do in the tests of crews: nothing that takes long to import."""

import os
import signal
from pathlib import Path


def doubled(number: int) -> int:
    """Twice the number."""
    return 2 * number


def dies_once(task: tuple[str, int]) -> int:
    """Twice the number; who first takes the marked task is killed with it in hand."""
    mark, number = task
    if mark and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def always_dies(_: int) -> int:
    """Nothing: who takes it is killed."""
    os.kill(os.getpid(), signal.SIGKILL)
    return 0
