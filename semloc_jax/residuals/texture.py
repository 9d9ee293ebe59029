"""Cost maps as textures for fast bilinear lookup (room: residuals; pure JAX).

In: CostMaps. Out: RampTextures, one RampTexture for each level, and `lookup`, the one bilinear sampler of the package.
The four taps of a pixel lie side by side in one 32-bit word: one memory access for each sample instead of four.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt8, UInt32
from numpy.typing import DTypeLike

from semloc_jax.host import native_status
from semloc_jax.residuals.forward_only import forward_only
from semloc_jax.structs import CostMaps

_ZERO = 127.0  # the byte that stands for 0; bytes 0 .. 254 span [-1, 1]


class RampTexture(eqx.Module):
    """One level of the cost maps of all cameras, quantised to 1/127 of the ramp.

    The shape of the level is data, not type: one compiled solver serves every level.
    """

    texels: UInt32[Array, " texel"]
    """All levels, one after another. Bytes v(x, y), v(x+1, y), v(x, y+1), v(x+1, y+1) from low to high."""
    start: Int[Array, ""]
    """Index of the first texel of the level; then ((cam C + channel) H + y) W + x."""
    height: Int[Array, ""]
    width: Int[Array, ""]
    stride: Float[Array, ""]
    """Pixels of the full mask in one pixel of the level."""
    ramp_px: Float[Array, ""]
    num_channels: int = eqx.field(static=True)

    def image_index(self, camera: Int[Array, ""], channel: Int[Array, "*n"]) -> Int[Array, "*n"]:
        """Index of the first texel of a camera's channel."""
        return self.start + (camera * self.num_channels + channel) * (self.height * self.width)


class RampTextures(eqx.Module):
    """All levels of the cost maps, coarsest first; leaves other than `texels` have a leading level axis."""

    texels: UInt32[Array, " texel"]
    start: Int[Array, " level"]
    height: Int[Array, " level"]
    width: Int[Array, " level"]
    stride: Float[Array, " level"]
    ramp_px: Float[Array, " level"]
    num_channels: int = eqx.field(static=True)

    def level(self, index: Int[Array, ""] | int) -> RampTexture:
        """One level; the index may be traced."""
        columns = (self.start, self.height, self.width, self.stride, self.ramp_px)
        return RampTexture(self.texels, *(column[index] for column in columns), self.num_channels)


def pack(maps: CostMaps, dtype: DTypeLike = jnp.float32) -> RampTextures:
    """The textures of cost maps; `dtype` is the float type of lookups."""
    maps = forward_only("pack (cost maps as textures of one byte a pixel)", maps)
    starts = np.cumsum([0, *(ramp.size for ramp in maps.ramps)])
    texels = _packed_natively(maps) if _is_native(maps) else _packed(maps, starts)
    return RampTextures(
        texels=texels,
        start=jnp.asarray(starts[:-1], jnp.int32),
        height=jnp.asarray([ramp.shape[2] for ramp in maps.ramps], jnp.int32),
        width=jnp.asarray([ramp.shape[3] for ramp in maps.ramps], jnp.int32),
        stride=jnp.asarray(maps.stride, dtype),
        ramp_px=jnp.asarray(maps.ramp_px, dtype),
        num_channels=maps.ramps[0].shape[1],
    )


def _is_native(maps: CostMaps) -> bool:
    is_known = all(ramp.dtype in (jnp.float32, jnp.uint8) for ramp in maps.ramps)
    return is_known and jax.default_backend() == "cpu" and native_status().available


def _packed_natively(maps: CostMaps) -> UInt32[Array, " texel"]:
    size = sum(ramp.size for ramp in maps.ramps)
    return jax.ffi.ffi_call("semloc_pack", jax.ShapeDtypeStruct((size,), jnp.uint32))(*maps.ramps)


def _packed(maps: CostMaps, starts: np.ndarray) -> UInt32[Array, " texel"]:
    texels = jnp.zeros(starts[-1], jnp.uint32)
    for ramp, start in zip(maps.ramps, starts, strict=False):
        # Written in place: XLA on CPU fuses a concatenation into scalar code, six times slower.
        texels = jax.lax.dynamic_update_slice(texels, _quads(ramp), (start,))
    return texels


def _quads(ramp: Float[Array, "cam channel h w"] | UInt8[Array, "cam channel h w"]) -> UInt32[Array, " texel"]:
    """Texels of all images of a level in one row, without the last row and pixel of the last image.

    The right and lower neighbour are taken from the flat array: what wraps around in the last column and row of an
    image is never the texel of a pixel, since `locate` stays a pixel away from them.
    """
    width = ramp.shape[3]
    flat = ramp.reshape(-1)
    byte = flat if flat.dtype == jnp.uint8 else jnp.round((jnp.clip(flat, -1, 1) + 1) * _ZERO)
    byte = byte.astype(jnp.int32)
    quad = byte[: -width - 1] | byte[1:-width] << 8 | byte[width:-1] << 16 | byte[width + 1 :] << 24
    return quad.astype(jnp.uint32)


class Texel(eqx.Module):
    """Where a pixel falls in a texture: the index inside one image and the two fractions."""

    index: Int[Array, "*n"]
    fu: Float[Array, "*n"]
    fv: Float[Array, "*n"]


def locate(texture: RampTexture, u: Float[Array, "*n"], v: Float[Array, "*n"]) -> Texel:
    """Texel of full-mask pixels (u, v); pixels outside the image fall on its border."""
    scale = 1 / texture.stride
    # The clip keeps the right tap inside; NaN would survive it and index wildly, so it is sent to the border first.
    x = jnp.clip(jnp.nan_to_num((u + 0.5) * scale - 0.5), 0, texture.width - 1.001)
    y = jnp.clip(jnp.nan_to_num((v + 0.5) * scale - 0.5), 0, texture.height - 1.001)
    column, row = x.astype(jnp.int32), y.astype(jnp.int32)
    return Texel(row * texture.width + column, x - column, y - row)


def fetch(texture: RampTexture, image_index: Int[Array, "*n"], texel: Texel) -> UInt32[Array, "*n"]:
    """The four taps of each texel, packed."""
    return texture.texels.at[image_index + texel.index].get(mode="promise_in_bounds")


def blend(
    texture: RampTexture, taps: UInt32[Array, "*n"], texel: Texel
) -> tuple[Float[Array, "*n"], Float[Array, "*n"], Float[Array, "*n"]]:
    """Bilinear value in [-1, 1] and its gradient [1 / px of the full mask] from the packed taps."""
    dtype = texel.fu.dtype
    # Through int32: AVX converts signed integers in one instruction, unsigned ones in many.
    a, b, c, d = ((taps >> shift & 255).astype(jnp.int32).astype(dtype) for shift in (0, 8, 16, 24))
    top, bottom = a + texel.fu * (b - a), c + texel.fu * (d - c)
    across = (b - a) + texel.fv * ((d - c) - (b - a))
    unit, per_px = 1 / _ZERO, 1 / (_ZERO * texture.stride)
    return (top + texel.fv * (bottom - top) - _ZERO) * unit, across * per_px, (bottom - top) * per_px


def lookup(
    texture: RampTexture, image_index: Int[Array, "*n"], u: Float[Array, "*n"], v: Float[Array, "*n"]
) -> Float[Array, "*n"]:
    """Signed ramp value in [-1, 1] at pixels (u, v), differentiable in u and v."""
    texel = locate(texture, u, v)
    return blend(texture, fetch(texture, image_index, texel), texel)[0]
