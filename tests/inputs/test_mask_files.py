"""Masks as files: one that is damaged or of another size costs its frame, other shapes are told."""

import cv2
import numpy as np
import pytest

from semloc_jax.datasets import open_drive
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_source import mask_source

CALIBRATION = """cam0:
  name: front
  camera_model: pinhole
  distortion_model: none
  intrinsics: [60.0, 60.0, 31.5, 19.5]
  distortion_coeffs: []
  resolution: [64, 40]
  mounted: {position_m: [1.6, 0.0, 1.4], yaw_deg: 0.0, down_deg: 3.0, roll_deg: 0.0}
"""


def _drive(folder, sizes):
    """A drive of three masks of these sizes (width, height)."""
    (folder / "masks").mkdir(parents=True)
    (folder / "calib.yaml").write_text(CALIBRATION)
    for index, (width, height) in enumerate(sizes):
        mask = np.full((height, width), 1, np.uint8)
        mask[:, 3::8] = 10  # paint on a road, by the class table `drive`
        cv2.imwrite(str(folder / "masks" / f"{index:03d}.png"), mask)
    return open_drive(folder)


@pytest.mark.parametrize("broken", ["000", "001"])
@pytest.mark.parametrize("of_drive", [True, False])
def test_a_damaged_mask_costs_its_own_frame(tmp_path, capfd, caplog, broken, of_drive):
    """A drive of an hour does not end at one file that was cut off; the frame shows nothing, and one line says so."""
    drive = _drive(tmp_path, [(64, 40)] * 3)
    path = tmp_path / "masks" / f"{broken}.png"
    path.write_bytes(path.read_bytes()[:50])
    source = mask_source("masks" if of_drive else str(tmp_path / "masks"), drive, table="drive")
    seen = {frame.id: np.unique(source.masks(frame)[0]).tolist() for frame in drive.frames}
    assert seen == {name: [255] if name == broken else [1, 10] for name in ("000", "001", "002")}
    assert caplog.text.count(f"frame {broken} is taken without it") == 1
    assert capfd.readouterr().err == ""  # nor does the decoder talk past us


def test_masks_that_are_all_damaged_are_an_error(tmp_path):
    drive = _drive(tmp_path, [(64, 40)] * 2)
    for path in (tmp_path / "masks").iterdir():
        path.write_bytes(path.read_bytes()[:50])
    with pytest.raises(SemlocError, match="cannot be decoded"):
        mask_source("masks", drive, table="drive")


def test_a_mask_of_another_size_costs_its_own_frame(tmp_path, caplog):
    """The camera of all masks is scaled by the first of them: another size would be another camera."""
    drive = _drive(tmp_path, [(64, 40), (60, 40), (64, 40), (60, 40)])
    source = mask_source("masks", drive, table="drive")
    seen = [np.unique(source.masks(frame)[0]).tolist() for frame in drive.frames]
    assert seen == [[1, 10], [255], [1, 10], [255]]
    assert all(source.segment(frame, "front").shape == (40, 64) for frame in drive.frames)
    assert caplog.text.count("of front: frame 001 has 60x40 px, the first one 64x40") == 1
    assert "frame 003" not in caplog.text  # one line for a size


def test_masks_of_another_shape_than_the_images_are_told(tmp_path, caplog):
    mask_source("masks", _drive(tmp_path / "half", [(32, 20)] * 2), table="drive")
    assert "stretched" not in caplog.text
    source = mask_source("masks", _drive(tmp_path / "square", [(40, 40)] * 2), table="drive")
    assert "are 40x40 px, its images 64x40: taken as the whole image, stretched" in caplog.text
    assert source.size_px == {"front": (40, 40)}
