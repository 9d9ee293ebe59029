"""`semloc pack`: what a car uploads of a drive (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from semloc_jax.cli.main import OK


@dataclass(frozen=True)
class Options:
    """Pack the results of 'semloc map' into the few kilobytes that 'semloc merge' takes of a drive.

    The file holds the elements with their sigmas and counts in the drive's own frame, outlines of the road that was
    looked at, a pose every ten metres, the name of the drive, and the day and hour. Whoever has it knows where the car
    went, from where to where, and in which hour. It holds no image, no mask, no other road user, no speed and no time
    within the hour; none of these can be recovered from it. --trim leaves the ends of the way out.
    """

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
    """The folder of a finished 'semloc map'."""
    out: Path
    """The file to write (.slocal)."""
    when: str | None = None
    """Date of the drive, such as 2026-05-31, where its clock shows none. Drives without dates count in the order of
    their names."""
    name: str | None = None
    """Another name of the drive."""
    trim: float = 0.0
    """Leave out what lies within so many metres of way from the start and from the end of the drive."""


def run(options: Options) -> int:
    """Pack, say how large it is."""
    from semloc_jax.reports.crowd import report_packed

    print(report_packed(options.folder, options.out, options.when, options.name, options.trim))
    return OK
