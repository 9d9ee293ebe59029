"""`semloc init`: what is there of your own data, what is missing, and what comes next (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from semloc_jax.cli.main import OK


@dataclass(frozen=True)
class Options:
    """Look at a folder of images, a bag or a video: say what is there and what is missing, and what to run next.

    Writes calib.yaml and classes.yaml to fill in where they are missing; changes nothing that is there.
    """

    path: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FOLDER")]
    """The folder, bag or video."""


def run(options: Options) -> int:
    """Look, write templates, print what was found."""
    from semloc_jax.inputs.first_look import first_look

    print(first_look(options.path).to_text())
    return OK
