"""Masks that do not fit the cameras of a surround view are told in one line."""

from pathlib import Path

import numpy as np
import pytest

from semloc_jax.cameras import Rig
from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.inputs.surround_masks import check_surround_masks
from semloc_jax.perception import load_class_table
from tests.perception.four_fisheyes import NAMES, four_fisheyes, painted


def slots(ground):
    """Dividers to the left and a box to the right: no two sides of the car look alike."""
    x, y = ground[..., 0], ground[..., 1]
    left = (np.abs((x + 1.0) % 2.5 - 1.25) < 0.12) & (y > 1.4) & (y < 5.0)
    right = (np.abs(y + 2.2) < 0.12) | ((np.abs((x + 0.3) % 1.7 - 0.85) < 0.1) & (y < -2.2))
    ahead = (np.abs(x - 5.0) < 0.15) | ((np.abs(y % 0.9 - 0.45) < 0.1) & (x > 5.0))
    behind = np.abs(x - y + 3.0) < 0.15
    return (left | right | ahead | behind) & (np.hypot(x - 1.4, y) < 8.0)


@pytest.fixture(scope="module")
def masks():
    return dict(zip(NAMES, painted(four_fisheyes(), slots), strict=True))


def checked(masks, names=NAMES, rig=None):
    rig = rig or four_fisheyes()
    frame = Frame(0, "0", 0.0, "", rig, {})
    drive = Drive("lot", Path("lot"), (frame,), rig, mask_sources=("sem",), table_name="drive")
    source = MaskSource("sem", load_class_table("drive"), names, lambda _, name: masks[name])
    return check_surround_masks(drive, source)


def test_right_masks_pass_and_a_missing_camera_is_said(masks):
    assert checked(masks) == []
    (said,) = checked(masks, ("front", "left", "right"))
    assert said == "without camera rear: no masks 'sem' of it, or not chosen"


def test_exchanged_black_and_foreign_masks_are_refused(masks):
    with pytest.raises(SemlocError, match="another order than the cameras: left shows what belongs to right"):
        checked(masks | {"left": masks["right"], "right": masks["left"]})
    with pytest.raises(SemlocError, match="of camera left show nothing but id 0 in 1 frames; .*--cameras front,rear"):
        checked(masks | {"left": 0 * masks["left"]})
    rig = four_fisheyes()
    wide = Rig([camera.resized(1280, 720) for camera in rig.cameras], rig.T_base_cam, rig.names)
    with pytest.raises(SemlocError, match="have 640x480 px, the calibration says 1280x720; .*of another car"):
        checked(masks, rig=wide)
