"""Differences between versions as files of few bytes, .sdiff (room: maps; host).

In: MapDifference, the version it belongs on. Out: bytes, and the difference back.
Layout: b"SDIF", version, SHA-256 of the rest, LZMA of JSON. Elements of the base are named by their place in it,
columns of many elements stand together, coordinates and counts as differences from the base: like beside like.
"""

import hashlib
import json
import lzma
from collections.abc import Mapping
from itertools import accumulate
from pathlib import Path
from typing import Any

from semloc_jax.errors import SemlocError
from semloc_jax.maps.versions.difference import CANONICAL, MapDifference
from semloc_jax.maps.versions.records import POINTS, Record, json_bytes
from semloc_jax.maps.versions.state import MapState
from semloc_jax.storage import reading, write_bytes

MAGIC = b"SDIF\x01"
_HASH_BYTES = 32
_FILTERS = [{"id": lzma.FILTER_LZMA1, "preset": 9, "dict_size": 1 << 24, "lc": 3, "pb": 0}]
_LARGEST_PAYLOAD = 1 << 27
_BY = "+"
"""Begins the name of a column whose values are differences from those of the base; no column of an element does."""
_HEAD = ("base", "base_version", "target", "members", "order", "note")


def sdiff_bytes(step: MapDifference, base: MapState) -> bytes:
    """The file of a difference; the same bytes for the same difference."""
    row = {name: k for k, name in enumerate(base.records)}
    modified = {name: _against(columns, base.records[name]) for name, columns in step.modified.items()}
    document = [
        step.base,
        step.base_version,
        step.target,
        step.members,
        step.order if step.order is None or isinstance(step.order, str) else _steps(step.order),
        step.note,
        _steps([row[name] for name in step.removed]),
        _table({row[name]: columns for name, columns in modified.items()}),
        list(step.added),
        _table(dict(enumerate(step.added.values()))),
    ]
    packed = lzma.compress(json_bytes(document), format=lzma.FORMAT_RAW, filters=_FILTERS)
    return MAGIC + hashlib.sha256(packed).digest() + packed


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
        begin = len(MAGIC) + _HASH_BYTES
        if not content.startswith(MAGIC):
            raise SemlocError(f"{where}: no difference of two maps; expected a file of `semloc diff`")
        if len(content) <= begin or hashlib.sha256(content[begin:]).digest() != content[len(MAGIC) : begin]:
            raise SemlocError(f"{where}: its content is not what was written (cut short or altered); get it anew")
        with reading(where):
            decoder = lzma.LZMADecompressor(format=lzma.FORMAT_RAW, filters=_FILTERS)
            text = decoder.decompress(content[begin:], max_length=_LARGEST_PAYLOAD)
            document = json.loads(text)
            self._head = dict(zip(_HEAD, document, strict=False))
            self._body = document[len(_HEAD) :]
            self.base, self.target = str(self._head["base"]), str(self._head["target"])
            self.base_version = int(self._head["base_version"])
            self.version = int(self._head["members"]["map_version"])
            self.note = str(self._head["note"])
            self.num_removed, self.num_added = len(self._body[0]), len(self._body[2])
            self.num_modified = len(self._body[1][0])
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

    def on(self, base: MapState) -> MapDifference:
        """The difference on the version it belongs on.

        Raises:
            SemlocError: it belongs on another one.
        """
        if base.digest != self.base:
            raise SemlocError(
                f"{self._where}: belongs on version {self.base_version} ({self.base[:12]}), and map {base.map.name} is "
                f"version {base.version} ({base.digest[:12]}); apply it to that one"
            )
        names = list(base.records)
        with reading(self._where):
            removed, modified, ids, added = self._body
            order = self._head["order"]
            return MapDifference(
                self.base,
                self.base_version,
                self.target,
                dict(self._head["members"]),
                tuple(names[k] for k in accumulate(removed)),
                {names[k]: _upon(columns, base.records[names[k]]) for k, columns in _rows(modified).items()},
                dict(zip(map(str, ids), _rows(added).values(), strict=True)),
                order if order in (None, CANONICAL) else tuple(accumulate(order)),
                self.note,
            )


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
