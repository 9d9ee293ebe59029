"""Options of every verb that works on a drive (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from semloc_jax.inputs.drive_inputs import InputOptions


@dataclass(frozen=True)
class DriveOptions(InputOptions):
    """Options of every verb that works on a drive."""

    drive: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DRIVE")]
    """The drive: a folder or a bag (.bag, .db3, .mcap), its type is guessed."""
