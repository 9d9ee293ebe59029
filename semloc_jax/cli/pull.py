"""`semloc pull`: the newest version of a map that is served (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from semloc_jax.cli.main import OK


@dataclass(frozen=True)
class Options:
    """Bring a map to the newest version of a server: the whole map once, then differences only.

    A difference that is for another map, cut short or altered is refused, and the map stays as it was.
    """

    url: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="URL")]
    """Address of 'semloc serve'."""
    out: Path
    """The .gpkg file."""
    have: int | None = None
    """Number of the version that the file must hold."""


def run(options: Options) -> int:
    """Pull, say what came."""
    from semloc_jax.service.client import pull

    before, after, size = pull(options.url, options.out, options.have)
    came_from = "nothing" if before is None else f"version {before.version}"
    print(f"{came_from} -> version {after.version} ({after.digest[:12]}): {size / 1000:.2f} kB\nmap: {options.out}")
    return OK
