"""Differences between versions as files of few bytes, .sdiff (room: maps; host).

In: MapDifference, the version it belongs on. Out: bytes, and the difference back.
Layout: b"SDIF", version, CRC-32 of the rest, the first 8 bytes of the digest of the base, the digest of the target,
LZMA of `lifted_json`. Elements of the base are named by their place in it, a new one is told as what makes it differ
from one that is known; columns of many elements stand together, coordinates and counts as differences.
"""

import lzma
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import accumulate
from os.path import commonprefix
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import MapElement
from semloc_jax.maps.versions.difference import CANONICAL, MapDifference, changed_columns
from semloc_jax.maps.versions.lifted_json import from_lifted, lifted_bytes
from semloc_jax.maps.versions.records import POINTS, Record, is_column, json_bytes, points_of
from semloc_jax.maps.versions.state import VERSION, MapState
from semloc_jax.storage import reading, write_bytes

MAGIC = b"SDIF\x02"
CHECK_BYTES = 4
_BASE_BYTES, _TARGET_BYTES = 8, 32
_FILTERS = [{"id": lzma.FILTER_LZMA1, "preset": 9, "dict_size": 1 << 24, "lc": 0, "lp": 0, "pb": 0}]
_LARGEST_PAYLOAD = 1 << 27
_BY = "+"
"""Begins the name of a column whose values are differences from those of the base; no column of an element does."""
_LIKE = 3
"""So many of the nearest elements of its class are tried as what a new one is like."""


def sdiff_bytes(step: MapDifference, base: MapState) -> bytes:
    """The file of a difference; the same bytes for the same difference."""
    row = {name: k for k, name in enumerate(base.records)}
    modified = {name: _against(columns, base.records[name]) for name, columns in step.modified.items()}
    like = list(_likened(step.added, base))
    stated = base.members
    document = [
        step.base_version,
        {key: value for key, value in step.members.items() if key not in stated or stated[key] != value},
        step.order if step.order is None or isinstance(step.order, str) else _steps(step.order),
        step.note,
        [len(step.removed), len(modified), len(like)],
        _steps([row[name] for name in step.removed]),
        _table({row[name]: columns for name, columns in modified.items()}),
        _front_coded(step.added),
        [k for k, _ in like],
        _table(dict(enumerate(columns for _, columns in like)))[1],
    ]
    packed = lzma.compress(lifted_bytes(document), format=lzma.FORMAT_RAW, filters=_FILTERS)
    rest = bytes.fromhex(step.base)[:_BASE_BYTES] + bytes.fromhex(step.target) + packed
    return MAGIC + _check(rest) + rest


def write_sdiff(step: MapDifference, base: MapState, path: str | Path) -> int:
    """Writes a difference; returns the number of its bytes."""
    content = sdiff_bytes(step, base)
    write_bytes(path, content)
    return len(content)


class SdiffFile:
    """A difference as it lies in a file: which step it is can be read without the map that it belongs on."""

    def __init__(self, content: bytes, where: str):
        """Checks the content.

        Raises:
            SemlocError: no difference, cut short, or altered.
        """
        begin = len(MAGIC) + CHECK_BYTES
        if not content.startswith(MAGIC):
            raise SemlocError(f"{where}: no difference of two maps; expected a file of `semloc diff`")
        rest = content[begin:]
        if len(rest) <= _BASE_BYTES + _TARGET_BYTES or _check(rest) != content[len(MAGIC) : begin]:
            raise SemlocError(f"{where}: its content is not what was written (cut short or altered); get it anew")
        self.base, self.target = rest[:_BASE_BYTES].hex(), rest[_BASE_BYTES : _BASE_BYTES + _TARGET_BYTES].hex()
        with reading(where):
            decoder = lzma.LZMADecompressor(format=lzma.FORMAT_RAW, filters=_FILTERS)
            text = decoder.decompress(rest[_BASE_BYTES + _TARGET_BYTES :], max_length=_LARGEST_PAYLOAD)
            base_version, members, self._order, note, counts, *self._body = from_lifted(text)
            self.base_version, self._members, self.note = int(base_version), dict(members), str(note)
            self.version = int(self._members.get(VERSION, base_version))
            self.num_removed, self.num_modified, self.num_added = (int(count) for count in counts)
        self._where = where

    @classmethod
    def read(cls, path: str | Path) -> "SdiffFile":
        """The file of a path.

        Raises:
            SemlocError: no such file, no difference, cut short, or altered.
        """
        path = Path(path)
        if not path.is_file():
            raise SemlocError(f"difference {path}: no such file; `semloc diff A B --out {path.name}` writes one")
        return cls(path.read_bytes(), f"difference {path.name}")

    def is_on(self, digest: str) -> bool:
        """Whether it belongs on the version with that digest."""
        return digest.startswith(self.base)

    def on(self, base: MapState) -> MapDifference:
        """The difference on the version it belongs on.

        Raises:
            SemlocError: it belongs on another one.
        """
        if not self.is_on(base.digest):
            raise SemlocError(
                f"{self._where}: belongs on version {self.base_version} ({self.base[:12]}), and map {base.map.name} is "
                f"version {base.version} ({base.digest[:12]}); apply it to that one"
            )
        names = list(base.records)
        with reading(self._where):
            removed, modified, ids, like, added = self._body
            return MapDifference(
                base.digest,
                self.base_version,
                self.target,
                {**base.members, **self._members},
                tuple(names[k] for k in accumulate(removed)),
                {names[k]: _upon(columns, base.records[names[k]]) for k, columns in _rows(modified).items()},
                _told(_front_decoded(ids), like, added, list(base.records.values())),
                self._order if self._order in (None, CANONICAL) else tuple(accumulate(self._order)),
                self.note,
            )


