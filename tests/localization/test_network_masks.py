"""Masks of a network in an ONNX file: its class table must be given, and it sees the images of the drive."""

import importlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.datasets import Frame, Sequence
from semloc_jax.errors import SemlocError
from semloc_jax.localization import mask_source

RIG = Rig([PinholeCamera(80.0, 80.0, 23.5, 15.5, 48, 32)], np.eye(4)[None], ["front"])


@pytest.fixture
def drive(tmp_path):
    image = np.zeros((32, 48, 3), np.uint8)
    image[:, 24:] = 255
    cv2.imwrite(str(tmp_path / "0.png"), image)
    frame = Frame(0, "0", 0.0, "", RIG, {"rgb": {"front": tmp_path / "0.png"}})
    return Sequence("one", tmp_path, (frame,), RIG)


def test_a_network_needs_a_class_table_and_a_file(drive):
    with pytest.raises(SemlocError, match="give --class-table"):
        mask_source("net.onnx", drive)
    with pytest.raises(SemlocError, match="no such file"):
        mask_source("net.onnx", drive, table="lane_paint")


def test_a_network_sees_the_images(drive, monkeypatch):
    class Brightness:
        def __init__(self, path):
            assert Path(path).name == "net.onnx"

        def __call__(self, image):
            return (image[..., 0] > 127).astype(np.uint8)

    monkeypatch.setattr(importlib.import_module("semloc_jax.localization.mask_source"), "OnnxSegmenter", Brightness)
    (mask,) = mask_source("net.onnx", drive, table="lane_paint").masks(drive.frames[0])
    assert mask[:, :24].max() == 0 and mask[:, 24:].min() == 1
