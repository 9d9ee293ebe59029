"""`semloc diff`: what makes one version of a map out of another, as a small file (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from semloc_jax.cli.main import OK


@dataclass(frozen=True)
class Options:
    """What was added, modified and removed between two versions of a map; elements are known by their ids.

    With --out the step is written to a file: 'semloc apply BASE FILE --out TARGET' then makes the target again, byte
    for byte.
    """

    base: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="BASE")]
    """The version before."""
    target: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="TARGET")]
    """The version after."""
    out: Path | None = None
    """The file to write (.sdiff)."""
    list: int = 20
    """Number of changed elements that are listed, at most."""


def run(options: Options) -> int:
    """Print the difference, write it where asked."""
    from semloc_jax.reports.versions import report_difference

    print(report_difference(options.base, options.target, options.out, options.list))
    return OK
