"""`semloc apply`: the next version of a map from the one that is there and a difference (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from semloc_jax.cli.main import OK


@dataclass(frozen=True)
class Options:
    """Make the version that a difference describes, byte for byte.

    A difference that is for another version, cut short or altered is refused, and nothing changes. The map
    keeps its history in OUT.history, for log and rollback.
    """

    base: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="BASE")]
    """The version that the difference applies to."""
    difference: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIFF")]
    """A file of 'semloc diff'."""
    out: Path
    """The .gpkg file to write; may be BASE itself."""


def run(options: Options) -> int:
    """Apply the difference, say what came out."""
    from semloc_jax.reports.versions import report_applied

    print(report_applied(options.base, options.difference, options.out))
    return OK
