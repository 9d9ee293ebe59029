"""Paint without a network beside eyes: which ids stand, whose borders count."""

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.inputs.paint_and_eyes import paint_channel, with_paint
from semloc_jax.perception import load_class_table
from semloc_jax.perception.border_distance import border_distances
from semloc_jax.perception.border_mask import BorderMask, SeenBorders
from semloc_jax.perception.class_table import part_of_table
from semloc_jax.perception.cost_maps import cost_maps
from semloc_jax.structs import ElementClass

TABLE = load_class_table("street")
PAINT, POLE, MOVING, UNSEEN = 1, 2, 6, 255


def told_and_drawn():
    """Eyes see paint on the left, a post, a vehicle; the segmenter sees paint on the right and does not see above."""
    ids = np.zeros((64, 96), np.uint8)
    ids[:, 8:16], ids[20:40, 40:44], ids[50:60, 60:70] = PAINT, POLE, MOVING
    names = tuple(channel.name for channel in TABLE.channels)
    signed = np.full((len(names), 32, 48), 30.0, np.float32)
    signed[names.index("pole"), 10:20, 20:22] = -1.0
    told = BorderMask.of(ids, SeenBorders(signed, np.ones_like(signed), 2.0, names, 40.0))
    drawn = np.zeros((64, 96), np.uint8)
    drawn[:, 62:72], drawn[:8] = PAINT, UNSEEN
    return told, drawn


def test_paint_comes_from_the_segmenter_and_all_else_from_the_eyes():
    mask = with_paint(*told_and_drawn(), PAINT, paint_channel(TABLE))
    assert not (mask[8:, 8:16] == PAINT).any()
    assert (mask[30:49, 62:72] == PAINT).all()
    assert (mask[50:60, 62:70] == MOVING).all(), "a vehicle hides what was taken for paint"
    assert (mask[:8] == UNSEEN).all() and (mask[20:40, 40:44] == POLE).all()
    assert mask.borders.names == ("pole", "sign", "traffic_light", "pillar")


def test_borders_of_paint_are_those_of_the_ids():
    mask = with_paint(*told_and_drawn(), PAINT, paint_channel(TABLE))
    fields = border_distances([mask], TABLE, 20.0).signed_px[0]
    paint, pole = TABLE.channel_index("road_paint"), TABLE.channel_index("pole")
    assert fields[paint, 20, 33] < -3.0 and fields[paint, 20, 10] == 20.0
    assert fields[pole, 15, 20] == pytest.approx(-1.0)
    ramps = cost_maps([mask], TABLE).ramps[-1]
    assert float(ramps[0, paint, 40, 67]) == pytest.approx(-1.0) and float(ramps[0, paint, 40, 12]) == 1.0
    assert float(ramps[0, pole, 30, 42]) < 0.0


def test_a_table_without_one_channel_for_paint_is_refused():
    with pytest.raises(SemlocError, match="no one channel for all paint"):
        paint_channel(load_class_table("drive"))


def test_a_part_of_a_table_leaves_channels_out():
    part = part_of_table(TABLE, load_class_table("street_paint"))
    assert [channel.name for channel in part.channels] == ["road_paint"] and part.dynamic_ids == (MOVING,)
    assert part.channel_of(ElementClass.POLE) == -1
    with pytest.raises(SemlocError, match="expected some of"):
        part_of_table(part, TABLE)
