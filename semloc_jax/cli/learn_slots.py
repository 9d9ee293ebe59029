"""`semloc learn slots`: a network for the marking points of parking slots, taught on random top views (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from semloc_jax.cli.main import OK, log_to_console

if TYPE_CHECKING:
    from semloc_jax.learning.marking_lesson import SlotLearningConfig


@dataclass(frozen=True)
class Options:
    """Teach a network where the dividers of parking slots have their mouths, on top views that are drawn at random:
    slots as several countries paint them, light, wear, asphalt, shadows, cars, seams, mounts that are off.

    Drives judge it, none teaches: they need images, exact masks, a map with slots and true poses. Writes slots.weights
    (with its card and threshold), slots.onnx, metrics.json (recall and precision at the threshold), scores.csv (at
    every threshold), loss.csv, a picture of each set (rings: truth, arrows: found) and config.yaml. A lesson that
    stopped goes on where --out names its folder.

    Every value of the configuration is an option too, e.g. --num-pictures 16000 or --training.num-steps 20000.
    """

    held_out: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="DRIVE...")] = ()
    """Drives to judge by."""
    frames: str = "::4"
    """Frames of these, as a Python slice."""
    begin_with: Path | None = None
    """Weights of an earlier lesson to go on from; give another --training.seed, so that other views are drawn."""
    config: Path | None = None
    """YAML file with values of the configuration."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""


def default_settings() -> "SlotLearningConfig":
    """The configuration of the lesson."""
    from semloc_jax.learning.marking_lesson import SlotLearningConfig

    return SlotLearningConfig()


def run(options: Options) -> int:
    """Teach, print how many points are found."""
    from semloc_jax.inputs.choices import parse_slice
    from semloc_jax.reports.marking_points import report_marking_points

    log_to_console()
    frames = parse_slice(options.frames)
    print(report_marking_points(options.settings, options.held_out, frames, options.begin_with, options.out).text)
    return OK
