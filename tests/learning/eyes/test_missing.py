"""Paint that the map lacks: found where frame after frame shows it, in no other place."""

import numpy as np
import pytest

import semloc_jax as sj
from semloc_jax.learning.eyes.missing import PLACE_M, GroundLooks, _centres, drawn_missing
from semloc_jax.perception import load_class_table
from semloc_jax.perception.border_distance import border_distances

LINES = [("lane_marking", [[0, y, 0], [60, y, 0]]) for y in (2.0, -2.0)]
DASHES = [("lane_marking", [[x, 0.0, 0], [x + 1.5, 0.0, 0]], {"width_m": 0.2}) for x in (8.0, 12.0, 16.0)]
TABLE = load_class_table("drive")
PAINT_ID = TABLE.channels[TABLE.channel_index("lane_marking")].mask_ids[0]


@pytest.fixture(scope="module")
def rig():
    camera = sj.camera_from_K([[400, 0, 319.5], [0, 400, 199.5], [0, 0, 1]], (640, 400))
    return sj.Rig([camera], [sj.mounted((1.6, 0.0, 1.4), down_deg=8.0)], ["front"])


def looked(rig, shown, hidden=None):
    """Looks from ten places, and the masks; the third one has a blob that nobody else sees."""
    looks, masks = GroundLooks(), []
    for k in range(10):
        T = sj.planar_pose(0.5 * k, 0.1)
        mask = np.array(sj.render_masks(shown, rig, T)[0])
        if k == 2:
            mask[300:330, 400:440] = PAINT_ID
        if hidden is not None:
            mask[hidden] = 255
        masks.append(mask)
        seen = border_distances([mask], TABLE, 20.0)
        looks.look(rig.cameras[0], T, np.asarray(rig.T_base_cam)[0], mask, seen.signed_px[0], seen.stride, TABLE)
    return looks, masks


def test_paint_that_most_frames_show_is_missing_in_the_map(rig):
    known, whole = sj.map_from_arrays(LINES), sj.map_from_arrays(LINES + DASHES)
    looks, masks = looked(rig, whole)
    keys = looks.missing(known.elements)
    xy = _centres(keys)
    beside = [np.hypot(xy[:, 0] - np.clip(xy[:, 0], x, x + 1.5), xy[:, 1]) for x in (8.0, 12.0)]
    assert all((far < 1.5 * PLACE_M).sum() >= 6 for far in beside), "both dashes are found"
    far = np.min([np.hypot(xy[:, 0] - np.clip(xy[:, 0], x, x + 1.5), xy[:, 1]) for x in (8.0, 12.0, 16.0)], axis=0)
    assert far.max() < 2.0 * PLACE_M, "and nothing else: no line of the map, no blob of one frame"
    T_base_cam = np.asarray(rig.T_base_cam)[0]
    drawn = drawn_missing(keys, rig.cameras[0], sj.planar_pose(2.0, 0.1), T_base_cam)
    columns = slice(250, 390)  # between the lines
    assert drawn[:, columns][masks[4][:, columns] == PAINT_ID].mean() > 0.5 and drawn.mean() < 0.02
    assert len(looks.missing(whole.elements)) == 0, "a map that has it lacks nothing"


def test_what_is_hidden_is_not_looked_at(rig):
    """Traffic covers the lower half of all images: nobody saw the near dash, for or against."""
    hidden = np.zeros((400, 640), bool)
    hidden[180:] = True
    looks, _ = looked(rig, sj.map_from_arrays(LINES + DASHES), hidden)
    assert len(looks.missing([])) == 0
    assert len(GroundLooks().missing([])) == 0
