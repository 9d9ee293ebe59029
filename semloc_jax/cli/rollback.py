"""`semloc rollback`: an earlier version of a map again (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from semloc_jax.cli.main import OK


@dataclass(frozen=True)
class Options:
    """Go back to an earlier version of a map.

    Numbers of versions only grow: the old content becomes the next version of MAP, so that clients that follow it by
    differences go back too. With --out the old version is written there, byte for byte, and MAP stays.
    """

    map: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="MAP")]
    """The map file, with its history beside it."""
    to: int
    """Number of the version."""
    out: Path | None = None
    """A .gpkg file to write that version to."""


def run(options: Options) -> int:
    """Go back, say to what."""
    from semloc_jax.reports.versions import report_rollback

    print(report_rollback(options.map, options.to, options.out))
    return OK
