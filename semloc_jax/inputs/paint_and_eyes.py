"""Paint by the segmenter without a network, all else by eyes (room: inputs; host).

In: masks of both of one image. Out: class ids of the eyes with the paint of the segmenter.
"""

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.perception.border_mask import BorderMask
from semloc_jax.perception.class_table import UNLABELED_ID, Channel, ClassTable
from semloc_jax.structs import ElementClass


def paint_channel(table: ClassTable) -> Channel:
    """The channel of a table that shows paint on roads.

    Raises:
        SemlocError: the table parts paint into several channels, or shows none.
    """
    shows = [channel for channel in table.channels if ElementClass.LANE_MARKING in channel.classes]
    if not shows or ElementClass.STOP_LINE not in shows[0].classes:
        raise SemlocError(
            f"class table {table.name}: has no one channel for all paint; expected eyes like those that ship"
        )
    return shows[0]


def with_paint(told: BorderMask, drawn: np.ndarray, drawn_id: int, channel: Channel) -> BorderMask:
    """What eyes tell, but for paint.

    Args:
        told: of the eyes.
        drawn: class ids uint8[h w] of the segmenter, 255 where it does not see.
        drawn_id: that of paint in them.
        channel: of paint in the table of the eyes; the borders of its class are those of the ids from now on.
    """
    (number,) = channel.mask_ids
    ids = np.where(np.asarray(told) == number, np.uint8(0), np.asarray(told))
    for from_id, to_id in ((drawn_id, number), (UNLABELED_ID, UNLABELED_ID)):
        ids = np.where((drawn == from_id) & (ids == 0), np.uint8(to_id), ids)
    return BorderMask.of(ids, told.borders.without(channel.name))
