"""Text form of protocol buffers, one field at the top at a time, without a schema (room: maps; host).

In: a path. Out: names and values of the fields; messages are dicts of lists, since any field may be repeated.
The file is mapped into memory and read once.
"""

import mmap
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from semloc_jax.errors import SemlocError
from semloc_jax.maps.io.possessive import ANY_TIMES

_DEEPEST = 32
_TOKEN = re.compile(
    rb'(?:\s++|#[^\n]*+)|(?P<text>"(?:[^"\\\n]++|\\.)' + ANY_TIMES + rb'"|\'(?:[^\'\\\n]++|\\.)' + ANY_TIMES + rb"\')"
    rb"|(?P<word>-?[A-Za-z_][\w.]*+|[-+]?\.?\d(?:[\w.]|(?<=[eE])[-+])"
    + ANY_TIMES
    + rb")|(?P<mark>[{}<>:\[\],;])|(?P<other>.)",
    re.DOTALL,
)
_CLOSING = {b"{": b"}", b"<": b">"}

Message = dict[str, list[Any]]
"""Values of each field: numbers and words as text, strings, messages."""


def stream_fields(path: Path) -> Iterator[tuple[str, Any]]:
    """Yields the name and the value of each field at the top of a file.

    Raises:
        SemlocError: not protobuf text, or nested deeper than any map.
    """
    with path.open("rb") as stream:
        try:
            content = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError:  # nothing can be mapped of an empty file
            return
    yield from _Parser(content, f"map {path.name}").fields(None, 0)


class _Parser:
    def __init__(self, content: mmap.mmap, where: str):
        self._where = where
        self._tokens = self._tokenised(content)

    def _tokenised(self, content: mmap.mmap) -> Iterator[tuple[str, bytes, int]]:
        for found in _TOKEN.finditer(content):
            kind = found.lastgroup
            if kind == "other":
                raise self._broken(f"{found.group()!r} at byte {found.start()}")
            if kind is not None:
                yield kind, found.group(), found.start()

    def _next(self) -> tuple[str, bytes, int]:
        token = next(self._tokens, None)
        if token is None:
            raise self._broken("it ends in the middle")
        return token

    def fields(self, closing: bytes | None, depth: int) -> Iterator[tuple[str, Any]]:
        """Yields the fields up to a closing bracket, or to the end of the file."""
        if depth > _DEEPEST:
            raise self._broken(f"nested deeper than {_DEEPEST}")
        while True:
            token = next(self._tokens, None) if closing is None else self._next()
            if token is None or token[1] == closing:
                return
            kind, text, at = token
            if text in (b",", b";"):
                continue
            if kind != "word":
                raise self._broken(f"{_shown(text)} at byte {at}, where a name is expected")
            name = text.decode("ascii", "replace")
            kind, text, at = self._next()
            if text == b":":
                kind, text, at = self._next()
            elif text not in _CLOSING:
                raise self._broken(f"{_shown(text)} at byte {at}, where a value of {name[:40]} is expected")
            for value in self._values(kind, text, at, depth):
                yield name, value

    def _values(self, kind: str, text: bytes, at: int, depth: int) -> Iterator[Any]:
        """Yields the value that begins with a token; those of a list one by one."""
        if text == b"[":
            while (token := self._next())[1] != b"]":
                if token[1] == b"[":
                    raise self._broken(f"a list in a list at byte {token[2]}")
                if token[1] != b",":
                    yield from self._values(*token, depth)
        elif text in _CLOSING:
            message: Message = {}
            for name, value in self.fields(_CLOSING[text], depth + 1):
                message.setdefault(name, []).append(value)
            yield message
        elif kind == "mark":
            raise self._broken(f"{_shown(text)} at byte {at}, where a value is expected")
        else:
            yield text[1:-1].decode("utf-8", "replace") if kind == "text" else text.decode("ascii", "replace")

    def _broken(self, why: str) -> SemlocError:
        return SemlocError(f"{self._where}: not an Apollo map in text form ({why}); is the file complete?")


def _shown(text: bytes) -> str:
    return repr(text[:20].decode("ascii", "replace"))
