"""A map in a few kilobytes for each kilometre: rounded, thinned and packed (room: maps; host).

In: SemanticMap. Out: an .smap file, and the map back, without ids and attributes. Every line stays within
`thinning_m` + 0.87 `resolution_m` of what it was: the first is the Douglas-Peucker tolerance of lines, the second half
the diagonal of a cell of the grid that coordinates are rounded to. Sizes are rounded to 1 mm, normals to 0.1 deg.
Layout: b"SMAP", version, then LZMA of a JSON header and columns of zigzag varints of differences, all little-endian.
"""

import json
import lzma
from collections.abc import Collection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.maps.curves import simplify
from semloc_jax.maps.elements import UPRIGHT_CLASSES, GeoOrigin, MapElement
from semloc_jax.maps.io.varints import joined_columns, split_columns
from semloc_jax.maps.semantic_map import SemanticMap
from semloc_jax.storage import write_bytes
from semloc_jax.structs import ElementClass

MAGIC = b"SMAP\x01"
_FILTERS = [{"id": lzma.FILTER_LZMA1, "preset": 9, "dict_size": 1 << 24, "lc": 0, "pb": 0}]
_LARGEST_PAYLOAD = 1 << 26
_MORTON_CELL_M = 5.0
_ANGLES = 3600
"""Steps of a full turn."""


class _Kind(NamedTuple):
    """What many elements have alike; sizes in millimetres."""

    label: str
    style: str
    shape: str
    closed: bool
    true_ends: tuple[bool, bool]
    has_height: bool
    has_normal: bool
    width: int
    radius: int
    radius_top: int
    height: int


def write_compact(
    semantic_map: SemanticMap,
    path: str | Path,
    resolution_m: float = 0.01,
    thinning_m: float = 0.01,
    labels: Collection[ElementClass] | None = None,
) -> None:
    """Writes a map in its compact form.

    Args:
        semantic_map: the map.
        path: the .smap file.
        resolution_m: grid that coordinates are rounded to.
        thinning_m: how far the middle of a line may move when vertices are left out.
        labels: classes to keep; None keeps all.

    Raises:
        SemlocError: a resolution that is not positive, or the file cannot be written.
    """
    packed = compact_bytes(semantic_map, resolution_m, thinning_m, labels)
    try:
        write_bytes(path, packed)
    except OSError as error:
        raise SemlocError(f"cannot write map {path}: {error.strerror}; give a path in a folder that exists") from error


def compact_bytes(
    semantic_map: SemanticMap,
    resolution_m: float = 0.01,
    thinning_m: float = 0.01,
    labels: Collection[ElementClass] | None = None,
) -> bytes:
    """Returns the contents of the compact file of a map; see `write_compact`.

    Raises:
        SemlocError: a resolution that is not positive.
    """
    if not (0.0 < resolution_m <= 1.0 and 0.0 <= thinning_m <= 1.0):
        raise SemlocError(
            f"compact map with a resolution of {resolution_m} m and a thinning of {thinning_m} m; "
            "expected more than 0 and at most 1 m"
        )
    elements = [e for e in semantic_map.elements if labels is None or e.label in labels]
    kinds = [_kind(element) for element in elements]
    known = sorted(set(kinds))
    rank = {kind: row for row, kind in enumerate(known)}
    cells = [_morton(element.points[0]) for element in elements]
    order = sorted(range(len(elements)), key=lambda i: (rank[kinds[i]], cells[i]))
    shift = np.floor(semantic_map.extent[0]).tolist() if elements else [0.0, 0.0, 0.0]
    cut = [_thinned(elements[i], thinning_m) for i in order]
    header = {
        "name": semantic_map.name,
        "origin": semantic_map.origin,
        "frame": semantic_map.frame,
        "resolution_m": resolution_m,
        "shift": shift,
        "kinds": known,
    }
    cells_xyz = [np.rint((points - shift) / resolution_m).astype(np.int64) for points in cut]
    first = np.array([points[0] for points in cells_xyz], dtype=np.int64).reshape(-1, 3)
    steps = np.concatenate([np.zeros((0, 3), dtype=np.int64), *(np.diff(points, axis=0) for points in cells_xyz)])
    columns = [
        np.bincount([rank[kind] for kind in kinds], minlength=len(known)),
        np.array([len(points) for points in cut], dtype=np.int64),
        *np.diff(first, axis=0, prepend=0).T,
        *steps.T,
        *_angles([elements[i] for i in order]).T,
    ]
    joined = joined_columns(json.dumps(header, allow_nan=False).encode(), columns)
    return MAGIC + lzma.compress(joined, format=lzma.FORMAT_RAW, filters=_FILTERS)


