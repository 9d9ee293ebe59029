"""`semloc learn`: class weights, ramp, tilt and noise learned through the solve from drives with truth (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from semloc_jax.cli.main import OK

if TYPE_CHECKING:
    from semloc_jax.learning import LearningConfig


@dataclass(frozen=True)
class Options:
    """Learn from drives with truth what the localizer assumes: a weight for each class of map elements, the finest ramp
    (where the robust loss lets go), how far the vehicle tilts against the road, and the length of contour that is one
    observation.

    It minimises the negative log-likelihood of the true poses, with derivatives through the solve: accuracy and a right
    covariance together. Drives for validation decide when to stop and how wide the covariance is. Writes learned.yaml,
    which every verb takes as its --config, report.md and report.json with the errors on every drive before and after,
    and config.yaml.

    Judge it by the drives that are held out. Every value of the configuration is an option too, e.g. --num-frames 30.
    """

    drives: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="DRIVE...")]
    """Drives to learn from: folders with maps, masks and truth, all with the same classes in their masks."""
    validation: tuple[Path, ...] = ()
    """Drives that say when to stop, and how wide the covariance is; default: those that are learned from."""
    held_out: tuple[Path, ...] = ()
    """Drives to judge by only."""
    maps: tuple[str, ...] = ()
    """Names of maps of every drive (exact, errors): each drive is taken once with each of them; default: its own."""
    masks: str = "sem_net"
    """Mask folder of every drive: masks like those that will be localized with."""
    config: Path | None = None
    """YAML file with values of the configuration."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""


def default_settings() -> "LearningConfig":
    """The configuration of a fit."""
    from semloc_jax.learning import LearningConfig

    return LearningConfig()


def run(options: Options) -> int:
    """Learn, print the errors of every drive before and after."""
    from semloc_jax.reports.learning import LEARNED, LearningDrives, report_learning

    sets = (options.drives, options.validation, options.held_out)
    report = report_learning(LearningDrives(*sets, options.maps, options.masks), options.settings, options.out)
    print(report.text)
    print(f"use it: semloc localize DRIVE --config {report.folder / LEARNED}")
    return OK
