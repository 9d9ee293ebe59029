"""What the reports of all lessons of networks share: the loss as it falls (room: reports; host).

In: losses step by step. Out: loss.csv, loss.png.
"""

import csv
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from semloc_jax.storage import append_line
from semloc_jax.viz.eyes import draw_curve
from semloc_jax.viz.style import save

RANDOM = "random"
"""The name of the random pictures held out, in tables and files."""
_EVERY = 20
"""Steps whose mean loss is one line of the curve."""


class LessonReport(NamedTuple):
    """Where everything was written, and the table for people."""

    folder: Path
    text: str


@contextmanager
def step_bar(what: str, num_steps: int) -> Iterator[Callable[[int, float], None]]:
    """Show the steps of a lesson; arguments and what it yields as `watched_loss`."""
    with tqdm(total=num_steps, unit="step", desc=what, disable=None) as bar:

        def on_step(step: int, loss: float) -> None:
            bar.set_postfix(loss=f"{loss:.3f}", refresh=False)
            bar.update(step - bar.n)

        yield on_step


@contextmanager
def watched_loss(folder: Path, what: str, num_steps: int) -> Iterator[Callable[[int, float], None]]:
    """Show the steps of a lesson and keep their losses, also those of a lesson that is stopped and goes on.

    Args:
        folder: gets loss.csv (step, mean loss of 20 steps) as it goes and loss.png at the end.
        what: the name of the progress bar.
        num_steps: of the whole lesson.

    Yields:
        What is called with the number of a step and its loss.
    """
    path, recent = folder / "loss.csv", []
    with step_bar(what, num_steps) as show:

        def on_step(step: int, loss: float) -> None:
            recent.append(loss)
            show(step, loss)
            if step % _EVERY == 0 or step == num_steps:
                append_line(path, f"{step},{np.mean(recent):.5f}")
                recent.clear()

        yield on_step
    save(draw_curve(*_curve(path)), folder / "loss.png")


def _curve(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Steps and mean losses; of a step that was made twice, after a stop, the last."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    by_step = {int(step): float(loss) for step, loss in csv.reader(lines)}
    steps = sorted(by_step)
    return np.array(steps), np.array([by_step[step] for step in steps])
