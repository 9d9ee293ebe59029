"""What a car uploads of a drive: .slocal, some kilobytes for each kilometre (room: maps; host).

In: PackedDrive. Out: the file, and the drive back; every reader of maps opens the file as the map of the drive.
Layout: b"SLOC", version, SHA-256 of the rest, LZMA of a JSON header and columns of varints, each less the one before.
"""

import hashlib
import json
import lzma
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from semloc_jax.errors import SemlocError
from semloc_jax.maps.beliefs import Belief, BeliefMap
from semloc_jax.maps.curves import simplify
from semloc_jax.maps.elements import FARTHEST_M, UPRIGHT_CLASSES, GeoOrigin, MapElement
from semloc_jax.maps.io.varints import joined_columns, split_columns
from semloc_jax.maps.semantic_map import SemanticMap, require_place
from semloc_jax.maps.versions.records import json_bytes
from semloc_jax.storage import reading, write_bytes
from semloc_jax.structs import ElementClass

MAGIC = b"SLOC\x02"
MOST_BYTES = 4 << 20
"""No drive needs more; a server takes no more."""
_HASH_BYTES = 32
_FILTERS = [{"id": lzma.FILTER_LZMA1, "preset": 9, "dict_size": 1 << 22, "lc": 3, "pb": 0}]
_LARGEST_PAYLOAD = 1 << 25
_CELLS = np.array([100.0, 100.0, 10.0])
"""Cells of a metre, along x, y and up."""
_COARSE = np.array([2.0, 2.0, 10.0])
"""The same of the way and of what was looked at."""
_THIN_M, _FLATTER = 0.05, np.array([1.0, 1.0, 0.2])
"""How far the middle of a line may move that is known as well, and by how much less its height counts there."""
_SIZES, _NORMALS, _ANGLES, _LOG_STEPS, _LOGIT_STEPS = 100.0, 100.0, 500.0, 4.0, 1.0
_MOST_LOGIT = 12.0
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
    across, sigmas to an eighth, existence to a nat. Elements lie in the order of the way and lose their names.
    """
    known = drive.beliefs.beliefs
    elements = sorted(
        (_thinned(e, known[e.id].sigma_across_m) for e in drive.beliefs.map.elements),
        key=lambda e: (_kind(e), *e.points[0]),
    )
    kinds = sorted({_kind(e) for e in elements})
    header = {
        "name": drive.name,
        "place": [*(round(float(v), 3) for v in drive.place[:3]), round(float(drive.place[3]), 6)],
        "sigma_place_m": round(float(drive.sigma_place_m), 3),
        "origin": None if drive.origin is None else list(drive.origin),
        "when_s": drive.when_s,
        "source": drive.source[:_SOURCE_DIGITS],
        "scale": round(float(drive.scale), 6),
        "kinds": kinds,
        "rings": [len(ring) for ring in drive.rings],
    }
    joined = joined_columns(json_bytes(header), (_steps(column) for column in _columns(drive, elements, kinds)))
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
    if not content.startswith(MAGIC):
        raise SemlocError(f"{where}: no packed drive; expected a file of `semloc pack`")
    if hashlib.sha256(content[begin:]).digest() != content[len(MAGIC) : begin]:
        raise SemlocError(f"{where}: its content is not what was written (cut short or altered); get it anew")
    with reading(where):
        decoder = lzma.LZMADecompressor(format=lzma.FORMAT_RAW, filters=_FILTERS)
        text = decoder.decompress(content[begin:], max_length=_LARGEST_PAYLOAD)
        header, steps = split_columns(text)
        return _drive(json.loads(header), [np.cumsum(column) for column in steps])


def _drive(header: Mapping[str, Any], columns: list[np.ndarray]) -> PackedDrive:
    name, origin = str(header["name"]), header["origin"]
    place = None if origin is None else GeoOrigin(*(float(v) for v in origin))
    require_place(place, name)
    way = np.column_stack(columns[:4]) / [*_COARSE, _ANGLES]
    corners = np.column_stack(columns[4:6]) / _COARSE[:2]
    bounds = np.cumsum([int(k) for k in header["rings"]])
    rings = tuple(np.split(corners, bounds[:-1]))
    numbers = np.array(header["place"], dtype=np.float64).reshape(4)
    sigma_m, scale = float(header["sigma_place_m"]), float(header["scale"])
    when_s = None if header["when_s"] is None else float(header["when_s"])
    known = _elements(name, header["kinds"], columns[6:])
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
    return PackedDrive(name, beliefs, numbers, sigma_m, place, way, rings, when_s, str(header["source"]), scale)


def _kind(e: MapElement) -> tuple:
    sizes = [round(_SIZES * v) for v in (e.width_m, e.radius_m, e.radius_top_m, e.height_m)]
    ends = [bool(end) for end in e.true_ends]
    return (e.label.name, e.style, e.shape, bool(e.closed), *ends, bool(e.has_height), e.normal is not None, *sizes)


def _thinned(element: MapElement, sigma_across_m: float) -> MapElement:
    if element.closed or element.label in UPRIGHT_CLASSES or len(element.points) < 3:
        return element
    flat = simplify(element.points * _FLATTER, max(_THIN_M, sigma_across_m))
    return element.with_points(flat / _FLATTER)


def _columns(drive: PackedDrive, elements: Sequence[MapElement], kinds: Sequence[tuple]) -> list[np.ndarray]:
    row = {kind: k for k, kind in enumerate(kinds)}
    known = [drive.beliefs.beliefs[e.id] for e in elements]
    way = drive.way * [*_COARSE, _ANGLES]
    corners = np.concatenate([np.zeros((0, 2)), *drive.rings]) * _COARSE[:2]
    cells = [np.rint(e.points * _CELLS) for e in elements]
    firsts = np.array([points[0] for points in cells])
    steps = np.concatenate([np.zeros((0, 3)), *(np.diff(points, axis=0) for points in cells)])
    normals = np.array([e.normal for e in elements if e.normal is not None]).reshape(-1, 3) * _NORMALS
    sigmas = np.log([[b.sigma_across_m, b.sigma_along_m] for b in known]) * _LOG_STEPS
    logits = [_LOGIT_STEPS * float(np.clip(b.existence_logit, -_MOST_LOGIT, _MOST_LOGIT)) for b in known]
    counts = [[row[_kind(e)], len(e.points), b.num_seen, b.num_missed] for e, b in zip(elements, known, strict=True)]
    tables = (way, corners, firsts, steps, normals, sigmas, np.array(logits)[:, None], np.array(counts, dtype=float))
    return [column for table in tables for column in np.rint(table).T]


def _elements(name: str, kinds: Sequence[Sequence], columns: list[np.ndarray]) -> list[tuple[MapElement, Belief]]:
    firsts, steps, normals = (np.column_stack(columns[k : k + 3]).astype(np.float64) for k in (0, 3, 6))
    across, along, logits, kind, lengths, seen, missed = columns[9:]
    if (lengths < 1).any() or int((lengths - 1).sum()) != len(steps):
        raise ValueError("elements of other numbers of points")
    bounds = np.concatenate([[0], np.cumsum(lengths - 1)])
    faces = iter(normals)
    found = []
    for k, first in enumerate(firsts):
        label, style, shape, closed, start, end, has_height, has_normal, *sizes = kinds[int(kind[k])]
        points = np.cumsum(np.vstack([first, steps[bounds[k] : bounds[k + 1]]]), axis=0) / _CELLS
        normal = _unit(next(faces)) if has_normal else None
        width_m, radius_m, radius_top_m, height_m = (size / _SIZES for size in sizes)
        element = MapElement(
            f"{ElementClass[label].name.lower()}_{k}",
            ElementClass[label],
            points,
            bool(closed),
            width_m,
            radius_m,
            radius_top_m,
            height_m,
            str(style),
            str(shape),
            normal,
            (bool(start), bool(end)),
            bool(has_height),
        )
        sigmas_m = np.exp(np.array([across[k], along[k]]) / _LOG_STEPS).tolist()
        counts = int(seen[k]), int(missed[k])
        found.append((element, Belief(*sigmas_m, logits[k] / _LOGIT_STEPS, *counts, provenance=name)))
    return found


def _unit(face: np.ndarray) -> np.ndarray:
    return face / max(float(np.linalg.norm(face)), 1e-9)


def _steps(column: np.ndarray) -> np.ndarray:
    """Whole numbers, each less the one before."""
    return np.diff(column.astype(np.int64), prepend=0)
