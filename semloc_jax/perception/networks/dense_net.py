"""A network that says something of every cell of a picture (room: perception; pure JAX).

In: a picture float[h w 3] of red, green, blue in 0 ... 1, sides multiples of `step_px`. Out: float[h/s w/s n].
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from semloc_jax.errors import SemlocError
from semloc_jax.perception.networks.layers import Convolution, Residual
from semloc_jax.perception.networks.operations import JAX, Features, Operations

STRIDE = 4
"""Pixels of the picture in one cell of what comes out."""


@dataclass(frozen=True)
class DenseNetConfig:
    """Size of a network; one entry for each stride 4, 8, 16 ..."""

    num_outputs: int = 1
    detail: int = 1
    """Cells on each side that what comes out has in one cell of stride 4: 1, 2 or 4, for strides of 4, 2 or 1."""
    num_inputs: int = 3
    """Channels of the picture: colours, and what another network says of it."""
    num_channels: tuple[int, ...] = (32, 64, 96, 128)
    num_blocks: tuple[int, ...] = (1, 1, 2, 2)
    """Residual blocks of two layers each."""
    num_dense: int = 2
    """So many of the finest strides have dense blocks, the others separable ones."""
    is_end_dense: bool = True
    """Whether the last block, at stride 4, is dense; a separable one takes a third of its time."""

    def __post_init__(self) -> None:
        counts = (self.num_outputs, self.num_inputs, *self.num_channels)
        if len(self.num_channels) != len(self.num_blocks) or min(counts) < 1 or self.detail not in (1, 2, 4):
            raise SemlocError(
                f"network: {self}; expected channels and blocks for the same strides, all at least 1, detail 1, 2 or 4"
            )

    @property
    def step_px(self) -> int:
        """Sides of pictures are multiples of this."""
        return STRIDE * 2 ** (len(self.num_channels) - 1)


class DenseNet(eqx.Module):
    """Down to the coarsest stride and up again to a quarter of the resolution; ways across add what was finer."""

    into: tuple[Convolution, ...]
    """Channels of each stride from the blocks of cells of the finer one, or from the pixels."""
    blocks: tuple[tuple[Residual, ...], ...]
    up: tuple[Convolution, ...]
    """Channels of the finer stride from those of the coarser, coarsest first."""
    merged: Residual
    head: Convolution
    detail: int = eqx.field(static=True)

    @classmethod
    def create(cls, key: PRNGKeyArray, config: DenseNetConfig) -> "DenseNet":
        """Before it has learned anything: its outputs are zero everywhere."""
        num = config.num_channels
        keys = iter(jax.random.split(key, 2 * len(num) + sum(config.num_blocks) + 1))
        before = (config.num_inputs * STRIDE * STRIDE, *(4 * n for n in num[:-1]))
        into = tuple(Convolution.create(next(keys), 1, b, n) for b, n in zip(before, num, strict=True))
        blocks = tuple(
            tuple(Residual.create(next(keys), n, level < config.num_dense) for _ in range(config.num_blocks[level]))
            for level, n in enumerate(num)
        )
        up = tuple(Convolution.create(next(keys), 1, num[k], num[k - 1], gain=1.0) for k in range(len(num) - 1, 0, -1))
        merged = Residual.create(next(keys), num[0], config.is_end_dense)
        num_last = config.num_outputs * config.detail**2
        head = Convolution.create(next(keys), 1, num[0], num_last, gain=0.0)
        return cls(into, blocks, up, merged, head, config.detail)

    def __call__(self, picture: Features, ops: Operations = JAX) -> Features:
        """What it says of each cell, float[h/s w/s n] with s = 4 / detail; with an ONNX graph, the name of it."""
        x, levels = picture, []
        for k, (into, blocks) in enumerate(zip(self.into, self.blocks, strict=True)):
            x = ops.relu(into(ops.to_depth(x, STRIDE if k == 0 else 2), ops))
            for block in blocks:
                x = block(x, ops)
            levels.append(x)
        for up, finer in zip(self.up, reversed(levels[:-1]), strict=True):
            x = ops.relu(ops.add(finer, ops.twice(up(x, ops))))
        said = self.head(self.merged(x, ops), ops)
        return said if self.detail == 1 else ops.from_depth(said, self.detail)


def filled_up(picture: Float[Array, "h w c"], step_px: int) -> Float[Array, "_h _w c"]:
    """The picture with its last row and column repeated until its sides are multiples of `step_px`."""
    height, width, _ = picture.shape
    return jnp.pad(picture, ((0, -height % step_px), (0, -width % step_px), (0, 0)), mode="edge")
