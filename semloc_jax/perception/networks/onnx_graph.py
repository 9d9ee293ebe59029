"""A network written down as ONNX, without a library for it (room: perception; host).

In: a network that is called with an `OnnxGraph`. Out: a file of opset 13 for any batch and any size of pictures.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import ArrayLike, Float

from semloc_jax.perception.networks.operations import Operations
from semloc_jax.storage import write_bytes

_IR_VERSION, _OPSET = 8, 13
_FLOAT, _INT, _STRING, _INTS = 1, 2, 3, 7
"""Kinds: of a tensor's elements (float) and of attributes."""


def write_onnx(
    path: str | Path,
    network: Callable[[str, Operations], str],
    num_outputs: int,
    num_inputs: int = 3,
    output: str = "maps",
) -> None:
    """Write a network to a file: input `picture` [b 3 h w], red green blue in 0 ... 1; output [b n h' w'].

    Args:
        path: The file.
        network: Called with the name of the picture and the graph; returns the name of what comes out.
        num_outputs: Channels that come out.
        num_inputs: Channels that go in; the first three are the colours.
        output: Their name in the file.
    """
    graph = OnnxGraph()
    last = network("picture", graph)
    graph.node("Identity", [last], output)
    ports = _field(11, _port("picture", num_inputs)) + _field(12, _port(output, num_outputs))
    body = b"".join(graph.nodes) + _field(2, "network") + b"".join(graph.weights) + ports
    opset = _field(1, "") + _field(2, _OPSET)
    write_bytes(Path(path), _field(1, _IR_VERSION) + _field(2, "semloc_jax") + _field(7, body) + _field(8, opset))


class OnnxGraph:
    """The operations of `Operations` as nodes of a graph; features are names."""

    def __init__(self) -> None:
        self.nodes: list[bytes] = []
        self.weights: list[bytes] = []

    def dense(self, x: str, kernel: Float[ArrayLike, "k k c d"], bias: Float[ArrayLike, " d"]) -> str:
        return self._convolution(x, np.transpose(kernel, (3, 2, 0, 1)), bias, 1)

    def depthwise(self, x: str, kernel: Float[ArrayLike, "3 3 c"], bias: Float[ArrayLike, " c"]) -> str:
        return self._convolution(x, np.transpose(kernel, (2, 0, 1))[:, None], bias, len(bias))

    def relu(self, x: str) -> str:
        return self.node("Relu", [x])

    def add(self, x: str, y: str) -> str:
        return self.node("Add", [x, y])

    def to_depth(self, x: str, size: int) -> str:
        return self.node("SpaceToDepth", [x], blocksize=size)

    def from_depth(self, x: str, size: int) -> str:
        return self.node("DepthToSpace", [x], blocksize=size)

    def twice(self, x: str) -> str:
        scales = self._weight(np.array([1, 1, 2, 2]))
        return self.node("Resize", [x, "", scales], mode="linear", coordinate_transformation_mode="half_pixel")

    def node(self, kind: str, inputs: list[str], output: str = "", **attributes: int | str | tuple[int, ...]) -> str:
        """Add a node; returns the name of its output."""
        output = output or f"x{len(self.nodes)}"
        content = b"".join(_field(1, name) for name in inputs) + _field(2, output) + _field(4, kind)
        content += b"".join(_field(5, _attribute(name, value)) for name, value in attributes.items())
        self.nodes.append(_field(1, content))
        return output

    def _convolution(self, x: str, kernel: ArrayLike, bias: Float[ArrayLike, " d"], groups: int) -> str:
        size = kernel.shape[-1]
        inputs = [x, self._weight(kernel), self._weight(bias)]
        return self.node("Conv", inputs, kernel_shape=(size, size), pads=(size // 2,) * 4, group=groups)

    def _weight(self, values: ArrayLike) -> str:
        name, values = f"w{len(self.weights)}", np.ascontiguousarray(values, "<f4")
        dims = b"".join(_field(1, size) for size in values.shape)
        self.weights.append(_field(5, dims + _field(2, _FLOAT) + _field(8, name) + _field(9, values.tobytes())))
        return name


def _attribute(name: str, value: int | str | tuple[int, ...]) -> bytes:
    if isinstance(value, int):
        return _field(1, name) + _field(3, value) + _field(20, _INT)
    if isinstance(value, str):
        return _field(1, name) + _field(4, value) + _field(20, _STRING)
    return _field(1, name) + b"".join(_field(8, item) for item in value) + _field(20, _INTS)


def _port(name: str, channels: int) -> bytes:
    """A float tensor [b channels h w], all but its channels left open."""
    dims = (_field(2, "b"), _field(1, channels), _field(2, f"{name}_h"), _field(2, f"{name}_w"))
    shape = b"".join(_field(1, dim) for dim in dims)
    return _field(1, name) + _field(2, _field(1, _field(1, _FLOAT) + _field(2, shape)))


def _field(number: int, content: bytes | str | int) -> bytes:
    """One field of a protocol buffer: a number, or bytes with their length."""
    if isinstance(content, int):
        return _varint(number << 3) + _varint(content)
    content = content.encode() if isinstance(content, str) else content
    return _varint(number << 3 | 2) + _varint(len(content)) + content


def _varint(value: int) -> bytes:
    parts = bytearray()
    while value > 127:
        parts.append(value & 127 | 128)
        value >>= 7
    return bytes([*parts, value])
