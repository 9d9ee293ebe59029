"""Elements of the map are held against masks in the pixels of these, whatever their size is."""

import numpy as np
import pytest

import semloc_jax as sj
from semloc_jax.datasets import Frame
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.learning.eyes.lessons import Lesson, _doubts
from semloc_jax.learning.eyes.poses import TeacherPose
from semloc_jax.perception import load_class_table


@pytest.mark.parametrize("size_px", [(640, 400), (320, 120)])
def test_exact_masks_deny_no_element(size_px):
    """Also small ones, which have two pixels on a side for each: posts and dashes all agree with their own masks."""
    width, height = size_px
    camera = sj.camera_from_K([[0.6 * width, 0, width / 2], [0, 0.6 * width, height / 3], [0, 0, 1]], size_px)
    rig = sj.Rig([camera], [sj.mounted((1.6, 0.0, 1.4), down_deg=4.0)], ["front"])
    dashes = [("lane_marking", [[x, 0.0, 0], [x + 3.0, 0.0, 0]], {"width_m": 0.2}) for x in (10.0, 18.0)]
    post = {"radius_m": 0.1, "radius_top_m": 0.1}
    posts = [("pole", [[x, y, 0.0], [x, y, 2.0]], post) for x, y in ((14.0, 3.0), (17.0, -4.0))]
    street = sj.map_from_arrays([*dashes, *posts])
    frames = [Frame(k, f"{k:02d}", 0.1 * k, "", rig, {}) for k in range(6)]
    poses = [sj.planar_pose(0.4 * k, 0.1) for k in range(6)]

    def segment(frame, camera):
        return np.asarray(sj.render_masks(street, rig, poses[frame.index])[0])

    masks = MaskSource("exact", load_class_table("drive"), ("front",), segment)
    lesson = object.__new__(Lesson)
    object.__setattr__(lesson, "map", street)  # all that is asked for
    known = [TeacherPose(frame, T, 1e-6 * np.eye(6)) for frame, T in zip(frames, poses, strict=True)]
    doubts = _doubts(lesson, masks, known, 0.02)
    looks = doubts.elements
    assert len(looks.looks) == 4 and looks.num_distrusted == 0
    assert min(looks.agreed[key] / looks.looks[key] for key in looks.looks) > 0.8
    assert len(doubts.missing) == 0
