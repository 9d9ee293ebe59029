"""What an ONNX file says of its inputs and outputs, without a library that reads it (room: perception; host).

In: the file. Out: names and shapes. OpenCV runs networks and does not tell them.
Only the few fields of the protocol buffer on the way to them are looked at; weights are skipped.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

_GRAPH, _INITIALIZER, _INPUT, _OUTPUT = 7, 5, 11, 12
_NAME, _TYPE, _TENSOR, _SHAPE, _DIM, _DIM_VALUE = 1, 2, 1, 2, 1, 1
_TENSOR_NAME = 8
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5


class Port(NamedTuple):
    """One input or output of a network."""

    name: str
    shape: tuple[int | None, ...]
    """None where the file leaves a size open."""


class OnnxHeader(NamedTuple):
    """Inputs and outputs in the order of the file; weights are no inputs."""

    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]


def read_onnx_header(path: Path) -> OnnxHeader | None:
    """The header of a file; None where it is no ONNX file that this reader understands."""
    try:
        graph = next((value for number, value in _fields(path.read_bytes()) if number == _GRAPH), None)
        if not isinstance(graph, bytes):
            return None
        parts = [(number, value) for number, value in _fields(graph) if isinstance(value, bytes)]
        weights = {_text(value, _TENSOR_NAME) for number, value in parts if number == _INITIALIZER}
        inputs = tuple(
            port for number, value in parts if number == _INPUT and (port := _port(value)).name not in weights
        )
        return OnnxHeader(inputs, tuple(_port(value) for number, value in parts if number == _OUTPUT))
    except (OSError, IndexError, ValueError, UnicodeDecodeError):
        return None


def _port(message: bytes) -> Port:
    found = message
    for wanted in (_TYPE, _TENSOR, _SHAPE):
        found = next((v for n, v in _fields(found) if n == wanted and isinstance(v, bytes)), b"")
    shape: list[int | None] = []
    for number, dimension in _fields(found):
        if number == _DIM and isinstance(dimension, bytes):
            sizes = [v for n, v in _fields(dimension) if n == _DIM_VALUE and isinstance(v, int)]
            shape.append(sizes[0] if sizes and sizes[0] > 0 else None)
    return Port(_text(message, _NAME), tuple(shape))


def _text(message: bytes, number: int) -> str:
    return next((v.decode() for n, v in _fields(message) if n == number and isinstance(v, bytes)), "")


def _fields(message: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Number and value of each field of a message."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        number, kind = key >> 3, key & 7
        if kind == _VARINT:
            value, at = _varint(message, at)
            yield number, value
        elif kind == _BYTES:
            length, at = _varint(message, at)
            if at + length > len(message):
                raise ValueError("a field ends behind its message")
            yield number, message[at : at + length]
            at += length
        elif kind in (_FIXED64, _FIXED32):
            at += 8 if kind == _FIXED64 else 4
        else:
            raise ValueError(f"unknown kind of field {kind}")


def _varint(message: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = message[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return value, at
        if shift > 63:
            raise ValueError("a number of more than 64 bits")
