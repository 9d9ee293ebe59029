"""The demo: a small drive is rendered, localized and drawn (room: reports).

In: number of frames, seed, folder. Out: drive, tables and pictures on disk; DemoReport.
"""

import time
from pathlib import Path
from typing import NamedTuple

from semloc_jax.alignment.frame_localizer import LocalizeConfig
from semloc_jax.datasets import Drive
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.localization.frame_by_frame import localize_frames
from semloc_jax.maps import read_map
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.metrics import truth_of, write_metrics_of
from semloc_jax.reports.pictures import write_overlays
from semloc_jax.reports.story import headline, next_commands, spoken, write_map_picture
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
