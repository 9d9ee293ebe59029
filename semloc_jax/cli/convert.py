"""`semloc convert`: a map in another format, with a report of what is lost (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from semloc_jax.cli.main import LOST, OK
from semloc_jax.errors import SemlocError

if TYPE_CHECKING:
    from semloc_jax.maps import GeoOrigin, SemanticMap


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
    """Place of the local frame: latitude,longitude,height in degrees and metres. A map that does not know its place
    gets it: its zero lies there, x points east, y north."""
    only: str | None = None
    """Classes to keep, separated by commas: pole,sign,lane_marking."""
    geojson: Literal["auto", "rfc7946", "drive"] = "auto"
    """GeoJSON in degrees or in the metres of the drive layout; auto: degrees where the map has a place on the earth."""
    heights: Path | None = None
    """Where elements without heights get them: an .asc grid, the folder of an Argoverse 2 log, a map with heights."""
    resolution_m: float = 0.01
    """Compact form: grid of coordinates, and how far a line may move when vertices are left out."""
    strict: bool = False
    """Exit code 3 when anything is lost."""


def run(options: Options) -> int:
    """Convert and report."""
    from semloc_jax.maps import compare, read_map
    from semloc_jax.maps.io import left_out, write_compact, write_map

    if options.out.exists() and options.out.samefile(options.map):
        raise SemlocError(f"{options.out}: is the map to read; give another file to write")
    origin = _origin(options.origin)
    semantic_map = read_map(options.map, origin)
    if origin is not None and semantic_map.origin is None:
        semantic_map = _at(semantic_map, origin)
    kept = _with_heights(_only(semantic_map, options.only), options.heights)
    if options.out.suffix.lower() == ".smap":
        write_compact(kept, options.out, options.resolution_m, options.resolution_m)
    else:
        write_map(kept, options.out, {"auto": None, "rfc7946": True, "drive": False}[options.geojson])
    losses = compare(kept, read_map(options.out))
    size = options.out.stat().st_size
    print(f"{options.out}: {len(kept.elements)} elements, {size / 1000:.1f} kB")
    print(losses.to_text())
    others = left_out(options.map)
    for kind, count in others.items():
        print(f"left out when the map was read: {count} {kind}")
    return LOST if options.strict and (others or not losses.is_exact) else OK


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


def _at(semantic_map: "SemanticMap", origin: "GeoOrigin") -> "SemanticMap":
    """The map with its zero at a place on the earth, and a line about it."""
    from semloc_jax.maps import SemanticMap

    place = ", ".join(f"{value:g}" for value in origin)
    print(f"place on the earth: unknown until now, put at {place}; x is taken as east, y as north")
    told = (semantic_map.name, semantic_map.skipped, semantic_map.frame)
    return SemanticMap(semantic_map.elements, origin, *told)


def _only(semantic_map: "SemanticMap", text: str | None) -> "SemanticMap":
    """The map with the classes that are wanted."""
    from semloc_jax.structs import ElementClass

    if text is None:
        return semantic_map
    names = {label.name.lower(): label for label in ElementClass}
    unknown = [word for word in text.split(",") if word.strip().lower() not in names]
    if unknown:
        raise SemlocError(f"--only {text}: no class '{unknown[0]}'; expected of {', '.join(names)}")
    labels = {names[word.strip().lower()] for word in text.split(",")}
    elements = tuple(element for element in semantic_map.elements if element.label in labels)
    if not elements:
        raise SemlocError(f"--only {text}: the map has none of these; it has {_classes(semantic_map)}")
    if all(element.is_logical for element in elements):
        raise SemlocError(
            f"--only {text}: none of these {len(elements)} elements has a size that a camera could see; keep others "
            f"too: the map has {_classes(semantic_map)}"
        )
    return semantic_map.with_elements(elements)


def _with_heights(semantic_map: "SemanticMap", path: Path | None) -> "SemanticMap":
    """The map with the heights that it lacked, and a line about them."""
    from semloc_jax.maps import read_map
    from semloc_jax.maps.heights import read_ground_raster, with_heights

    if path is None:
        return semantic_map
    is_raster = path.is_dir() or path.suffix.lower() in (".asc", ".npy")
    surface = read_ground_raster(path) if is_raster else read_map(path, semantic_map.origin).ground
    lifted = with_heights(semantic_map.elements, surface)
    missing = sum(not element.has_height for element in semantic_map.elements)
    print(f"heights: {missing - sum(not e.has_height for e in lifted)} of {missing} elements that lacked them")
    return semantic_map.with_elements(lifted)


def _classes(semantic_map: "SemanticMap") -> str:
    return ", ".join(sorted(label.name.lower() for label in semantic_map.labels)) or "nothing"
