"""ONNX files written by hand: one convolution whose scores are known (the protocol buffer of the format)."""

import struct

import numpy as np


def field(number, content):
    """One field of a protocol buffer: bytes, text, a message or an integer."""
    if isinstance(content, int):
        return varint(number << 3) + varint(content)
    content = content.encode() if isinstance(content, str) else content
    return varint(number << 3 | 2) + varint(len(content)) + content


def varint(value):
    parts = b""
    while value > 127:
        parts, value = parts + bytes([value & 127 | 128]), value >> 7
    return parts + bytes([value])


def tensor(name, array):
    dims = b"".join(field(1, size) for size in array.shape)
    return dims + field(2, 1) + field(8, name) + field(9, struct.pack(f"<{array.size}f", *array.ravel()))


def value_info(name, shape):
    """A float tensor; None in the shape is a free size."""
    dims = b"".join(field(1, field(1, size) if size is not None else field(2, f"d{i}")) for i, size in enumerate(shape))
    return field(1, name) + field(2, field(1, field(1, 1) + field(2, dims)))


def write_convolution(path, kernel, bias, in_size, out_size, batch=1):
    """An ONNX file with one convolution whose stride brings `in_size` to `out_size`; None sizes are free."""
    stride = in_size[0] // out_size[0] if in_size else kernel.shape[2]

    def integers(name, values):
        return field(5, field(1, name) + b"".join(field(8, value) for value in values) + field(20, 7))

    node = b"".join(field(1, name) for name in ("x", "w", "b")) + field(2, "y") + field(4, "Conv")
    node += integers("kernel_shape", kernel.shape[2:]) + integers("strides", (stride, stride))
    (in_w, in_h), (out_w, out_h) = in_size or (None, None), out_size or (None, None)
    graph = field(1, node) + field(2, "net") + field(5, tensor("w", kernel)) + field(5, tensor("b", bias))
    graph += field(11, value_info("x", (batch, 3, in_h, in_w)))
    graph += field(12, value_info("y", (batch, kernel.shape[0], out_h, out_w)))
    path.write_bytes(field(1, 8) + field(7, graph) + field(8, field(1, "") + field(2, 13)))
    return path


def red_or_blue(path, size=(48, 32), reduced=1, batch=1):
    """A network with three classes: 0 nothing, 1 red above half, 2 blue above half; red comes first in its input."""
    kernel = np.zeros((3, 3, reduced, reduced), np.float32)
    kernel[1, 0], kernel[2, 2] = 1.0 / reduced**2, 1.0 / reduced**2
    bias = np.array([0.0, -0.5, -0.5], np.float32)
    out_size = (size[0] // reduced, size[1] // reduced) if size else None
    return write_convolution(path, kernel, bias, size, out_size, batch)


def red_and_blue_apart(path, size=(640, 360)):
    """A network with two outputs of two classes each, as TwinLite: `da` says 1 where it is red, `ll` where blue."""
    nodes, weights, outputs = b"", b"", b""
    for name, channel in (("da", 0), ("ll", 2)):
        kernel = np.zeros((2, 3, 1, 1), np.float32)
        kernel[1, channel] = 1.0
        node = b"".join(field(1, part) for part in ("x", f"w_{name}", f"b_{name}")) + field(2, name) + field(4, "Conv")
        node += field(5, field(1, "kernel_shape") + field(8, 1) + field(8, 1) + field(20, 7))
        nodes += field(1, node)
        weights += field(5, tensor(f"w_{name}", kernel))
        weights += field(5, tensor(f"b_{name}", np.array([0.0, -0.5], np.float32)))
        outputs += field(12, value_info(name, (1, 2, size[1], size[0])))
    graph = nodes + field(2, "net") + weights + field(11, value_info("x", (1, 3, size[1], size[0]))) + outputs
    path.write_bytes(field(1, 8) + field(7, graph) + field(8, field(1, "") + field(2, 13)))
    return path
