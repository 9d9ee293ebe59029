"""Pieces of a large XML file, one complete element at a time (room: maps; host).

In: a path and the names of the elements that are wanted. Out: those elements; each is released after use.
Document types, and with them entity bombs, are refused; so is nesting that no map has.
"""

from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError, TreeBuilder, XMLParser

import numpy as np

from semloc_jax.errors import SemlocError

_CHUNK_BYTES = 1 << 16
_DEEPEST = 64


class _Collector:
    """Receives the events of the parser; builds a tree only inside wanted elements."""

    def __init__(self, name: str, root: str, wanted: frozenset[str]):
        self.ready: list[Element] = []
        self._name, self._root, self._wanted = name, root, wanted
        self._builder: TreeBuilder | None = None
        self._depth = 0
        self._built_from = 0

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise SemlocError(f"map {self._name}: declares a document type; expected plain XML: remove the <!DOCTYPE>")

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        tag = tag.rpartition("}")[2]
        if self._depth == 0 and tag != self._root:
            raise SemlocError(f"map {self._name}: root element <{tag[:40]}>; expected <{self._root}>")
        self._depth += 1
        if self._depth > _DEEPEST:
            raise SemlocError(f"map {self._name}: elements nested deeper than {_DEEPEST}; is it a map?")
        if self._builder is None and tag in self._wanted:
            self._builder, self._built_from = TreeBuilder(), self._depth
        if self._builder is not None:
            self._builder.start(tag, attributes)

    def data(self, text: str) -> None:
        if self._builder is not None:
            self._builder.data(text)

    def end(self, tag: str) -> None:
        if self._builder is not None:
            self._builder.end(tag.rpartition("}")[2])
            if self._depth == self._built_from:
                self.ready.append(self._builder.close())
                self._builder = None
        self._depth -= 1

    def close(self) -> None:
        return None


def stream_elements(path: Path, root: str, wanted: frozenset[str]) -> Iterator[Element]:
    """Yields the wanted elements of an XML file in its order, each complete; names are without name spaces.

    Args:
        path: the file.
        root: name that the root element must have.
        wanted: names of the elements to yield.

    Raises:
        SemlocError: not well-formed, another root, a document type, or nested too deeply.
    """
    collector = _Collector(path.name, root, wanted)
    parser = XMLParser(target=collector)
    try:
        with path.open("rb") as stream:
            while chunk := stream.read(_CHUNK_BYTES):
                parser.feed(chunk)
                yield from collector.ready
                collector.ready.clear()
        parser.close()
    except (ParseError, ValueError, LookupError) as error:
        raise SemlocError(f"map {path.name}: not well-formed XML ({error}); is the file complete?") from error
    yield from collector.ready


def number(element: Element, key: str, where: str, default: float | None = 0.0, limit: float = 1e9) -> float:
    """Returns a finite number from an attribute.

    Args:
        element: XML element.
        key: name of the attribute.
        where: prefix of the message.
        default: value where the attribute is absent or empty; None requires it.
        limit: largest magnitude allowed.

    Raises:
        SemlocError: absent, no number, not finite or too large.
    """
    text = element.get(key, "").strip()
    if not text and default is not None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not abs(value) <= limit:
        raise SemlocError(f"{where}: <{element.tag}> has {key} = '{text[:40]}'; expected a number within {limit:g}")
    return value


def numbers(element: Element, keys: str, where: str, limit: float = 1e9) -> list[float]:
    """Returns the numbers of several attributes, named in one word each of `keys`; absent ones are 0."""
    return [number(element, key, where, 0.0, limit) for key in keys.split()]
