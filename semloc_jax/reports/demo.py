"""The demo: a small drive is rendered, localized and drawn, and said in words (room: reports).

In: number of frames, seed, folder. Out: drive, tables and pictures on disk; DemoReport with a headline, the commands
that come next; a word now and then while something takes long.
"""

import shlex
import shutil
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from semloc_jax.alignment.frame_localizer import LocalizeConfig
from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.datasets import Drive
from semloc_jax.evaluation import pose_errors
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.localization.frame_by_frame import localize_frames
from semloc_jax.maps import SemanticMap, read_map
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.metrics import truth_of, write_metrics_of
from semloc_jax.reports.pictures import write_overlays
from semloc_jax.reports.tables import write_tables
from semloc_jax.simulation import SimulationConfig, simulate

MASKS = "sem_net"
_WIDTH_PX, _HEIGHT_PX, _RATE_HZ = 640, 400, 5.0
_LOCALIZED = slice(None, None, 5)
"""Frames that are localized. The others are for `semloc track`, which needs about a second of a drive to be sure."""


class DemoReport(NamedTuple):
    """What the demo says.

    Attributes:
        text: headline, pictures and the next commands.
        pictures: absolute paths, the one to open first comes first.
        num_localized: frames that were localized.
    """

    text: str
    pictures: list[Path]
    num_localized: int


def report_demo(num_frames: int, seed: int, out: Path | None) -> DemoReport:
    """Render, localize and draw a road drive, with a word every few seconds.

    Args:
        num_frames: Frames of the drive.
        seed: Of the drive.
        out: Folder for the drive and the results; None for results/TIME.
    """
    started = time.perf_counter()
    folder = make_folder(out)
    size = SimulationConfig(num_frames=num_frames, rate_hz=_RATE_HZ, width_px=_WIDTH_PX, height_px=_HEIGHT_PX)
    with spoken(f"1/3 rendering a road drive of {num_frames} frames with map, masks and satellite fixes"):
        drive = simulate("road", seed, folder / "drive", size)
    said, pictures, num_localized = _localized(drive, folder, seed)
    lines = ["", said, "", *(f"  {path}  {what}" for path, what in pictures), "", "next:"]
    commands = next_commands(drive.path, drive.map_path, MASKS, folder)
    lines += [f"  {command}  # {what}" for command, what in commands]
    lines += ["", f"{time.perf_counter() - started:.0f} s in all; metrics, poses and configuration: {folder}"]
    return DemoReport("\n".join(lines), [path for path, _ in pictures], num_localized)


def _localized(drive: Drive, folder: Path, seed: int) -> tuple[str, list[tuple[Path, str]], int]:
    """Headline, pictures with what they show, number of localized frames."""
    semantic_map, source, config = read_map(drive.map_path), mask_source(MASKS, drive), LocalizeConfig()
    with spoken("2/3 localizing every fifth frame; the first one compiles, once for this machine"):
        found = localize_frames(drive, semantic_map, source, frames=_LOCALIZED, config=config)
    truth = truth_of(drive, found)
    with spoken("3/3 drawing"):
        write_tables(found, truth, folder)
        write_record(folder, config, {"masks": MASKS, "seed": seed})
        write_metrics_of(found, truth, folder)
        overlays = write_overlays(folder, semantic_map, source, found, 1)
        drawn = [(path, "the map on an image: first guess, pose found") for path in overlays]
        drawn.append((write_map_picture(folder, semantic_map, found, truth), "the way on the map from above"))
        drawn.append((folder / "errors.png", "errors over time, with the first guesses"))
    pictures = [(path.resolve(), what) for path, what in drawn if path.is_file()]
    return headline(found, truth), pictures, sum(result.localized for result in found)


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