def _check(rest: bytes) -> bytes:
    return zlib.crc32(rest).to_bytes(CHECK_BYTES, "little")


def _likened(added: Mapping[str, Record], base: MapState) -> Iterator[tuple[int, Record]]:
    """Of each new element what it is like, an element of the base or a new one before it, and what differs."""
    known = list(base.records.values())
    near = _Nearest(base.map.elements)
    last: dict[str, int] = {}
    for record in added.values():
        rows = near.of(record)
        rows += [last[record["class"]]] if record["class"] in last else []
        tried = [(k, _against(changed_columns(known[k], record), known[k])) for k in rows or [0]]
        yield min(tried, key=lambda item: (len(json_bytes(item[1])), item[0]))
        last[record["class"]] = len(known)
        known.append(record)


class _Nearest:
    """The nearest elements of a class."""

    def __init__(self, elements: Sequence[MapElement]):
        self._rows: dict[str, list[int]] = {}
        for row, element in enumerate(elements):
            self._rows.setdefault(element.label.name, []).append(row)
        first = np.array([element.points[0, :2] for element in elements]).reshape(-1, 2)
        self._trees = {name: cKDTree(first[rows]) for name, rows in self._rows.items()}

    def of(self, record: Record) -> list[int]:
        """Rows of the elements whose first points are nearest to that of a record of the class."""
        rows = self._rows.get(record["class"], [])
        if not rows:
            return []
        num = min(_LIKE, len(rows))
        first = points_of(record)[0, :2]
        return [rows[k] for k in np.atleast_1d(self._trees[record["class"]].query(first, k=num)[1])]


def _told(ids: Sequence[str], like: Sequence[int], columns: list, known: list[Record]) -> dict[str, Record]:
    """The new elements, each by what it is like and what differs."""
    found: dict[str, Record] = {}
    differing = _rows([[0] + [1] * (len(ids) - 1) if ids else [], columns])
    for k, (name, row) in enumerate(zip(ids, like, strict=True)):
        record = {**known[row], **_upon(differing[k], known[row])}
        found[name] = {key: value for key, value in record.items() if is_column(key, record)}
        known.append(found[name])
    return found


def _front_coded(names: Iterable[str]) -> list:
    """How much of each name is that of the one before, and the rest of each."""
    names = list(names)
    shared = [len(commonprefix(pair)) for pair in zip(["", *names], names, strict=False)]
    return [shared, [name[k:] for name, k in zip(names, shared, strict=True)]]


def _front_decoded(coded: Sequence) -> list[str]:
    names: list[str] = []
    for shared, rest in zip(*coded, strict=True):
        names.append((names[-1][:shared] if names else "") + str(rest))
    return names


def _steps(numbers: Any) -> list[int]:
    """Each number less the one before it."""
    return [b - a for a, b in zip([0, *numbers], numbers, strict=False)]


def _table(rows: Mapping[int, Record]) -> list:
    """Records by their columns: numbers of the rows; for each column which rows have it (0: all) and its values."""
    names = list(dict.fromkeys(name for record in rows.values() for name in record))
    columns = []
    for name in names:
        held = [k for k, record in enumerate(rows.values()) if name in record]
        values = [record[name] for record in rows.values() if name in record]
        columns.append([name, 0 if len(held) == len(rows) else _steps(held), values])
    return [_steps(list(rows)), columns]


def _rows(table: list) -> dict[int, Record]:
    numbers, columns = list(accumulate(table[0])), table[1]
    found: list[Record] = [{} for _ in numbers]
    for name, held, values in columns:
        rows = range(len(numbers)) if held == 0 else list(accumulate(held))
        for k, value in zip(rows, values, strict=True):
            found[k][str(name)] = value
    return dict(zip(numbers, found, strict=True))


def _against(columns: Record, old: Record) -> Record:
    """Columns with counts and coordinates as differences from those of the base, where both are whole numbers."""
    found: Record = {}
    for name, value in columns.items():
        before = old.get(name)
        if name == POINTS and before[0] == value[0] == "mm" and len(before[1]) == len(value[1]):
            found[_BY + name] = [b - a for a, b in zip(before[1], value[1], strict=True)]
        elif type(value) is int and type(before) is int:
            found[_BY + name] = value - before
        else:
            found[name] = value
    return found


def _upon(columns: Record, old: Record) -> Record:
    found: Record = {}
    for name, value in columns.items():
        key = name.removeprefix(_BY)
        if key == name:
            found[name] = value
        elif key == POINTS:
            found[key] = ["mm", [a + b for a, b in zip(old[key][1], value, strict=True)]]
        else:
            found[key] = old[key] + value
    return found
