"""Segmenters: ids from files, functions and networks arrive at the size of the image, unshifted."""

import cv2
import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.perception import (
    CallableSegmenter,
    ClassicalPaintSegmenter,
    MaskFolder,
    OnnxSegmenter,
    Segmenter,
    get_segmenter,
)
from semloc_jax.perception.segmenters import ids_from_output
from tests.perception.onnx_files import red_or_blue

IMAGE = np.random.default_rng(0).integers(0, 256, (32, 48, 3), dtype=np.uint8)


def test_onnx_network_sees_rgb_with_its_normalisation(tmp_path):
    red_or_blue(tmp_path / "net.onnx")
    segment = OnnxSegmenter(tmp_path / "net.onnx", mean=(0.0, 0.0, 0.0), std=(1.0, 1.0, 1.0))
    blue, red = IMAGE[..., 0] / 255 - 0.5, IMAGE[..., 2] / 255 - 0.5
    expected = np.where(np.maximum(red, blue) <= 0, 0, np.where(red >= blue, 1, 2))
    assert np.array_equal(segment(IMAGE), expected)
    # mean 0.5 moves every score up by half: nothing is never chosen where red or blue is above it.
    darker = OnnxSegmenter(tmp_path / "net.onnx", mean=(0.5, 0.5, 0.5), std=(1.0, 1.0, 1.0))
    assert (darker(IMAGE) == 0).all()


def test_a_network_of_reduced_size_leaves_no_offset(tmp_path):
    red_or_blue(tmp_path / "net.onnx", size=(96, 64), reduced=4)
    segment = OnnxSegmenter(tmp_path / "net.onnx", size_px=(96, 64), mean=(0.0, 0.0, 0.0), std=(1.0, 1.0, 1.0))
    image = np.zeros((128, 192, 3), np.uint8)
    image[40:88, 64:128, 2] = 255
    v, u = np.nonzero(segment(image) == 1)
    # The centre of the square, which ids resized by themselves would miss by up to 3.5 px.
    assert (u.mean(), v.mean()) == pytest.approx((95.5, 63.5), abs=0.05)


def test_single_scores_ids_and_odd_outputs():
    score = np.zeros((1, 1, 8, 12), np.float32)
    score[..., 3:5, 4:6] = 1
    assert np.array_equal(ids_from_output(score, (12, 8)), score[0, 0] > 0.5)
    ids = np.arange(96, dtype=np.float32).reshape(1, 8, 12)
    assert np.array_equal(ids_from_output(ids, (24, 16)), ids[0].repeat(2, axis=0).repeat(2, axis=1))
    with pytest.raises(SemlocError, match=r"returned shape \[2, 3, 8, 12\]"):
        ids_from_output(np.zeros((2, 3, 8, 12)), (12, 8))


def test_broken_network_is_named(tmp_path):
    (tmp_path / "net.onnx").write_bytes(b"no network")
    with pytest.raises(SemlocError, match=r"net\.onnx: OpenCV cannot read it"):
        OnnxSegmenter(tmp_path / "net.onnx")
    with pytest.raises(SemlocError, match="no such file"):
        OnnxSegmenter(tmp_path / "other.onnx")


def test_mask_folder_reads_by_frame(tmp_path):
    mask = IMAGE[..., 0]
    cv2.imwrite(str(tmp_path / "000007.png"), mask)
    folder = MaskFolder(tmp_path)
    assert np.array_equal(folder(IMAGE, "000007"), mask) and folder.frame_ids() == ["000007"]
    with pytest.raises(SemlocError, match="no mask of frame '8'; there are 1, 000007"):
        folder(IMAGE, "8")
    with pytest.raises(SemlocError, match="expected 24x16"):
        folder(IMAGE[::2, ::2], "000007")


def test_callable_is_checked():
    assert np.array_equal(CallableSegmenter(lambda image: image[..., 1].astype(int))(IMAGE), IMAGE[..., 1])
    with pytest.raises(SemlocError, match=r"shape \(2, 2\), expected \(32, 48\)"):
        CallableSegmenter(lambda image: np.zeros((2, 2), int))(IMAGE)
    with pytest.raises(SemlocError, match="returned float64"):
        CallableSegmenter(lambda image: image[..., 1] / 255)(IMAGE)


def test_names_lead_to_segmenters(tmp_path):
    red_or_blue(tmp_path / "net.onnx")
    made = [get_segmenter(name) for name in ("paint", str(tmp_path), f"masks:{tmp_path}", str(tmp_path / "net.onnx"))]
    kinds = [ClassicalPaintSegmenter, MaskFolder, MaskFolder, OnnxSegmenter]
    assert [type(segmenter) for segmenter in made] == kinds
    assert all(isinstance(segmenter, Segmenter) for segmenter in made)
    with pytest.raises(SemlocError, match="did you mean 'paint'"):
        get_segmenter("pain")
