"""Masks as they lie on the device: the same as by way of cost maps, in memory that nobody else uses."""

import jax
import numpy as np
import pytest

from semloc_jax import native
from semloc_jax.alignment import mask_image
from semloc_jax.alignment.single_frame import image_input
from semloc_jax.perception import load_class_table
from semloc_jax.perception.cost_maps import CostMapConfig, cost_maps
from semloc_jax.runtime import allocator

TABLE = load_class_table("lane_paint")
CONFIG = CostMapConfig(ramp_px=(14.0, 3.0), stride=(2, 1))


def masks(seed):
    """Two cameras, the second smaller, of blocks of random ids."""
    rng = np.random.default_rng(seed)
    sizes = (96, 128), (80, 112)
    return [np.kron(rng.integers(0, 3, (h // 16, w // 16)), np.ones((16, 16))).astype(np.uint8) for h, w in sizes]


def same(found, expected):
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.skipif(not native.is_available(), reason="no kernels")
@pytest.mark.usefixtures("single_precision")
def test_frames_that_are_held_keep_their_texels():
    """Frames wait in a queue while the next ones are made: memory is used again only when they are gone."""
    held = [mask_image.mask_image(masks(seed), TABLE, CONFIG) for seed in range(4)]
    for seed, found in enumerate(held):
        same(found, image_input(cost_maps(masks(seed), TABLE, CONFIG, quantised=True)))
    assert len({_place(found) for found in held}) == 4
    del held, found
    gone = [_place(mask_image.mask_image(masks(seed), TABLE, CONFIG)) for seed in range(20)]
    assert len(set(gone)) <= 6


def _place(image):
    return image.textures.texels.unsafe_buffer_pointer()


def test_a_block_is_used_again_only_without_views():
    first = allocator.used_again(4096)
    first[:] = 7
    view = first[100:].view(np.uint32)
    del first
    other = allocator.used_again(4096)
    other[:] = 9
    assert (view == 0x07070707).all()
    assert other.ctypes.data % allocator.ALIGN_BYTES == 0
    place = other.ctypes.data
    del other
    assert allocator.used_again(4096).ctypes.data == place
