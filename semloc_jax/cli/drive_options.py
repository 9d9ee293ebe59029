"""Options of every verb that works on a drive (room: cli)."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from semloc_jax.inputs.drive_inputs import InputOptions, Inputs

NOT_KEPT = ("drive", "config", "out", "resume", "rrd", "settings", "others", "jobs", "ray")
"""Options that say where things are, and the configuration, which is kept beside the options."""


@dataclass(frozen=True)
class DriveOptions(InputOptions):
    """Options of every verb that works on a drive."""

    drive: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DRIVE")]
    """The drive: a folder or a bag (.bag, .db3, .mcap), its type is guessed."""

    def kept(self, inputs: Inputs) -> dict:
        """The options that config.yaml keeps, with the defaults that the drive resolved."""
        given = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        resolved = {"masks": inputs.masks.name, "cameras": ",".join(inputs.masks.cameras)}
        kept = {key: value for key, value in (given | resolved).items() if key not in NOT_KEPT}
        return {key: value for key, value in kept.items() if value is not None and value is not False}
