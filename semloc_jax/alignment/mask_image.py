"""The masks of a frame as they lie on the device (room: alignment; host).

In: masks, their class table. Out: ImageInput: cost maps as textures, and which pixels are usable.
"""

from collections.abc import Sequence
from functools import lru_cache

import jax
import numpy as np

from semloc_jax import native
from semloc_jax.alignment.single_frame import ImageInput, image_input
from semloc_jax.native.mask_ramps import packed
from semloc_jax.perception import ClassTable
from semloc_jax.perception.cost_maps import CostMapConfig, cost_maps, mask_ramps
from semloc_jax.residuals.alignment import Usable
from semloc_jax.residuals.texture import RampTextures
from semloc_jax.runtime.allocator import used_again


def mask_image(masks: Sequence[np.ndarray], table: ClassTable, config: CostMapConfig) -> ImageInput:
    """The masks of one frame, packed for the device; the same as `image_input` of their cost maps.

    On the CPU, with kernels, bytes become texels in memory of the host that JAX takes over: no program, no copy, no
    page that is touched for the first time.
    """
    if jax.default_backend() != "cpu" or not native.is_available():
        return image_input(cost_maps(masks, table, config, quantised=True))
    ramps, usable = mask_ramps(masks, table, config, range(len(table.channels)), np.uint8)
    texels = used_again(4 * sum(ramp.size for ramp in ramps)).view(np.uint32)
    packed(ramps, texels)
    shapes = tuple(ramp.shape for ramp in ramps)
    columns = _columns(shapes, tuple(config.stride), tuple(config.ramp_px))
    textures = RampTextures(jax.device_put(texels), *columns, num_channels=len(table.channels))
    return ImageInput(textures, Usable(jax.device_put(usable), config.usable_stride))


@lru_cache(maxsize=16)
def _columns(
    shapes: tuple[tuple[int, ...], ...], stride: tuple[int, ...], ramp_px: tuple[float, ...]
) -> tuple[jax.Array, ...]:
    """Start, height, width, stride and ramp of every level: the same in every frame."""
    starts = np.cumsum([0, *(np.prod(shape) for shape in shapes)])[:-1]
    heights, widths = [shape[2] for shape in shapes], [shape[3] for shape in shapes]
    integers = [jax.device_put(np.asarray(column, np.int32)) for column in (starts, heights, widths)]
    return *integers, *(jax.device_put(np.asarray(column, np.float32)) for column in (stride, ramp_px))
