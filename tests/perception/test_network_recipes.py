"""Recipes against files with the inputs, outputs and class lists of the usual exporters: twins with random weights,
one layer deep. What must come out is computed here from the same weights, without our preparation of images."""

import dataclasses

import cv2
import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.perception import load_class_table
from semloc_jax.perception.network import NetworkSegmenter
from semloc_jax.perception.network_recipes import RECIPES, recipe
from semloc_jax.perception.networks.onnx_graph import OnnxGraph
from tests.perception.onnx_files import field, value_info

pytest.importorskip("onnxruntime")
MEAN, STD = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])
SIZE = (64, 32)


def weights(num, seed=0):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((1, 1, 3, num)).astype(np.float32), rng.standard_normal(num).astype(np.float32)


def write(path, make, inputs, outputs):
    """A file with the nodes that `make` adds to a graph."""
    graph = OnnxGraph()
    make(graph)
    body = b"".join(graph.nodes) + field(2, "twin") + b"".join(graph.weights)
    body += b"".join(field(11, value_info(*port)) for port in inputs)
    body += b"".join(field(12, port_info(*port)) for port in outputs)
    path.write_bytes(field(1, 8) + field(7, body) + field(8, field(1, "") + field(2, 13)))
    return path


def port_info(name, shape, kind=1):
    """A tensor of some type: 1 float, 7 int64."""
    dims = b"".join(field(1, field(1, size) if size is not None else field(2, f"d{i}")) for i, size in enumerate(shape))
    return field(1, name) + field(2, field(1, field(1, kind) + field(2, dims)))


def image():
    """Smooth, so that resizing inside does not decide anything."""
    small = np.random.default_rng(1).integers(0, 256, (4, 8, 3), np.uint8)
    return cv2.resize(small, SIZE, interpolation=cv2.INTER_CUBIC)


def scores(kernel, bias, mean=MEAN, std=STD):
    """What a twin of these weights says of the image."""
    x = (image()[..., ::-1] / 255.0 - mean) / std
    return x @ kernel[0, 0] + bias


def expected(*args):
    """Class ids of the image by the weights of a twin."""
    return scores(*args).argmax(-1)


def masks(name, model, **changes):
    return NetworkSegmenter(dataclasses.replace(RECIPES[name], model=str(model), **changes))(image())


def agrees(mask, ids):
    """The same but for pixels at which two classes are alike to rounding."""
    return np.mean(mask == ids)


def small(name):
    """The recipe at the size of the image: what is tested is not the resizing."""
    return {"width_px": SIZE[0], "height_px": SIZE[1]} if RECIPES[name].width_px else {}


@pytest.mark.parametrize(("name", "num"), [("segformer-cityscapes", 19), ("segformer-mapillary", 66)])
def test_scores_at_a_quarter_with_another_output_first(tmp_path, name, num):
    """optimum: any size, `logits` at a quarter of the resolution; here behind an output that is not asked for."""
    kernel, bias = weights(num)

    def make(graph):
        said = graph.dense("pixel_values", kernel, bias)
        graph.node("Identity", [said], "hidden")
        graph.node("AveragePool", [said], "logits", kernel_shape=(4, 4), strides=(4, 4))

    free = (None, num, None, None)
    given = [("pixel_values", (None, 3, None, None))]
    model = write(tmp_path / "n.onnx", make, given, [("hidden", free), ("logits", free)])
    assert len(load_class_table(RECIPES[name].class_table).id_names) == num
    quarter = scores(kernel, bias).reshape(SIZE[1] // 4, 4, SIZE[0] // 4, 4, num).mean((1, 3))
    planes = [cv2.resize(quarter[..., k], SIZE, interpolation=cv2.INTER_LINEAR) for k in range(num)]
    assert agrees(masks(name, model, **small(name)), np.argmax(planes, axis=0)) > 0.98


@pytest.mark.parametrize("fixed", [True, False])
@pytest.mark.parametrize(("name", "num", "keep"), [("mmseg-mapillary", 66, 1), ("paddleseg-cityscapes", 19, 0)])
def test_the_best_class_is_chosen_inside(tmp_path, name, num, keep, fixed):
    """mmdeploy gives ids [b 1 h w], PaddleSeg [b h w], for a size that the file states or for any."""
    kernel, bias = weights(num)

    def make(graph):
        graph.node("ArgMax", [graph.dense("x", kernel, bias)], "output", axis=1, keepdims=keep)

    h, w = SIZE[::-1] if fixed else (None, None)
    out = (None, *[1] * keep, h, w)
    model = write(tmp_path / "n.onnx", make, [("x", (1, 3, h, w))], [("output", out, 7)])
    mean, std = (0.5, 0.5) if name.startswith("paddle") else (MEAN, STD)
    assert agrees(masks(name, model), expected(kernel, bias, mean, std)) > 0.999


def test_the_head_for_training_is_left_aside(tmp_path):
    """torchvision: `out` and `aux`."""
    kernel, bias = weights(19)

    def make(graph):
        graph.node("Identity", [graph.dense("x", *weights(19, seed=5))], "aux")
        graph.node("Identity", [graph.dense("x", kernel, bias)], "out")

    free = (None, 19, None, None)
    model = write(tmp_path / "n.onnx", make, [("x", (None, 3, None, None))], [("aux", free), ("out", free)])
    assert agrees(masks("torchvision-cityscapes", model), expected(kernel, bias)) > 0.999


def test_channels_last(tmp_path):
    """tf2onnx: [b h w 3] in, [b h w classes] out."""
    kernel, bias = weights(19)

    def make(graph):
        first = graph.node("Transpose", ["x"], perm=(0, 3, 1, 2))
        graph.node("Transpose", [graph.dense(first, kernel, bias)], "y", perm=(0, 2, 3, 1))

    model = write(tmp_path / "n.onnx", make, [("x", (None, None, None, 3))], [("y", (None, None, None, 19))])
    assert agrees(masks("keras-cityscapes", model), expected(kernel, bias, 0.5, 0.5)) > 0.999


def test_the_lane_head_is_not_the_first_output(tmp_path):
    """YOLOP: boxes, drivable area, lane lines; the letterbox of a wide image in a square input."""
    area, lanes = weights(2), weights(2, seed=3)

    def make(graph):
        graph.node("Identity", [graph.dense("images", *weights(6, seed=7))], "det_out")
        graph.node("Identity", [graph.dense("images", *area)], "drive_area_seg")
        graph.node("Identity", [graph.dense("images", *lanes)], "lane_line_seg")

    free = (None, None, None, None)
    ports = [(name, free) for name in ("det_out", "drive_area_seg", "lane_line_seg")]
    model = write(tmp_path / "n.onnx", make, [("images", (1, 3, None, None))], ports)
    mask = masks("yolop", model, width_px=64, height_px=64)
    assert agrees(mask, 2 * expected(*area) + expected(*lanes)) > 0.999


def test_a_recipe_that_is_not_there():
    with pytest.raises(SemlocError, match="did you mean 'mmseg-mapillary'.*recipes: segformer-cityscapes"):
        recipe("mmseg-mapilary")
