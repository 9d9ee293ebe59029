"""`semloc log`: the versions that a map has had (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from semloc_jax.cli.main import OK


@dataclass(frozen=True)
class Options:
    """The versions of a map, the newest first, and the tiles of the newest with their hashes.

    The history lies beside the map, in MAP.history: without it, the log knows the newest version only.
    """

    map: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="MAP")]
    """The map file."""
    tiles: bool = False
    """Print the hash of every tile of 256 m."""


def run(options: Options) -> int:
    """Print the log."""
    from semloc_jax.reports.versions import report_log

    print(report_log(options.map, options.tiles))
    return OK
