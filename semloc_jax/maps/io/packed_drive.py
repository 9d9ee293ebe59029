"""What a car uploads of a drive: .slocal, some kilobytes for each kilometre (room: maps; host).

In: PackedDrive. Out: the file, and the drive back; every reader of maps opens the file as the map of the drive.
Layout: b"SLOC", version, SHA-256 of the rest, LZMA of a JSON list and columns of varints, each less the one before.
"""

import hashlib
import json
import lzma
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from semloc_jax.errors import SemlocError
from semloc_jax.maps.beliefs import BeliefMap
from semloc_jax.maps.elements import GeoOrigin
from semloc_jax.maps.io.packed_elements import elements_of, told_elements
from semloc_jax.maps.io.varints import joined_columns, split_columns
from semloc_jax.maps.semantic_map import SemanticMap, require_place
from semloc_jax.maps.versions.records import json_bytes
from semloc_jax.storage import FARTHEST_M, reading, write_bytes

MAGIC, _ANY_VERSION = b"SLOC\x03", 4
_HASH_BYTES = 32
_FILTERS = [{"id": lzma.FILTER_LZMA1, "preset": 9, "dict_size": 1 << 22, "lc": 3, "pb": 0}]
_LARGEST_PAYLOAD = 1 << 25
_COARSE = np.array([2.0, 2.0, 10.0])
"""Cells of a metre of the way and of what was looked at, along x, y and up."""
_ANGLES = 500.0
MOST_SCALE = 0.1
"""No odometer is off by more."""
_SOURCE_DIGITS = 16


@dataclass(frozen=True)
class PackedDrive:
    """A drive without its images and times: what it saw, what it would have seen, about where it was.

    Attributes:
        name: of the drive.
        beliefs: its elements, in its own frame `odom`: x ahead at its first pose, metres.
        place: `float64[4]` x, y, z [m] and heading [rad] of that frame in the frame of the map it was placed in.
        sigma_place_m: how far it may be off there: error of satellite fixes that the whole drive shares.
        origin: place of the map's frame on the earth; None where the drive does not know it.
        way: `float64[k 4]` x, y, z [m], heading [rad] in `odom`, a pose about every ten metres.
        rings: outlines `float64[n 2]` in `odom` of the road that it looked at [m].
        when_s: when it was, seconds since 1970, to the hour; None where its clock shows no date.
        source: hash of the map that it was packed from.
        scale: how many times as large wheels and fixes alone have the way as its images do.
    """

    name: str
    beliefs: BeliefMap
    place: Float[np.ndarray, "4"]
    sigma_place_m: float
    origin: GeoOrigin | None
    way: Float[np.ndarray, "k 4"]
    rings: tuple[Float[np.ndarray, "n 2"], ...]
    when_s: float | None = None
    source: str = ""
    scale: float = 1.0

    @property
    def length_m(self) -> float:
        """Length of the way."""
        return float(np.linalg.norm(np.diff(self.way[:, :2], axis=0), axis=1).sum())


def packed_bytes(drive: PackedDrive) -> bytes:
    """The file of a drive; the same bytes for the same drive.

    What is too fine for the file is rounded: places to 1 cm, heights to 10 cm, lines within 5 cm or their sigma
    across, painted outlines within 2 to 5 cm by theirs, sigmas to an eighth, existence to a nat. Elements lie in the
    order of the way and lose their names.
    """
    way = np.rint(drive.way * [*_COARSE, _ANGLES])
    corners = np.rint(np.concatenate([np.zeros((0, 2)), *drive.rings]) * _COARSE[:2])
    kinds, columns = told_elements(drive.beliefs.map.elements, drive.beliefs.beliefs, _way(way.T))
    header = [
        drive.name,
        [*(round(float(v), 3) for v in drive.place[:3]), round(float(drive.place[3]), 6)],
        round(float(drive.sigma_place_m), 3),
        None if drive.origin is None else list(drive.origin),
        drive.when_s,
        drive.source[:_SOURCE_DIGITS],
        round(float(drive.scale), 6),
        kinds,
        [len(ring) for ring in drive.rings],
    ]
    whole = [*way.T, *corners.T, *columns]
    joined = joined_columns(json_bytes(header), (_steps(column) for column in whole))
    content = lzma.compress(joined, format=lzma.FORMAT_RAW, filters=_FILTERS)
    return MAGIC + hashlib.sha256(content).digest() + content


