"""Small masks with more pixels (room: perception; host).

In: masks of class ids, their sizes. Out: the same with two pixels on a side for each.
Ramps are as wide as borders of usual images are unsure, and what smooths them is a pixel wide. In an image of 400
pixels a line is one pixel wide 15 m ahead: no wider than either, so that its two borders and its ends are lost. With
more pixels they are there, as exactly as the mask has them.
"""

from collections.abc import Sequence

import numpy as np

from semloc_jax.cameras import Rig
from semloc_jax.perception.border_distance import pixel_unit
from semloc_jax.perception.border_mask import BorderMask

_SMALL_UNIT = 0.6
"""Masks are small where a pixel stands for so much of a usual one: 330 px on a side. Exact masks of 400 x 120 px hold
a pose along the road twice as well with more pixels, those of 400 x 250 px by a third, those of 960 x 600 px no
better."""
_TIMES = 2


def times_finer(shapes: Sequence[tuple[int, ...]]) -> int:
    """How many pixels on a side stand for one of the masks of a frame, of these shapes (height, width).

    >>> times_finer([(120, 400)]), times_finer([(600, 960)])
    (2, 1)
    """
    return _TIMES if pixel_unit(shapes) < _SMALL_UNIT else 1


def finer(masks: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The masks of a frame with as many pixels as `times_finer` asks for; borders stay where they are.

    Args:
        masks: Class ids uint8[h w]; where one knows parts of a pixel itself (`BorderMask`) all stay as they are.
    """
    times = times_finer([mask.shape for mask in masks])
    if times == 1 or any(isinstance(mask, BorderMask) for mask in masks):
        return list(masks)
    return [np.repeat(np.repeat(mask, times, axis=0), times, axis=1) for mask in masks]


def rig_of(masks: Sequence[np.ndarray], rig: Rig) -> Rig:
    """The rig that sees masks which `finer` may have given more pixels than its cameras took."""
    return rig.with_pixels(max(round(masks[0].shape[1] / rig.cameras[0].resolution[0]), 1))
