"""`semloc learn obstacles`: a network for what stands on parking lots, taught on random views (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from semloc_jax.cli.main import OK, log_to_console

if TYPE_CHECKING:
    from semloc_jax.learning.obstacle_lesson import ObstacleLearningConfig


@dataclass(frozen=True)
class Options:
    """Teach a network to find cones, pillars, ground locks and no-parking signs on an upright cylinder, on views that
    are drawn at random: their looks, light, road, shadows, mirrors, lenses, what hides them and what looks like them.

    Drives judge it, none teaches: they need images and exact masks that show obstacles; inst/CAMERA/ID.png tells things
    of one class apart, else what hangs together is one. Writes obstacles.weights (with its card and threshold),
    obstacles.onnx, metrics.json (average precision at an overlap of 0.5), scores.csv (by class and range), loss.csv, a
    picture of each set (white: truth) and config.yaml. A lesson that stopped goes on where --out names its folder.

    Every value of the configuration is an option too, e.g. --num-pictures 3000 or --training.num-steps 5000.
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


def default_settings() -> "ObstacleLearningConfig":
    """The configuration of the lesson."""
    from semloc_jax.learning.obstacle_lesson import ObstacleLearningConfig

    return ObstacleLearningConfig()


def run(options: Options) -> int:
    """Teach, print how well they are found."""
    from semloc_jax.inputs.choices import parse_slice
    from semloc_jax.reports.obstacle_learning import report_obstacle_learning

    log_to_console()
    frames = parse_slice(options.frames)
    print(report_obstacle_learning(options.settings, options.held_out, frames, options.begin_with, options.out).text)
    return OK