def write_packed(drive: PackedDrive, path: str | Path) -> int:
    """Writes a drive; returns the number of its bytes."""
    content = packed_bytes(drive)
    write_bytes(path, content)
    return len(content)


def read_packed(path: str | Path) -> PackedDrive:
    """The drive of a file.

    Raises:
        SemlocError: no such file, no packed drive, cut short, altered, or numbers that no drive has.
    """
    path = Path(path)
    if not path.is_file():
        raise SemlocError(f"drive {path}: no such file; `semloc pack DIR --out {path.name}` writes one")
    return unpacked(path.read_bytes(), f"drive {path.name}")


def read_packed_map(path: str | Path) -> SemanticMap:
    """The map of a packed drive, with its beliefs as properties."""
    drive = read_packed(path)
    return drive.beliefs.as_map()


def unpacked(content: bytes, where: str) -> PackedDrive:
    """The drive of the bytes of a file; see `read_packed`."""
    begin = len(MAGIC) + _HASH_BYTES
    if content.startswith(MAGIC[:_ANY_VERSION]) and not content.startswith(MAGIC):
        raise SemlocError(f"{where}: a packed drive of another version of this package; pack the drive again")
    if not content.startswith(MAGIC):
        raise SemlocError(f"{where}: no packed drive; expected a file of `semloc pack`")
    if hashlib.sha256(content[begin:]).digest() != content[len(MAGIC) : begin]:
        raise SemlocError(f"{where}: its content is not what was written (cut short or altered); get it again")
    with reading(where):
        decoder = lzma.LZMADecompressor(format=lzma.FORMAT_RAW, filters=_FILTERS)
        text = decoder.decompress(content[begin:], max_length=_LARGEST_PAYLOAD)
        header, steps = split_columns(text)
        return _drive(json.loads(header), [np.cumsum(column) for column in steps])


def _drive(header: Sequence[Any], columns: list[np.ndarray]) -> PackedDrive:
    told, place, sigma_m, origin, when_s, source, scale, kinds, lengths = header
    name = str(told)
    origin = None if origin is None else GeoOrigin(*(float(v) for v in origin))
    require_place(origin, name)
    way = _way(columns[:4])
    corners = np.column_stack(columns[4:6]) / _COARSE[:2]
    bounds = np.cumsum([int(k) for k in lengths])
    rings = tuple(np.split(corners, bounds[:-1]))
    numbers = np.array(place, dtype=np.float64).reshape(4)
    sigma_m, scale = float(sigma_m), float(scale)
    when_s = None if when_s is None else float(when_s)
    known = elements_of(name, kinds, columns[6:], way)
    all_numbers = np.concatenate([numbers, way.ravel(), corners.ravel(), [sigma_m]])
    if (
        not (np.abs(all_numbers) < FARTHEST_M).all()
        or not sigma_m > 0.0
        or not abs(scale - 1.0) < MOST_SCALE
        or not np.isfinite(when_s or 0.0)
    ):
        raise ValueError("numbers that no drive has")
    if len(way) < 2 or not known or len(corners) != bounds[-1] or any(len(ring) < 3 for ring in rings):
        raise ValueError("no way, no elements, or a ring of fewer than three places")
    held = SemanticMap(tuple(e for e, _ in known), None, name, frame=f"odom of {name}: x ahead at its first pose")
    beliefs = BeliefMap(held, {e.id: b for e, b in known})
    return PackedDrive(
        name=name,
        beliefs=beliefs,
        place=numbers,
        sigma_place_m=sigma_m,
        origin=origin,
        way=way,
        rings=rings,
        when_s=when_s,
        source=str(source),
        scale=scale,
    )


def _way(columns: Sequence[np.ndarray] | np.ndarray) -> Float[np.ndarray, "k 4"]:
    return np.column_stack(list(columns)) / [*_COARSE, _ANGLES]


def _steps(column: np.ndarray) -> np.ndarray:
    """Whole numbers, each less the one before."""
    return np.diff(column.astype(np.int64), prepend=0)
