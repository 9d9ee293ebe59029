"""`semloc explain`: which map elements hold the pose, and how far it moves where one of them is wrong (room: cli)."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from semloc_jax.cli.drive_options import DriveOptions
from semloc_jax.cli.main import LOST, OK
from semloc_jax.errors import UsageError
from semloc_jax.inputs.drive_inputs import open_inputs

if TYPE_CHECKING:
    from semloc_jax.alignment.frame_localizer import LocalizeConfig


@dataclass(frozen=True)
class Options(DriveOptions):
    """Which map elements hold the pose of a frame, and how far it moves where one of them is wrong.

    Writes explain.csv and explain.json (every element in view, every class, the prior), explain.png (the elements in
    the image, coloured and named by their share), explain_map.png (from above, with arrows to where the vehicle goes)
    and config.yaml. Exit code 3 where the frame cannot be localized.
    With --every K it explains every K-th frame instead and writes drive.csv: which elements hold the drive, and which
    of them are irreplaceable.
    """

    frame: int = 0
    """Index of the frame."""
    shift_cm: float = 10.0
    """How far each element is taken to be wrong."""
    check: int = 0
    """Localize again with each of so many of the strongest elements moved, and left out, and print what happened."""
    top: int = 12
    """Number of elements that are printed."""
    posterior: bool = False
    """Print all modes of the pose and the 95 % intervals of their mixture; residual correlation taken into account."""
    scatter: int = 0
    """Solve the frame with so many draws of a network's noise on its exact masks, and print how far the pose scatters;
    the drive needs truth."""
    every: int | None = None
    """Explain every K-th frame of the drive instead of one."""
    config: Path | None = None
    """YAML file with values of the configuration."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""


def default_settings() -> "LocalizeConfig":
    """The configuration of `semloc localize`."""
    from semloc_jax.alignment.frame_localizer import LocalizeConfig

    return LocalizeConfig()


def run(options: Options) -> int:
    """Explain one frame, or many."""
    from semloc_jax.reports.explain import Extras, report_explained_drive, report_explanation

    every = 1 if options.every is None else options.every
    if not 0 < options.shift_cm <= 100 or min(options.check, options.scatter) < 0 or min(options.top, every) < 1:
        raise UsageError("--shift-cm: expected 0 to 100; --check, --scatter: 0 or more; --top, --every: 1 or more")
    search = dataclasses.replace(options.settings.search, seed=options.seed)
    settings = dataclasses.replace(options.settings, search=search)
    inputs, shift_m = open_inputs(options), options.shift_cm / 100.0
    rest = (options.top, options.out, options.kept(inputs))
    if options.every is None:
        report = report_explanation(
            inputs,
            options.frame,
            settings,
            shift_m,
            Extras(options.check, options.posterior, options.scatter),
            *rest,
        )
    else:
        report = report_explained_drive(inputs, options.every, settings, shift_m, *rest)
    print(report.text)
    if report.folder is not None:
        print(f"results: {report.folder}")
    return OK if report.explanations else LOST
