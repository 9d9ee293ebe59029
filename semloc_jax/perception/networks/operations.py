"""What layers are made of, in JAX; an ONNX graph offers the same operations (room: perception; pure JAX).

In: one picture of features [h w c]. Out: another. A network is written once, against these operations: called with
`JAX` it computes, called with an `OnnxGraph` it writes itself down.

Cell (i, j) of features at stride s is centred on pixel (s j + (s - 1) / 2, s i + (s - 1) / 2) of the picture, at every
stride: only operations that keep this are here, so none of them strides or resizes by whole cells.
"""

from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Features = Any
"""float[h w c] in JAX; a name in an ONNX graph."""


@runtime_checkable
class Operations(Protocol):
    """What a network may do with features."""

    def dense(self, x: Features, kernel: Float[Array, "k k c d"], bias: Float[Array, " d"]) -> Features:
        """Convolution with zeros beyond the border."""

    def depthwise(self, x: Features, kernel: Float[Array, "3 3 c"], bias: Float[Array, " c"]) -> Features:
        """Convolution of each channel by itself, with zeros beyond the border."""

    def relu(self, x: Features) -> Features:
        """Nothing below zero."""

    def add(self, x: Features, y: Features) -> Features:
        """Sum."""

    def to_depth(self, x: Features, size: int) -> Features:
        """Blocks of size x size cells as channels: rows first, then columns, then the channels that were there."""

    def from_depth(self, x: Features, size: int) -> Features:
        """The way back: each cell becomes size x size cells."""

    def twice(self, x: Features) -> Features:
        """Twice as many rows and columns, bilinear; what lies beyond the border is as at the border."""


class _Jax:
    def dense(self, x: Features, kernel: Float[Array, "k k c d"], bias: Float[Array, " d"]) -> Features:
        if kernel.shape[0] == 1:
            return x @ kernel[0, 0] + bias
        numbers = ("NHWC", "HWIO", "NHWC")
        return jax.lax.conv_general_dilated(x[None], kernel, (1, 1), "SAME", dimension_numbers=numbers)[0] + bias

    def depthwise(self, x: Features, kernel: Float[Array, "3 3 c"], bias: Float[Array, " c"]) -> Features:
        # Nine shifted products: XLA's grouped convolution takes twenty times as long on a CPU.
        height, width, _ = x.shape
        padded = jnp.pad(x, ((1, 1), (1, 1), (0, 0)))
        parts = [padded[i : i + height, j : j + width] * kernel[i, j] for i in range(3) for j in range(3)]
        return sum(parts, bias)

    def relu(self, x: Features) -> Features:
        return jax.nn.relu(x)

    def add(self, x: Features, y: Features) -> Features:
        return x + y

    def to_depth(self, x: Features, size: int) -> Features:
        height, width, channels = x.shape
        blocks = x.reshape(height // size, size, width // size, size, channels)
        return blocks.transpose(0, 2, 1, 3, 4).reshape(height // size, width // size, size * size * channels)

    def from_depth(self, x: Features, size: int) -> Features:
        height, width, channels = x.shape
        blocks = x.reshape(height, width, size, size, channels // (size * size))
        return blocks.transpose(0, 2, 1, 3, 4).reshape(height * size, width * size, -1)

    def twice(self, x: Features) -> Features:
        return _twice_along(_twice_along(x, 0), 1)


def _twice_along(x: Float[Array, "h w c"], axis: int) -> Float[Array, "_h _w c"]:
    """Each cell becomes two, centred a quarter of a cell before and behind it."""
    size = x.shape[axis]
    around = jnp.pad(x, [(1, 1) if k == axis else (0, 0) for k in range(x.ndim)], mode="edge")
    before, behind = (jax.lax.slice_in_dim(around, k, k + size, axis=axis) for k in (0, 2))
    pair = jnp.stack([0.75 * x + 0.25 * before, 0.75 * x + 0.25 * behind], axis + 1)
    return pair.reshape(*(2 * n if k == axis else n for k, n in enumerate(x.shape)))


JAX: Operations = _Jax()
