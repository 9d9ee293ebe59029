"""Large JSON files, one item at a time (room: maps; host).

In: a path. Out: JsonFile, a mapping of the members at the top; tables and lists in it are parsed item by item while one
walks through them, and forgotten again. The file is mapped into memory, not read: what is not read costs nothing
but one look for its end. The items of a list are taken from the text as it comes; their ends are only looked for where
that fails, so what is refused, and how, does not depend on it.
"""

import codecs
import contextlib
import json
import mmap
import re
from collections.abc import Collection, ItemsView, Iterator, Mapping
from pathlib import Path
from typing import Any

from semloc_jax.errors import SemlocError
from semloc_jax.maps.io.possessive import ANY_TIMES

_DEEPEST = 64
_BLANKS = " \t\n\r"
_BLANK = re.compile(f"[{_BLANKS}]*").match
_WINDOW_BYTES = 1 << 14
"""Parsed at once; a feature has some hundred bytes. Of 64 kB the values are so many that Python's search for garbage,
which walks through all that is alive, takes as long as the parsing."""
_DECODER = json.JSONDecoder()
_STRING = rb'"(?:[^"\\]++|\\.)' + ANY_TIMES + rb'(?:"|\Z)'
_TOKEN = re.compile(_STRING + rb"|[\[\]{},]", re.DOTALL)
_PLAIN = rb'[^"\[\]{}]'
_BRACKETS = (b"{", b"[", b"}", b"]")
_POINTS = rb"\[(?:" + _PLAIN + rb"++|\[" + _PLAIN + rb"*+\])" + ANY_TIMES + rb"\]"


def _object_of(*parts: bytes) -> bytes:
    return rb"\{(?:" + rb"|".join((_PLAIN + rb"++", _STRING, *parts)) + rb")" + ANY_TIMES + rb"\}"


_FEATURE = _object_of(_POINTS, _object_of(_POINTS))
_PASSED = re.compile(rb"(?:" + rb"|".join((_PLAIN + rb"++", _STRING, _POINTS, _FEATURE)) + rb"){1,64}", re.DOTALL)
"""Lists of points, and objects of such lists and of objects with such lists, as features are, are passed in one step: a
map has few other brackets. Not all of a map at once: until a match ends, Python before 3.11.5 keeps its way back."""
_KEY = re.compile(rb'\s*("(?:[^"\\]++|\\.)' + ANY_TIMES + rb'")\s*:', re.DOTALL)
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
        text, position, is_first = self._file.text, self._start + 1, True
        while True:
            values, position, is_last = _window(text, position)
            yield from values
            if is_last:
                return
            if values:
                is_first = False
                continue
            # Longer than a window, broken, or the end of an empty list: its end is looked for.
            found = next(_parts_from(text, position, b"]", self._file.where, is_first), None)
            if found is None:
                return
            yield self._file.parsed(*found)
            if text[found[1] : found[1] + 1] == b"]":
                return
            position, is_first = found[1] + 1, False

    def __len__(self) -> int:
        return sum(1 for _ in _parts(self._file.text, self._start, self._file.where))

    def __contains__(self, item: object) -> bool:
        return any(item == other for other in self)


def _window(text: mmap.mmap | bytes, start: int) -> tuple[list[Any], int, bool]:
    """Returns the items of an array that begin at `start` and are whole within a window, the place behind them, and
    whether the bracket of the array follows there; no items where the first is not whole, or not valid."""
    piece = text[start : start + _WINDOW_BYTES]
    try:
        words, _ = codecs.utf_8_decode(piece, "surrogatepass", False)
    except UnicodeDecodeError as error:
        words = piece[: error.start].decode("utf-8", "surrogatepass")
    values: list[Any] = []
    begin, is_last = 0, False
    with contextlib.suppress(StopIteration, ValueError, RecursionError, IndexError):
        while not is_last:
            value, end = _DECODER.scan_once(words, _BLANK(words, begin).end())
            end = _BLANK(words, end).end()
            is_last = words[end] == "]"
            if not is_last and words[end] != ",":
                break
            values.append(value)
            begin = end + 1
    return values, start + len(words[:begin].encode("utf-8", "surrogatepass")), is_last


def _parts(text: mmap.mmap | bytes, start: int, where: str) -> Iterator[tuple[int, int]]:
    """Returns where each item of the object or array at `start` begins and ends; the last one ends at its bracket."""
    closing = {b"{": b"}", b"[": b"]"}[text[start : start + 1]]
    return _parts_from(text, start + 1, closing, where, True)


def _parts_from(
    text: mmap.mmap | bytes, begin: int, closing: bytes, where: str, is_first: bool
) -> Iterator[tuple[int, int]]:
    """Yields the rest of them, of which the next one begins at `begin`."""
    position = begin
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
        while (passed := _PASSED.match(text, position)) is not None:
            position = passed.end()
        bracket = text[position : position + 1]
        if bracket not in _BRACKETS:
            raise _broken(where, "it ends in the middle")
        position += 1
        depth += 1 if bracket in _BRACKETS[:2] else -1
        if depth == 0:
            return position
        if depth > _DEEPEST:
            raise _broken(where, f"nested deeper than {_DEEPEST}")


def _broken(where: str, why: str) -> SemlocError:
    return SemlocError(f"{where}: not valid JSON ({why}); is the file complete?")
