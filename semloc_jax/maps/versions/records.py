"""An element as plain columns, and back without the loss of a bit (room: maps; host).

In: MapElement. Out: a record: values that JSON keeps exactly, by column; its digest; or the element of a record.
Coordinates that are whole millimetres are kept as integers, each less the one before: they pack well.
"""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from semloc_jax.maps.elements import MapElement
from semloc_jax.maps.versions.datum import STILL, Datum
from semloc_jax.structs import ElementClass

Record = dict[str, Any]
_MM = 1000.0
_MOST_MM = 2**52
_ATTRIBUTE = "a."
"""Begins the name of a column that holds a property of the file."""
KEYS, POINTS = "keys", "points"
_STANDS = "="
"""Begins the unit of coordinates that do not move with the frame of their map."""


def record_of(element: MapElement, datum: Datum = STILL) -> Record:
    """The columns of an element; its id is none of them.

    Args:
        element: as it lies by now.
        datum: how the frame of its map has moved: the columns hold its coordinates as they were published.
    """
    attributes = dict(element.attributes)
    record: Record = {
        "class": element.label.name,
        "style": element.style,
        "shape": element.shape,
        "closed": bool(element.closed),
        # No file keeps the sign of a zero in a column of its own.
        "width": float(element.width_m) + 0.0,
        "radius": float(element.radius_m) + 0.0,
        "radius_top": float(element.radius_top_m) + 0.0,
        "height": float(element.height_m) + 0.0,
        "normal": None if element.normal is None else [float(v) + 0.0 for v in element.normal],
        "true_ends": [bool(end) for end in element.true_ends],
        "has_height": bool(element.has_height),
        POINTS: _published(element.points, datum),
        KEYS: [str(key) for key in attributes],
    }
    # What JSON makes of a value is what the file keeps of it.
    record |= {_ATTRIBUTE + str(key): json.loads(json.dumps(value)) for key, value in attributes.items()}
    return record


def element_of(name: str, record: Mapping[str, Any], datum: Datum = STILL) -> MapElement:
    """The element of a record, where it lies by now.

    Raises:
        SemlocError, KeyError, TypeError, ValueError: no such columns.
    """
    normal = record["normal"]
    true_start, true_end = record["true_ends"]
    points = points_of(record)
    return MapElement(
        id=name,
        label=ElementClass[record["class"]],
        points=points if datum.is_still or record[POINTS][0].startswith(_STANDS) else datum.moved(points),
        closed=bool(record["closed"]),
        width_m=float(record["width"]),
        radius_m=float(record["radius"]),
        radius_top_m=float(record["radius_top"]),
        height_m=float(record["height"]),
        style=str(record["style"]),
        shape=str(record["shape"]),
        normal=None if normal is None else np.array(normal, dtype=np.float64).reshape(3),
        true_ends=(bool(true_start), bool(true_end)),
        has_height=bool(record["has_height"]),
        attributes={str(key): record[_ATTRIBUTE + key] for key in record[KEYS]},
    )


def is_column(name: str, record: Mapping[str, Any]) -> bool:
    """Whether a column still belongs to a record: properties that its keys do not name are gone."""
    return not name.startswith(_ATTRIBUTE) or name.removeprefix(_ATTRIBUTE) in record[KEYS]


def digest_of(name: str, record: Mapping[str, Any]) -> bytes:
    """SHA-256 of an element; the order of its properties counts, since files keep it."""
    return hashlib.sha256(json_bytes([name, list(record.items())])).digest()


def json_bytes(value: Any) -> bytes:
    """JSON in its one shortest form."""
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode(
        "utf-8", "surrogatepass"
    )


def whole_mm(record: Mapping[str, Any]) -> list[int]:
    """Coordinates of a record in whole millimetres, each less the one before, as near as that is."""
    cells = np.rint(points_of(record) * _MM).clip(-_MOST_MM, _MOST_MM).astype(np.int64)
    return np.diff(cells, axis=0, prepend=0).ravel().tolist()


def _published(points: np.ndarray, datum: Datum) -> list:
    """Coordinates as they were published; those that were not whole cells then stand where they are."""
    if datum.is_still:
        return _packed(points)
    before = datum.back(points)
    unit, numbers = _packed(points if before is None else before)
    return [unit if before is not None else _STANDS + unit, numbers]


def _packed(points: np.ndarray) -> list:
    """`["mm", differences]` where that gives every bit back, else `["m", numbers]`."""
    cells = np.rint(points * _MM)
    if (np.abs(cells) < _MOST_MM).all() and (cells / _MM).tobytes() == np.ascontiguousarray(points).tobytes():
        return ["mm", np.diff(cells.astype(np.int64), axis=0, prepend=0).ravel().tolist()]
    return ["m", points.ravel().tolist()]


def points_of(record: Mapping[str, Any]) -> np.ndarray:
    """Points of a record `float64[n 3]` [m].

    Raises:
        ValueError: none.
    """
    unit, numbers = record[POINTS]
    unit = unit.removeprefix(_STANDS)
    if unit == "mm":
        steps = np.array([int(n) for n in numbers], dtype=np.int64).reshape(-1, 3)
        return np.cumsum(steps, axis=0) / _MM
    if unit != "m":
        raise ValueError(f"coordinates in {str(unit)[:20]!r}")
    return np.array(numbers, dtype=np.float64).reshape(-1, 3)
