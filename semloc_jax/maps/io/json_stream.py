"""Large JSON files, one item at a time (room: maps; host).

In: a path. Out: JsonFile, a mapping of the members at the top; tables and lists in it are parsed item by item while one
walks through them, and forgotten again. The file is mapped into memory, not read: what is not read costs nothing
but one look for its end.
"""

import json
import mmap
import re
from collections.abc import Collection, ItemsView, Iterator, Mapping
from pathlib import Path
from typing import Any

from semloc_jax.errors import SemlocError

_DEEPEST = 64
_BLANKS = " \t\n\r"
_DECODER = json.JSONDecoder()
_STRING = rb'"(?:[^"\\]++|\\.)*+(?:"|\Z)'
_TOKEN = re.compile(_STRING + rb"|[\[\]{},]", re.DOTALL)
_PLAIN = rb'[^"\[\]{}]'
_POINTS = rb"\[(?:" + _PLAIN + rb"++|\[" + _PLAIN + rb"*+\])*+\]"
_LEAF = rb"\{(?:" + _PLAIN + rb"++|" + _STRING + rb")*+\}"
_TO_BRACKET = re.compile(
    rb"(?:" + rb"|".join((_PLAIN + rb"++", _STRING, _POINTS, _LEAF)) + rb")*+([\[\]{}])", re.DOTALL
)
"""Lists of points and objects that hold no other are passed in one step: a map has few other brackets."""
_KEY = re.compile(rb'\s*("(?:[^"\\]++|\\.)*+")\s*:', re.DOTALL)
_START = re.compile(rb"\s*")
_FILE_START = re.compile(rb"(?:\xef\xbb\xbf)?\s*")
"""Some programs put a mark of the encoding first."""


class JsonFile(Mapping[str, Any]):
    """The object at the top of a JSON file; its members that are tables or lists are walked through, not held."""

    def __init__(self, path: Path):
        """Finds the members of a file.

        Raises:
            SemlocError: not JSON, or no object at its top.
        """
        self.where = f"map {path.name}"
        with path.open("rb") as stream:
            try:
                self.text: mmap.mmap | bytes = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
            except ValueError:  # nothing can be mapped of an empty file
                self.text = b""
        self._members: dict[str, tuple[int, int]] = {}
        start = _FILE_START.match(self.text).end()
        if self.text[start : start + 1] != b"{":
            raise _broken(self.where, "no object at its top")
        end = start
        for begin, end in _parts(self.text, start, self.where):
            key, value = self.split(begin, end)
            self._members[key] = (value, end)
        if self._members and self.text[end + 1 :].strip():
            raise _broken(self.where, "more than one object")

    def __getitem__(self, key: str) -> Any:
        start, end = self._members[key]
        start = _START.match(self.text, start).end()
        kinds = {b"{": JsonTable, b"[": JsonList}
        kind = kinds.get(self.text[start : start + 1])
        return self.parsed(start, end) if kind is None else kind(self, start)

    def whole(self, key: str) -> Any:
        """Returns the value of a member, all of it."""
        return self.parsed(*self._members[key])

    def __iter__(self) -> Iterator[str]:
        return iter(self._members)

    def __len__(self) -> int:
        return len(self._members)

    def split(self, start: int, end: int) -> tuple[str, int]:
        """Returns the key of a member and where its value begins."""
        found = _KEY.match(self.text, start, end)
        if found is None:
            raise _broken(self.where, f"a member without a name at byte {start}")
        return self.parsed(*found.span(1)), found.end()

    def parsed(self, start: int, end: int) -> Any:
        """Returns the value of a part of the file."""
        try:
            # What `json.loads` does, without its guess of the encoding for each of 100,000 items.
            text = self.text[start:end].decode("utf-8", "surrogatepass").strip(_BLANKS)
            value, stop = _DECODER.raw_decode(text)
            if stop != len(text):
                raise ValueError("more than one value")
            return value
        except (ValueError, RecursionError) as error:
            raise _broken(self.where, f"{str(error)[:80]}, from byte {start}") from error


class JsonTable(Mapping[str, Any]):
    """An object in a JSON file; `items` parses one value after another."""

    def __init__(self, file: JsonFile, start: int):
        self._file, self._start = file, start

    def items(self) -> "_Items":
        """Returns keys and values in the order of the file, parsed while one walks through them."""
        return _Items(self)

    def walk(self) -> Iterator[tuple[str, Any]]:
        """Yields keys and values in the order of the file."""
        for start, end in _parts(self._file.text, self._start, self._file.where):
            key, value = self._file.split(start, end)
            yield key, self._file.parsed(value, end)

    def __getitem__(self, key: str) -> Any:
        for other, value in self.walk():
            if other == key:
                return value
        raise KeyError(key)

    def __iter__(self) -> Iterator[str]:
        return (key for key, _ in self.walk())

    def __len__(self) -> int:
        return sum(1 for _ in _parts(self._file.text, self._start, self._file.where))


class _Items(ItemsView[str, Any]):
    def __iter__(self) -> Iterator[tuple[str, Any]]:
        return self._mapping.walk()


class JsonList(Collection[Any]):
    """An array in a JSON file, parsed item by item while one walks through it."""

    def __init__(self, file: JsonFile, start: int):
        self._file, self._start = file, start

    def __iter__(self) -> Iterator[Any]:
        for start, end in _parts(self._file.text, self._start, self._file.where):
            yield self._file.parsed(start, end)

    def __len__(self) -> int:
        return sum(1 for _ in _parts(self._file.text, self._start, self._file.where))

    def __contains__(self, item: object) -> bool:
        return any(item == other for other in self)


def _parts(text: mmap.mmap | bytes, start: int, where: str) -> Iterator[tuple[int, int]]:
    """Yields where each item of the object or array at `start` begins and ends; the last one ends at its bracket."""
    closing = {b"{": b"}", b"[": b"]"}[text[start : start + 1]]
    begin = position = start + 1
    is_first = True
    while True:
        found = _TOKEN.search(text, position)
        if found is None:
            raise _broken(where, "it ends in the middle")
        token, position = found.group()[:1], found.end()
        if token in b"{[":
            position = _after(text, found.start(), where)
        elif token == b"," or token == closing:
            if not (is_first and token == closing and not text[begin : found.start()].strip()):
                yield begin, found.start()
            if token == closing:
                return
            begin, is_first = position, False
        elif token != b'"':
            raise _broken(where, f"brackets that do not match at byte {found.start()}")


def _after(text: mmap.mmap | bytes, start: int, where: str) -> int:
    """Returns the place after the bracket that closes the one at `start`."""
    depth, position = 1, start + 1
    while True:
        found = _TO_BRACKET.match(text, position)
        if found is None:
            raise _broken(where, "it ends in the middle")
        position = found.end()
        depth += 1 if found.group(1) in b"{[" else -1
        if depth == 0:
            return position
        if depth > _DEEPEST:
            raise _broken(where, f"nested deeper than {_DEEPEST}")


def _broken(where: str, why: str) -> SemlocError:
    return SemlocError(f"{where}: not valid JSON ({why}); is the file complete?")
