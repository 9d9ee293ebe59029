"""What a run says to somebody who sees it for the first time (room: reports).

In: results with their truth, the folder of a run. Out: a headline, pictures, the commands that come next; a word now
and then while something takes long.
"""

import shlex
import shutil
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.evaluation import pose_errors
from semloc_jax.maps import SemanticMap

_WORD_EVERY_S = 3.0


def headline(found: Sequence[LocalizationResult], truth: Mapping[str, np.ndarray]) -> str:
    """How many frames were placed within what distance of the truth, and how far off the first guesses were."""
    good = [r for r in found if r.localized and r.frame.id in truth]
    if not good:
        return f"none of {len(found)} frames was localized"
    off_m = [_off_m(r.T_map_base, truth[r.frame.id]) for r in good]
    guess_m = np.median([_off_m(r.T_map_prior, truth[r.frame.id]) for r in good])
    return (
        f"{len(good)} of {len(found)} frames within {_rounded_up_cm(max(off_m))} cm of the truth; "
        f"the satellite fixes they started from were {guess_m:.1f} m off"
    )


def _off_m(T_map_base: np.ndarray, T_true: np.ndarray) -> float:
    errors = pose_errors(T_map_base, T_true)
    return float(np.hypot(errors["lateral_m"], errors["longitudinal_m"]))


def _rounded_up_cm(distance_m: float) -> int:
    return max(int(np.ceil(100.0 * distance_m)), 1)


def write_map_picture(
    folder: Path, semantic_map: SemanticMap, found: Sequence[LocalizationResult], truth: Mapping[str, np.ndarray]
) -> Path:
    """Write map.png: the map from above with the way of the first guesses, of the poses found and of the truth."""
    from semloc_jax.viz import map_view, save

    good = [r for r in found if r.localized]
    estimate, prior = (np.array([getattr(r, key) for r in good]) for key in ("T_map_base", "T_map_prior"))
    known = np.array([truth[r.frame.id] for r in good if r.frame.id in truth])
    path = folder / "map.png"
    save(
        map_view(
            semantic_map.elements, estimate, known, prior, title="the way: prior (satellite fixes), truth, estimate"
        ),
        path,
    )
    return path


def next_commands(drive: Path, semantic_map: Path, masks: str, folder: Path) -> list[tuple[str, str]]:
    """Command and what it does, with paths that work from the folder in which the user stands."""
    semloc, place, road = program(), shlex.quote(str(drive)), shlex.quote(str(semantic_map))
    tracked, explained = (shlex.quote(str(folder / name)) for name in ("tracked", "explained"))
    return [
        (f"{semloc} track {place} --map {road} --masks {masks} --out {tracked}", "follow the whole drive"),
        (f"{semloc} explain {place} --map {road} --masks {masks} --out {explained}", "what holds the pose"),
        (f"{semloc} inspect {road}", "what the map holds"),
    ]


def program() -> str:
    """How the user calls the command line: `semloc` where the shell finds it, else what was called."""
    called = sys.argv[0]
    if shutil.which("semloc"):
        return "semloc"
    return shlex.quote(called) if Path(called).name == "semloc" else f"{sys.executable} -m semloc_jax.cli.main"


@contextmanager
def spoken(what: str, every_s: float = _WORD_EVERY_S) -> Iterator[None]:
    """Say what is being done, and that it still is, until it is."""
    done, started = threading.Event(), time.perf_counter()
    print(f"{what} ...", flush=True)
    # A terminal counts in one line; a log gets a line each time.
    start, end = ("\r", "") if sys.stdout.isatty() else ("", "\n")

    def go_on() -> None:
        while not done.wait(every_s):
            print(f"{start}  ... {time.perf_counter() - started:.0f} s", end=end, flush=True)

    teller = threading.Thread(target=go_on, daemon=True)
    teller.start()
    try:
        yield
    finally:
        done.set()
        teller.join()
        print(f"{start}{' ' * 20}{start}" if start else "", end="", flush=True)
