"""New elements told as what makes them differ from those that are known (room: maps; host).

In: records of a base map, new records. Out: what each is like, an element of the base or a new one before it, and the
columns that differ; and the records back. A name is told by how much it begins with of that of what it is like.
"""

import base64
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
from scipy.spatial import cKDTree

from semloc_jax.maps.elements import MapElement
from semloc_jax.maps.versions.difference import changed_columns
from semloc_jax.maps.versions.records import Record, is_column, points_of
from semloc_jax.maps.versions.state import MapState
from semloc_jax.maps.versions.tables import against, rows_of, upon
from semloc_jax.maps.versions.terse import terse_bytes

_HASH_BYTES = 4
_HASH = re.compile(f"(.*_)([0-9a-f]{{{2 * _HASH_BYTES}}})", re.DOTALL)
"""A name that ends in a hash, as those of things that drives have found."""
_LIKE = 8
"""So many of the nearest elements of its class are tried as what a new one is like."""
_NOTHING: Record = {}
"""What the first element of its class is like."""


def likened(added: Mapping[str, Record], base: MapState) -> Iterator[tuple[int, Record]]:
    """Of each new element what it is like, an element of the base or a new one before it, and what differs."""
    known = [_NOTHING, *base.records.values()]
    near = _Nearest(base.map.elements)
    last: dict[str, int] = {}
    for record in added.values():
        rows = near.of(record)
        rows += [last[record["class"]]] if record["class"] in last else []
        tried = [(k, against(changed_columns(known[k], record), known[k])) for k in rows or [0]]
        yield min(tried, key=lambda item: (len(terse_bytes(item[1])), item[0]))
        last[record["class"]] = len(known)
        known.append(record)


class _Nearest:
    """The nearest elements of a class."""

    def __init__(self, elements: Sequence[MapElement]):
        self._rows: dict[str, list[int]] = {}
        for row, element in enumerate(elements, 1):
            self._rows.setdefault(element.label.name, []).append(row)
        first = np.array([element.points[0, :2] for element in elements]).reshape(-1, 2)
        self._trees = {name: cKDTree(first[np.array(rows) - 1]) for name, rows in self._rows.items()}

    def of(self, record: Record) -> list[int]:
        """Places of the elements, from 1, whose first points are nearest to that of a record of the class."""
        rows = self._rows.get(record["class"], [])
        if not rows:
            return []
        num = min(_LIKE, len(rows))
        first = points_of(record)[0, :2]
        return [rows[k] for k in np.atleast_1d(self._trees[record["class"]].query(first, k=num)[1])]


def told_records(ids: Sequence[str], like: Sequence[int], columns: list, base: MapState) -> dict[str, Record]:
    """The new elements, each by what it is like and what differs."""
    known, found = [_NOTHING, *base.records.values()], dict[str, Record]()
    differing = rows_of([[0] + [1] * (len(ids) - 1) if ids else [], columns])
    for k, (name, row) in enumerate(zip(ids, like, strict=True)):
        record = {**known[row], **upon(differing[k], known[row])}
        found[name] = {key: value for key, value in record.items() if is_column(key, record)}
        known.append(found[name])
    return found


def coded_names(names: Iterable[str], like: Sequence[int], base: MapState) -> list:
    """Names: how many letters each shares with that of what it is like, the rest of each, the hashes all end in."""
    names, hashes = list(names), b""
    known = ["", *base.records, *names]
    found = [_HASH.fullmatch(name) for name in names]
    if names and all(found):
        hashes = bytes.fromhex("".join(part[2] for part in found if part))
        names = [part[1] for part in found if part]
    shared = [_num_shared(known[row], name) for row, name in zip(like, names, strict=True)]
    return [shared, [name[k:] for name, k in zip(names, shared, strict=True)], hashes]


def _num_shared(one: str, other: str) -> int:
    """How many letters two names begin with alike."""
    return next((k for k, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))


def decoded_names(coded: Sequence, like: Sequence[int], base: MapState) -> list[str]:
    """The names that `coded_names` told; in files of before, against the name before each and with hashes as text."""
    shared, rests, told = coded
    hashes = base64.b64decode(told, validate=True) if isinstance(told, str) else told
    known = ["", *base.records]
    first = len(known)
    for k, (num, rest, row) in enumerate(zip(shared, rests, like, strict=True)):
        name = known[-1 if isinstance(told, str) else row][:num] + str(rest)
        known.append(name + hashes[_HASH_BYTES * k : _HASH_BYTES * (k + 1)].hex())
    if len(hashes) not in (0, _HASH_BYTES * len(shared)):
        raise ValueError("names with other hashes")
    return known[first:]
