"""A map in another format, with a report of what is lost (room: maps; host).

In: the path of a map, what is wanted of it. Out: the written map, losses, text.
"""

from dataclasses import dataclass, field
from pathlib import Path

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import GeoOrigin
from semloc_jax.maps.ground_raster import read_ground_raster
from semloc_jax.maps.heights import with_heights
from semloc_jax.maps.io import read_map, write_compact, write_map
from semloc_jax.maps.io.lanes import left_out
from semloc_jax.maps.losses import Losses, compare
from semloc_jax.maps.semantic_map import SemanticMap
from semloc_jax.structs import ElementClass

_MOST_TOLD = 5


@dataclass(frozen=True)
class Conversion:
    """What is wanted of a converted map.

    Args:
        origin: Place of the local frame; a map that does not know its place gets it, with x east and y north.
        only: Names of the classes to keep; empty for all.
        in_degrees: GeoJSON in degrees or in metres; None: degrees where the map has a place on the earth.
        heights: Where elements without heights get them: an .asc grid, the folder of an Argoverse 2 log, a map.
        resolution_m: Compact form: grid of coordinates, and how far a line may move when vertices are left out [m].
    """

    origin: GeoOrigin | None = None
    only: tuple[str, ...] = ()
    in_degrees: bool | None = None
    heights: Path | None = None
    resolution_m: float = 0.01


@dataclass(frozen=True)
class Converted:
    """A converted map.

    Args:
        map: What was written.
        losses: How the written file differs from it.
        left_out: Number of things of each kind in the source that a map of visible elements does not keep.
        path: The written file.
        notes: What was done on the way, as text.
        faulty: What is wrong with each element of the source that was left out, by id.
    """

    map: SemanticMap
    losses: Losses
    left_out: dict[str, int]
    path: Path
    notes: list[str] = field(default_factory=list)
    faulty: dict[str, str] = field(default_factory=dict)

    @property
    def is_lossless(self) -> bool:
        """Whether nothing was lost."""
        return self.losses.is_lossless and not self.left_out and not self.faulty

    def to_text(self) -> str:
        """The report as text."""
        size_kb = self.path.stat().st_size / 1000
        lines = [*self.notes, f"{self.path}: {len(self.map.elements)} elements, {size_kb:.1f} kB"]
        others = [f"left out when the map was read: {count} {kind}" for kind, count in self.left_out.items()]
        others += [f"left out: {name[:60]} ({fault})" for name, fault in list(self.faulty.items())[:_MOST_TOLD]]
        if len(self.faulty) > _MOST_TOLD:
            others.append(f"left out: {len(self.faulty) - _MOST_TOLD} more elements that cannot be meant")
        return "\n".join([*lines, self.losses.to_text(), *others])


def convert(source: Path, target: Path, wanted: Conversion | None = None) -> Converted:
    """Read a map of any known format, write it in the format of the target's suffix, read that again and compare.

    Raises:
        SemlocError: source and target are one file, nothing is left of the map, or a file cannot be read or written.
    """
    wanted = wanted or Conversion()
    if target.exists() and target.samefile(source):
        raise SemlocError(f"{target}: is the map to read; give another file to write")
    notes: list[str] = []
    semantic_map = given = read_map(source, wanted.origin)
    if wanted.origin is not None and semantic_map.origin is None:
        semantic_map = _at(semantic_map, wanted.origin, notes)
    kept = _with_heights(_only(semantic_map, wanted.only), wanted.heights, notes)
    if target.suffix.lower() == ".smap":
        write_compact(kept, target, wanted.resolution_m, wanted.resolution_m)
    else:
        write_map(kept, target, wanted.in_degrees)
    losses = compare(kept, read_map(target))
    # A map that stays in its file has looked at its elements only now.
    return Converted(kept, losses, left_out(source), target, notes, dict(given.faulty))


def _at(semantic_map: SemanticMap, origin: GeoOrigin, notes: list[str]) -> SemanticMap:
    """The map with its zero at a place on the earth."""
    place = ", ".join(f"{value:g}" for value in origin)
    notes.append(f"place on the earth: unknown until now, set to {place}; x is taken as east, y as north")
    return SemanticMap(semantic_map.elements, origin, semantic_map.name, semantic_map.skipped, semantic_map.frame)


def _only(semantic_map: SemanticMap, names: tuple[str, ...]) -> SemanticMap:
    """The map with the classes that are wanted."""
    if not names:
        return semantic_map
    known, text = {label.name.lower(): label for label in ElementClass}, ",".join(names)
    unknown = [name for name in names if name.lower() not in known]
    if unknown:
        raise SemlocError(f"--only {text}: no class '{unknown[0]}'; expected of {', '.join(known)}")
    labels = {known[name.lower()] for name in names}
    elements = tuple(element for element in semantic_map.elements if element.label in labels)
    if not elements:
        raise SemlocError(f"--only {text}: the map has none of these; it has {_classes(semantic_map)}")
    if all(element.is_logical for element in elements):
        raise SemlocError(
            f"--only {text}: none of these {len(elements)} elements has a size that a camera could see; keep others "
            f"too: the map has {_classes(semantic_map)}"
        )
    return semantic_map.with_elements(elements)


def _with_heights(semantic_map: SemanticMap, path: Path | None, notes: list[str]) -> SemanticMap:
    """The map with the heights that it lacked."""
    if path is None:
        return semantic_map
    is_raster = path.is_dir() or path.suffix.lower() in (".asc", ".npy")
    surface = read_ground_raster(path) if is_raster else read_map(path, semantic_map.origin).ground
    lifted = with_heights(semantic_map.elements, surface)
    missing = sum(not element.has_height for element in semantic_map.elements)
    still = sum(not element.has_height for element in lifted)
    notes.append(f"heights: {missing - still} of {missing} elements that lacked them")
    return semantic_map.with_elements(lifted)


def _classes(semantic_map: SemanticMap) -> str:
    return ", ".join(sorted(label.name.lower() for label in semantic_map.labels)) or "nothing"
