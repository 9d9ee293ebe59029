"""Masks of a network in an ONNX file that runs on the images of the drive: with a preset, with a class table."""

import cv2
import numpy as np
import pytest
import yaml

from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_source import mask_source
from tests.perception.onnx_files import red_or_blue

pytest.importorskip("onnxruntime")
RIG = Rig([PinholeCamera(80.0, 80.0, 23.5, 15.5, 48, 32)], np.eye(4)[None], ["front"])
TABLE = """name: colours
ids: {nothing: 0, red: 1, blue: 2}
channels:
  - {name: paint, masks: [red], classes: [lane_marking]}
"""
PRESET = {"mean": [0, 0, 0], "std": [1, 1, 1], "class_table": "table.yaml"}


@pytest.fixture
def drive(tmp_path):
    """One image, red at its right edge."""
    image = np.zeros((32, 48, 3), np.uint8)
    image[:, 46:, 2] = 255
    cv2.imwrite(str(tmp_path / "0.png"), image)
    frame = Frame(0, "0", 0.0, "", RIG, {"rgb": {"front": tmp_path / "0.png"}})
    return Drive("one", tmp_path, (frame,), RIG)


@pytest.fixture
def network(tmp_path):
    """A network that takes bytes 0 ... 1 as they are, and the table of its ids."""
    (tmp_path / "table.yaml").write_text(TABLE)
    return red_or_blue(tmp_path / "net.onnx")


def test_a_network_needs_a_class_table_and_a_file(drive, network, tmp_path):
    with pytest.raises(SemlocError, match="give --class-table"):
        mask_source(str(network), drive)
    with pytest.raises(SemlocError, match="no such file"):
        mask_source(str(tmp_path / "other.onnx"), drive, table="lane_paint")


@pytest.mark.parametrize("name", ["net.onnx", "net.yaml"])
def test_a_network_sees_the_images_with_the_preset_beside_it(drive, network, tmp_path, name):
    words = PRESET if name.endswith("onnx") else PRESET | {"model": "net.onnx"}
    (tmp_path / "net.yaml").write_text(yaml.safe_dump(words))
    source = mask_source(str(tmp_path / name), drive)
    assert source.table.name == "colours"
    mask = source.segment(drive.frames[0], source.cameras[0])
    assert mask[:, :46].max() == 0 and mask[:, 46:].min() == mask.max() == 1


def test_a_table_that_does_not_fit_is_refused(drive, network, tmp_path):
    """The ids that come out are none of the table."""
    wrong = TABLE.replace("red: 1, blue: 2", "red: 7, blue: 8")
    (tmp_path / "wrong.yaml").write_text(wrong)
    (tmp_path / "net.yaml").write_text(yaml.safe_dump(PRESET))
    with pytest.raises(SemlocError, match="do not fit class table"):
        mask_source(str(network), drive, table=str(tmp_path / "wrong.yaml"))