def read_compact(path: str | Path) -> SemanticMap:
    """Returns the map of a compact file; ids are numbers.

    Raises:
        SemlocError: another format, broken, or larger than a map can be.
    """
    path = Path(path)
    raw = path.read_bytes()
    if not raw.startswith(MAGIC):
        raise SemlocError(f"map {path.name}: not a compact map of this version; expected a file of `semloc convert`")
    try:
        decoder = lzma.LZMADecompressor(format=lzma.FORMAT_RAW, filters=_FILTERS)
        payload = decoder.decompress(raw[len(MAGIC) :], max_length=_LARGEST_PAYLOAD)
        text, columns = split_columns(payload)
        header = json.loads(text)
        elements = _elements(header, columns)
        origin = header["origin"]
        place = GeoOrigin(*map(float, origin)) if origin is not None else None
        return SemanticMap(elements, place, str(header["name"]), frame=str(header["frame"]))
    except (lzma.LZMAError, EOFError, KeyError, IndexError, TypeError, ValueError, OverflowError) as error:
        raise SemlocError(f"map {path.name}: broken ({str(error)[:80]}); is the file complete?") from error


def _kind(e: MapElement) -> _Kind:
    sizes = (round(1000.0 * value) for value in (e.width_m, e.radius_m, e.radius_top_m, e.height_m))
    has_normal = e.normal is not None
    return _Kind(e.label.name, e.style, e.shape, e.closed, e.true_ends, e.has_height, has_normal, *sizes)


def _thinned(element: MapElement, thinning_m: float) -> np.ndarray:
    """Returns the points of an element with those of smooth lines thinned."""
    if element.closed or element.label in UPRIGHT_CLASSES or len(element.points) < 3:
        return element.points
    return simplify(element.points, thinning_m)


def _angles(elements: list[MapElement]) -> np.ndarray:
    """Returns azimuth and elevation of the normals, in steps of 0.1 deg, `int[n 2]`."""
    normals = np.array([e.normal for e in elements if e.normal is not None]).reshape(-1, 3)
    azimuth = np.arctan2(normals[:, 1], normals[:, 0])
    elevation = np.arcsin(np.clip(normals[:, 2], -1.0, 1.0))
    return np.rint(np.stack([azimuth, elevation], axis=1) * _ANGLES / (2.0 * np.pi)).astype(np.int64)


def _elements(header: dict[str, Any], columns: list[np.ndarray]) -> tuple[MapElement, ...]:
    kinds = [_Kind(*kind) for kind in header["kinds"]]
    if len(columns) != 10:
        raise ValueError(f"{len(columns)} columns; expected 10")
    per_kind, lengths, fx, fy, fz, dx, dy, dz, azimuth, elevation = columns
    owner = np.repeat(np.arange(len(kinds)), per_kind)
    if len(owner) != len(lengths) or (lengths < 1).any() or int((lengths - 1).sum()) != len(dx):
        raise ValueError("columns do not fit together")
    first = np.cumsum(np.stack([fx, fy, fz], axis=1), axis=0)
    steps = np.stack([dx, dy, dz], axis=1)
    bounds = np.concatenate([[0], np.cumsum(lengths - 1)])
    scale, shift = float(header["resolution_m"]), np.array(header["shift"], dtype=np.float64).reshape(3)
    angle = 2.0 * np.pi / _ANGLES
    normals = iter(zip(azimuth * angle, elevation * angle, strict=True))
    found = []
    for index, row in enumerate(owner):
        kind = kinds[row]
        cells = first[index] + np.vstack(
            [np.zeros((1, 3)), np.cumsum(steps[bounds[index] : bounds[index + 1]], axis=0)]
        )
        found.append(_element(str(index), kind, cells * scale + shift, next(normals) if kind.has_normal else None))
    return tuple(found)


def _element(name: str, kind: _Kind, points: np.ndarray, angles: tuple[float, float] | None) -> MapElement:
    normal = None
    if angles is not None:
        flat = np.cos(angles[1])
        normal = np.array([flat * np.cos(angles[0]), flat * np.sin(angles[0]), np.sin(angles[1])])
    if not np.isfinite(points).all():
        raise ValueError("coordinates that are not finite")
    return MapElement(
        id=name,
        label=ElementClass[kind.label],
        points=points,
        closed=bool(kind.closed),
        width_m=kind.width / 1000.0,
        radius_m=kind.radius / 1000.0,
        radius_top_m=kind.radius_top / 1000.0,
        height_m=kind.height / 1000.0,
        style=str(kind.style),
        shape=str(kind.shape),
        normal=normal,
        true_ends=(bool(kind.true_ends[0]), bool(kind.true_ends[1])),
        has_height=bool(kind.has_height),
    )


def _morton(point: np.ndarray) -> int:
    """Returns a number that is near for places that are near: the bits of x and y in turn."""
    x, y = (int(v) + (1 << 30) for v in np.floor(point[:2] / _MORTON_CELL_M))
    return sum((x >> bit & 1) << 2 * bit | (y >> bit & 1) << 2 * bit + 1 for bit in range(31))
