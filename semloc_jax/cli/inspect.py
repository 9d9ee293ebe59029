"""`semloc inspect`: what a map holds and what looks wrong in it (room: cli)."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from semloc_jax.cli.main import LOST, OK


@dataclass(frozen=True)
class Options:
    """What a map holds, how large it is, and what looks wrong in it.

    Reads Lanelet2, OpenDRIVE, GeoJSON, GeoPackage, Argoverse 2, nuScenes, NGII shapefiles, Apollo HD maps in text
    form, the compact form and packed drives (.slocal).
    """

    map: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="MAP")]
    """The map file."""
    max_defects: int = 20
    """Number of defects that are described, at most."""
    strict: bool = False
    """Exit code 3 when the map has a defect."""
    picture: Path | None = None
    """Write the map from above to this PNG file."""


def run(options: Options) -> int:
    """Print the report, draw the map where asked."""
    from semloc_jax.maps import inspect_map, read_map
    from semloc_jax.runtime.allocator import return_large_blocks

    return_large_blocks()  # the arrays of a large map come one after another
    semantic_map = read_map(options.map)
    name = options.map.resolve().name  # a map that was converted bears the name that it had before
    report = dataclasses.replace(inspect_map(semantic_map), name=name)
    print(report.to_text(options.max_defects))
    if options.picture is not None:
        from semloc_jax import viz

        print(f"picture: {viz.save(viz.map_view(semantic_map.elements, title=name), options.picture)}")
    return LOST if options.strict and report.defects else OK
