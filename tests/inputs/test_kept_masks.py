"""Masks that are kept: the same bytes, made once for each frame and camera."""

from collections import Counter

import numpy as np

from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.datasets import Frame
from semloc_jax.inputs.kept_masks import kept
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.perception import load_class_table
from semloc_jax.perception.border_mask import BorderMask

RIG = Rig([PinholeCamera(20.0, 20.0, 8.0, 5.5, 17, 12)], np.eye(4)[None], ["front"])


def frame(name):
    return Frame(0, name, 0.0, "", RIG, {})


def test_each_mask_is_made_once_and_stays_the_same(tmp_path):
    made = Counter()

    def segment(frame, camera):
        made[frame.id, camera] += 1
        return np.random.default_rng(len(made)).integers(0, 255, (12, 17), np.uint8)

    masks = MaskSource("classical", load_class_table("lane_paint"), ("left", "right"), segment)
    frames = [frame("a"), frame("../b")]
    first = [kept(masks, tmp_path / "kept").masks(frame) for frame in frames]
    again = kept(masks, tmp_path / "kept")  # a run that goes on
    np.testing.assert_array_equal([again.masks(frame) for frame in frames], first)
    assert set(made.values()) == {1} and len(made) == 4
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]


def test_what_is_more_than_class_ids_is_made_anew(tmp_path):
    told = []

    def segment(frame, camera):
        told.append(camera)
        return np.zeros((12, 17), np.uint8).view(BorderMask)

    source = kept(MaskSource("net", load_class_table("lane_paint"), ("front",), segment), tmp_path)
    for _ in range(2):
        source.segment(frame("a"), "front")
    assert told == ["front", "front"]
