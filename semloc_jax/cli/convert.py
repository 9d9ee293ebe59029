"""`semloc convert`: a map in another format, with a report of what is lost (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from semloc_jax.cli.main import LOST, OK
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.choices import parse_names

if TYPE_CHECKING:
    from semloc_jax.maps import GeoOrigin


@dataclass(frozen=True)
class Options:
    """Read a map of any known format, write it in another one, read that again and say what is lost.

    Writes GeoJSON (.geojson), GeoPackage (.gpkg), Lanelet2 (.osm) and the compact form (.smap).
    """

    map: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="MAP")]
    """The map to read."""
    out: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUT")]
    """The file to write; its suffix is the format."""
    origin: str | None = None
    """Place of the local frame: latitude,longitude,height in degrees and metres. A map without a place on the earth
    gets this one: its origin lies there, x points east, y north."""
    only: str | None = None
    """Classes to keep, separated by commas: pole,sign,lane_marking."""
    geojson: Literal["auto", "rfc7946", "drive"] = "auto"
    """GeoJSON in degrees or in the metres of the drive layout; auto: degrees where the map has a place on the earth."""
    heights: Path | None = None
    """Source of heights for elements without: an .asc grid, the folder of an Argoverse 2 log, a map with heights."""
    resolution_m: float = 0.01
    """Compact form: grid of coordinates, and how far a line may move when vertices are left out."""
    strict: bool = False
    """Exit code 3 when anything is lost."""


def run(options: Options) -> int:
    """Convert and print what was lost."""
    from semloc_jax.maps.conversion import Conversion, convert

    in_degrees = {"auto": None, "rfc7946": True, "drive": False}[options.geojson]
    only = parse_names(options.only) or ()
    wanted = Conversion(_origin(options.origin), only, in_degrees, options.heights, options.resolution_m)
    converted = convert(options.map, options.out, wanted)
    print(converted.to_text())
    return OK if converted.is_lossless or not options.strict else LOST


def _origin(text: str | None) -> "GeoOrigin | None":
    if text is None:
        return None
    from semloc_jax.maps import GeoOrigin

    try:
        origin = GeoOrigin(*(float(word) for word in text.split(",")))
    except (TypeError, ValueError):
        origin = GeoOrigin(float("nan"), 0.0)
    if not (abs(origin.lat_deg) <= 90.0 and abs(origin.lon_deg) <= 180.0 and abs(origin.alt_m) < 1e5):
        raise SemlocError(f"--origin {text}; expected latitude,longitude or latitude,longitude,height")
    return origin
