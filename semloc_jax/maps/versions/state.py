"""One version of a map: what it holds, its number, its hashes by tile (room: maps; host).

In: a map file. Out: MapState; or the file, in the canonical form: the bytes follow from the state alone.
The canonical form is the GeoPackage that this package writes: elements in their order, no clock, no name of a host.
"""

import contextlib
import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import GeoOrigin, MapElement
from semloc_jax.maps.io.formats import read_map
from semloc_jax.maps.io.geopackage import schema, write_geopackage
from semloc_jax.maps.semantic_map import SemanticMap
from semloc_jax.maps.versions.datum import STILL, Datum
from semloc_jax.maps.versions.records import Record, digest_of, json_bytes, record_of

TILE_M = 256.0
"""Side of a tile; the bounds are whole multiples of it in the frame of the map."""
VERSION, NUM_DRIVES, DATUM = "map_version", "num_drives", "datum"
"""Members of the file that say which version it is, how many drives were merged into it, how its frame has moved."""
Tile = tuple[int, int]


@dataclass(frozen=True)
class MapState:
    """One version of a map.

    Attributes:
        map: its elements; ids are unique.
        version: number, 1 or more; a map that states none is its own first version.
        num_drives: drives that were merged into it.
        datum: how its frame has moved since its elements were published.
    """

    map: SemanticMap
    version: int = 1
    num_drives: int = 0
    datum: Datum = STILL

    def __post_init__(self) -> None:
        ids = [element.id for element in self.map.elements]
        if len(set(ids)) < len(ids):
            twice = next(name for k, name in enumerate(ids) if name in ids[:k])
            raise SemlocError(f"map {self.map.name}: two elements have the id '{twice[:60]}'; rename one of them")
        if self.version < 1 or self.num_drives < 0:
            raise SemlocError(f"map {self.map.name}: version {self.version}; expected a number from 1 on")

    @cached_property
    def records(self) -> dict[str, Record]:
        """Columns of every element as it was published, by id, in the order of the map."""
        return {element.id: record_of(element, self.datum) for element in self.map.elements}

    @property
    def members(self) -> dict[str, Any]:
        """What the file states besides its elements."""
        moved = {} if self.datum.is_still else {DATUM: self.datum.to_json()}
        return {
            "name": self.map.name,
            "origin": None if self.map.origin is None else list(self.map.origin),
            "frame": self.map.frame,
            "skipped": dict(self.map.skipped),
            VERSION: self.version,
            NUM_DRIVES: self.num_drives,
            **moved,
        }

    @cached_property
    def tiles(self) -> dict[Tile, str]:
        """SHA-256 of the elements of each tile as they were published, whatever their order.

        An element belongs to the tile of its middle.
        """
        held: dict[Tile, list[bytes]] = {}
        for element in self.map.elements:
            held.setdefault(tile_of(element), []).append(digest_of(element.id, self.records[element.id]))
        return {tile: hashlib.sha256(b"".join(sorted(held[tile]))).hexdigest() for tile in sorted(held)}

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all that the file keeps: elements, their order, members."""
        return hashlib.sha256(json_bytes([self.members, list(self.records), list(self.tiles.items())])).hexdigest()

    @cached_property
    def content(self) -> str:
        """SHA-256 of the elements where they lie by now, whatever their order and the number of the version."""
        moved = [] if self.datum.is_still else [self.datum.to_json()]
        return hashlib.sha256(json_bytes([*self.tiles.items(), *moved])).hexdigest()


def tile_of(element: MapElement) -> Tile:
    """The tile that an element belongs to: that of the middle of its box."""
    xy = element.points[:, :2]
    x, y = np.floor(0.5 * (xy.min(axis=0) + xy.max(axis=0)) / TILE_M).astype(int).tolist()
    return x, y


def in_canonical_order(elements: Iterable[MapElement]) -> list[MapElement]:
    """Elements by tile, then by id: the order of a map that nobody has ordered."""
    return sorted(elements, key=lambda element: (tile_of(element), element.id))


def read_state(path: str | Path) -> MapState:
    """The version that a map file holds.

    Raises:
        SemlocError: no map, or two elements with one id.
    """
    path = Path(path)
    semantic_map = read_map(path)
    stated = _stated(path)
    held = SemanticMap(
        semantic_map.elements, semantic_map.origin, semantic_map.name, semantic_map.skipped, semantic_map.frame
    )
    return MapState(held, *stated)


def write_state(state: MapState, path: str | Path) -> None:
    """Writes a version in the canonical form; a file that is there is replaced once the new one is whole.

    Raises:
        SemlocError: the file is no .gpkg, or cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() != ".gpkg":
        raise SemlocError(f"map {path}: versions are kept in GeoPackages; give a path that ends in .gpkg")
    is_first = (state.version, state.num_drives) == (1, 0)  # states no number, like every map that was never merged
    stated = {} if is_first else {VERSION: state.version, NUM_DRIVES: state.num_drives}
    if not state.datum.is_still:
        stated[DATUM] = state.datum.to_json()
    write_geopackage(state.map, path, stated)


def state_of(elements: Iterable[MapElement], members: dict[str, Any]) -> MapState:
    """The version with these elements and members.

    Raises:
        SemlocError, KeyError, TypeError, ValueError: members that no file states.
    """
    origin = members["origin"]
    semantic_map = SemanticMap(
        tuple(elements),
        None if origin is None else GeoOrigin(*(float(v) for v in origin)),
        str(members["name"]),
        {str(key): int(count) for key, count in members["skipped"].items()},
        str(members["frame"]),
    )
    return MapState(semantic_map, int(members[VERSION]), int(members[NUM_DRIVES]), datum_of(members.get(DATUM)))


def datum_of(columns: list[list[int]] | None) -> Datum:
    """The datum that a file states; that of a map that never moved where it states none."""
    return Datum.from_json(columns) if columns else STILL


def _stated(path: Path) -> tuple[int, int, Datum]:
    """Version, number of drives and datum of a file; 1, 0 and none where it states none."""
    if path.suffix.lower() != ".gpkg" or not path.is_file():
        return 1, 0, STILL
    with contextlib.closing(schema.connect(path)) as connection:
        if not connection.is_table("semloc_map"):
            return 1, 0, STILL
        members = dict(connection.ask("SELECT key, value FROM semloc_map"))
    try:
        numbers = int(json.loads(members.get(VERSION, "1"))), int(json.loads(members.get(NUM_DRIVES, "0")))
        return *numbers, datum_of(json.loads(members.get(DATUM, "null")))
    except (TypeError, ValueError) as error:
        raise SemlocError(f"map {path.name}: its version cannot be read ({error}); get the file again") from error
