"""Bounds of a ramp and of its slope over windows of pixels (room: analysis; JAX).

In: one level of the cost maps as the solver samples it. Out: RampBounds: tables from which the range of value and slope
over any window is one lookup each.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Int16

from semloc_jax.analysis.intervals import Interval
from semloc_jax.residuals.texture import RampTexture

_UNIT = 127.0
"""Steps of the texture from 0 to 1."""
_SIZES = 6
"""Windows of 1, 2, 4, 8, 16 and 32 texels; what does not fit into the largest has the bounds of the whole ramp."""


class RampBounds(NamedTuple):
    """Smallest and largest value and slopes over the window of 2^k texels that starts at a texel.

    Each table is `int16[k + 1, image, row, column]`, values in steps of the texture; the last k holds for all windows.
    """

    value: tuple[Int16[Array, "k image h w"], Int16[Array, "k image h w"]]
    slope_u: tuple[Int16[Array, "k image h w"], Int16[Array, "k image h w"]]
    slope_v: tuple[Int16[Array, "k image h w"], Int16[Array, "k image h w"]]
    stride: Float[Array, ""]

    def over(self, image: Int[Array, "*n"], u: Interval, v: Interval) -> tuple[Interval, Interval, Interval]:
        """Intervals of the value and of its slopes along u and v [1/px] over boxes of pixels of the full mask.

        Args:
            image: Camera and channel of each box, camera x channels + channel.
            u, v: The boxes [px]; what is not finite stands for the whole image.
        """
        _, _, height, width = self.value[0].shape
        (left, right, out_u), (top, bottom, out_v) = (
            self._texels(ends, size) for ends, size in ((u, width), (v, height))
        )
        extent = jnp.maximum(right - left, bottom - top) + 1
        k = jnp.sum(extent[..., None] > 2 ** np.arange(_SIZES), axis=-1)
        found = []
        for table, scale, is_clamped in (
            (self.value, 1 / _UNIT, None),
            (self.slope_u, 1 / (_UNIT * self.stride), out_u),
            (self.slope_v, 1 / (_UNIT * self.stride), out_v),
        ):
            low, high = (end[k, image, top, left].astype(u.low.dtype) * scale for end in table)
            if is_clamped is not None:  # beyond the border the ramp goes on as a constant
                low, high = (
                    jnp.where(is_clamped, pick(end, 0.0), end)
                    for pick, end in ((jnp.minimum, low), (jnp.maximum, high))
                )
            found.append(Interval(low, high))
        return tuple(found)

    def _texels(self, ends: Interval, size: int) -> tuple[Array, Array, Array]:
        """First and last texel of an interval of pixels, and whether it reaches beyond the border."""
        low, high = (
            (jnp.nan_to_num(e, nan=far, posinf=1e6, neginf=-1e6) + 0.5) / self.stride - 0.5
            for e, far in zip(ends, (-1e6, 1e6), strict=True)
        )
        first, last = (jnp.clip(jnp.floor(end), 0, size - 1).astype(jnp.int32) for end in (low, high))
        return first, last, (low < 0) | (high > size - 1e-3)


def ramp_bounds(texture: RampTexture, num_cameras: int) -> RampBounds:
    """The tables of one level of the cost maps."""
    height, width, channels = int(texture.height), int(texture.width), texture.num_channels
    start, count = int(texture.start), num_cameras * channels * height * width
    texels = np.asarray(texture.texels[start : start + count])
    texels = np.pad(texels, (0, count - len(texels)), mode="edge").reshape(-1, height, width)[:, :-1, :-1]
    a, b, c, d = (((texels >> np.uint32(shift)) & np.uint32(255)).astype(np.int16) for shift in (0, 8, 16, 24))
    zero = np.int16(_UNIT)
    ranges = [
        (np.minimum.reduce([a, b, c, d]) - zero, np.maximum.reduce([a, b, c, d]) - zero),
        (np.minimum(b - a, d - c), np.maximum(b - a, d - c)),
        (np.minimum(c - a, d - b), np.maximum(c - a, d - b)),
    ]
    tables = [
        tuple(jnp.asarray(_windows(end, best)) for end, best in zip(pair, (np.minimum, np.maximum), strict=True))
        for pair in ranges
    ]
    return RampBounds(*tables, texture.stride)


def _windows(cells: np.ndarray, best: np.ufunc) -> np.ndarray:
    """The extreme over windows of 1, 2, 4 ... texels that start at each texel, and over everything."""
    tables = [cells]
    for k in range(1, _SIZES):
        half, last = 2 ** (k - 1), tables[-1]
        down = np.pad(last, ((0, 0), (0, half), (0, 0)), mode="edge")[:, half:]
        both = best(last, down)
        right = np.pad(both, ((0, 0), (0, 0), (0, half)), mode="edge")[:, :, half:]
        tables.append(best(both, right))
    tables.append(np.full_like(cells, best.reduce(cells, axis=None)))
    return np.stack(tables)
