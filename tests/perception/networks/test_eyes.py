"""Eyes: from an image to a mask that knows its borders; weights with their table."""

import dataclasses

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.learning.eyes.street_lesson import class_scores
from semloc_jax.learning.eyes.streets import labelled
from semloc_jax.perception import load_class_table
from semloc_jax.perception.network import NetworkPreset, NetworkSegmenter
from semloc_jax.perception.networks.eyes import (
    REACH_PX,
    SHIPPED,
    SHIPPED_GARAGE,
    Eyes,
    eyes_table,
    read_out,
    ready,
    working_image,
    working_scale,
)
from semloc_jax.perception.networks.onnx_graph import OnnxGraph, write_onnx
from semloc_jax.perception.networks.weights import save_weights
from semloc_jax.simulation.streets.views import street_views
from semloc_jax.structs import ElementClass
from tests.perception.onnx_files import field, red_or_blue, value_info

CLASSES = frozenset({ElementClass.LANE_MARKING, ElementClass.POLE})


@pytest.fixture(scope="module")
def eyes():
    return Eyes.new(eyes_table(load_class_table("drive"), CLASSES), seed=0)


def test_images_of_all_cameras_are_about_as_wide():
    assert [working_scale(width) for width in (400, 640, 960, 1280, 1920, 2560)] == [2.0, 2.0, 1.0, 1.0, 0.5, 0.5]
    image = np.zeros((120, 400, 3), np.uint8)
    image[..., 2] = 255
    picture = working_image(image)
    assert picture.shape == (240, 800, 3) and tuple(picture[0, 0]) == (1.0, 0.0, 0.0)


def test_what_has_not_learned_sees_nothing(eyes):
    mask = eyes(np.random.default_rng(0).integers(0, 256, (75, 201, 3), np.uint8))
    assert mask.shape == (75, 201) and not mask.any()
    assert mask.borders.names == ("lane_marking", "pole")
    scale = working_scale(201)
    assert mask.borders.stride == 2.0 / scale and mask.borders.reach_px == REACH_PX / scale
    rows, columns = mask.borders.signed_px.shape[1:]
    assert (rows - 1) * mask.borders.stride < 75 <= rows * mask.borders.stride
    assert (columns - 1) * mask.borders.stride < 201 <= columns * mask.borders.stride
    assert np.all(mask.borders.sigma_px > 0.0)


def test_the_class_whose_border_is_deepest_gets_the_pixel(eyes):
    """Told for the whole image: 1 px inside of paint, 3 px inside of a pole."""
    bias = np.zeros((2, 2, 6), np.float32)
    bias[..., 0], bias[..., 1] = (-1.0 - 0.5 * REACH_PX) / 8.0, (-3.0 - 0.5 * REACH_PX) / 8.0
    told = dataclasses.replace(
        eyes, network=eqx.tree_at(lambda n: n.head.bias, eyes.network, jnp.asarray(bias.reshape(-1)))
    )
    mask = told(np.zeros((32, 960, 3), np.uint8))
    assert np.all(mask == 2)
    np.testing.assert_allclose(mask.borders.signed_px[:, 3, 3], [-1.0, -3.0], atol=1e-5)


def test_distances_beyond_the_reach_are_still_learned():
    """A clip in the reading would have no slope there."""
    said = read_out(jnp.asarray([[[9.0, 0.0, 0.0]]]))
    assert float(said.signed_px[0, 0, 0]) > REACH_PX


def test_a_sigma_beyond_its_bounds_is_led_back_and_not_farther_out():
    """Logarithms from -9 to 9: told within 0.2 to 60 px; the slope is there where descending it leads inside."""
    raw = jnp.asarray([-9.0, 0.0, 9.0])

    def told(raw, sign):
        return jnp.sum(sign * read_out(jnp.stack([raw, raw, raw], -1)[None, None]).log_sigma)

    np.testing.assert_allclose(told(raw[:1], 1.0), np.log(0.2), rtol=1e-6)
    np.testing.assert_allclose(told(raw[2:], 1.0), np.log(60.0), rtol=1e-6)
    np.testing.assert_allclose(jax.grad(told)(raw, 1.0), [0.0, 1.0, 1.0])
    np.testing.assert_allclose(jax.grad(told)(raw, -1.0), [-1.0, -1.0, 0.0])


def test_eyes_come_back_with_their_table(eyes, tmp_path):
    eyes.save(tmp_path / "a.weights")
    assert (tmp_path / "a.weights").stat().st_size < 2.5e6
    back = Eyes.load(tmp_path / "a.weights")
    assert [(c.name, c.mask_ids, c.classes) for c in back.table.channels] == [
        ("lane_marking", (1,), (ElementClass.LANE_MARKING,)),
        ("pole", (2,), (ElementClass.POLE,)),
    ]
    image = np.random.default_rng(0).integers(0, 256, (64, 96, 3), np.uint8)
    np.testing.assert_allclose(back(image).borders.signed_px, eyes(image).borders.signed_px, atol=1e-4)


def test_other_weights_are_refused(eyes, tmp_path):
    save_weights(tmp_path / "b.weights", eyes.network, {"kind": "marks"})
    with pytest.raises(SemlocError, match="of kind 'marks'; expected what `semloc learn eyes` wrote"):
        Eyes.load(tmp_path / "b.weights")
    save_weights(tmp_path / "c.weights", eyes.network, {"kind": "eyes", "table": {"ids": 3}})
    with pytest.raises(SemlocError, match="class table"):
        Eyes.load(tmp_path / "c.weights")
    with pytest.raises(SemlocError, match="shows none of the classes of the map"):
        eyes_table(load_class_table("lane_paint"), frozenset({ElementClass.PILLAR}))


def test_an_adapter_sees_the_scores_of_another_network(eyes, tmp_path):
    """Red is class 1 of the other network: its share is beside the colours, where the red is; the weights find the
    network again by its content."""
    pytest.importorskip("onnxruntime")
    plain = {"mean": (0.0, 0.0, 0.0), "std": (0.05, 0.05, 0.05)}
    model = red_or_blue(tmp_path / "net.onnx", size=(96, 64), reduced=4)
    helper = NetworkSegmenter(NetworkPreset(model=str(model), **plain))
    image = np.zeros((128, 640, 3), np.uint8)
    image[30:100, 200:400, 2] = 255
    adapter = Eyes.new(eyes.table, 0, helper)
    picture = adapter.picture(image)
    assert picture.shape == (256, 1280, 6)
    shares = picture[..., 3:]
    np.testing.assert_allclose(shares.sum(-1), 1.0, atol=1e-5)
    inside, outside = shares[110:150, 460:740, 1], np.delete(shares[..., 1], slice(300, 900), axis=1)
    assert inside.min() > 0.97 and outside.max() < 0.5
    assert sum(x.size for x in jax.tree.leaves(adapter.network)) < 0.3 * sum(
        x.size for x in jax.tree.leaves(eyes.network)
    )
    adapter.save(tmp_path / "a.weights")
    back = Eyes.load(tmp_path / "a.weights")
    np.testing.assert_allclose(back.picture(image), picture, atol=1e-6)
    assert not back(image).any()
    red_or_blue(model, size=(48, 32))
    with pytest.raises(SemlocError, match=r"scores of network net\.onnx, which is neither at .* or is another one"):
        Eyes.load(tmp_path / "a.weights")


def test_ids_are_no_scores(tmp_path):
    pytest.importorskip("onnxruntime")
    graph = OnnxGraph()
    graph.node("ArgMax", ["x"], "y", axis=1, keepdims=1)
    body = b"".join(graph.nodes) + field(2, "n") + field(11, value_info("x", (1, 3, 32, 32)))
    body += field(12, field(1, "y") + field(2, field(1, field(1, 7))))
    (tmp_path / "n.onnx").write_bytes(field(1, 8) + field(7, body) + field(8, field(1, "") + field(2, 13)))
    network = NetworkSegmenter(NetworkPreset(model=str(tmp_path / "n.onnx")))
    with pytest.raises(SemlocError, match="expected scores .b classes h w."):
        network.scores(np.zeros((32, 32, 3), np.uint8), (32, 32))


def road_picture(rng):
    """A grey road with two white lines that meet at the horizon, and where they are; 960 px wide, day."""
    ids = np.zeros((320, 960), np.uint8)
    for foot in (250.0, 800.0):
        corners = np.array([[foot - 14, 319], [foot + 14, 319], [481, 60], [479, 60]])
        cv2.fillPoly(ids, [np.round(corners).astype(np.int32)], 1)
    light = np.where(ids[..., None] > 0, 210.0, 95.0) + rng.normal(0.0, 6.0, (320, 960, 3))
    light[:60] = 190.0
    return cv2.GaussianBlur(np.clip(light, 0, 255).astype(np.uint8), (0, 0), 0.7), ids


def test_the_eyes_that_ship_see_lines():
    """Paint to two pixels, and little else; they state what they are for."""
    eyes = Eyes.load(SHIPPED)
    assert SHIPPED.stat().st_size < 2.5e6 and {"taught", "figures", "limits", "for"} <= set(eyes.card)
    picture, ids = road_picture(np.random.default_rng(0))
    seen = (np.asarray(eyes(picture)) == 1).astype(np.uint8)
    near, grown = np.s_[120:], np.ones((5, 5), np.uint8)
    assert (cv2.dilate(seen, grown) * ids)[near].sum() > 0.6 * ids[near].sum()
    assert (seen * cv2.dilate(ids, grown))[near].sum() > 0.8 * seen[near].sum()


@pytest.mark.slow
def test_the_eyes_for_garages_see_slot_lines_and_pillars():
    """Views of two halls that taught nobody: pillars, which the others never tell; paint to two pixels, and more of
    what they call paint is paint. They state what they are for."""
    for_roads, for_garages = Eyes.load(SHIPPED), Eyes.load(SHIPPED_GARAGE)
    assert SHIPPED_GARAGE.stat().st_size < 2.5e6 and {"taught", "figures", "limits", "for"} <= set(for_garages.card)
    views = [view for seed in (901, 902) for view in street_views(np.random.default_rng(seed), 5, (320, 224), 1, True)]
    images = [image for view in views for image in labelled(view, for_garages.table)]
    before, now = ({score.name: score for score in class_scores(eyes, images)} for eyes in (for_roads, for_garages))
    assert before["pillar"].recall == 0.0 and now["pillar"].recall > 0.15
    assert now["pillar"].error_px < 0.5 * before["pillar"].error_px
    assert now["road_paint"].error_px < min(2.0, 0.8 * before["road_paint"].error_px)
    assert now["road_paint"].precision > 1.25 * before["road_paint"].precision
    assert now["road_paint"].recall > 1.5 * before["road_paint"].recall


@pytest.mark.parametrize("path", [SHIPPED, SHIPPED_GARAGE], ids=["net", "net:garage"])
def test_what_ships_is_the_same_as_onnx(path, tmp_path):
    runtime = pytest.importorskip("onnxruntime")
    eyes = Eyes.load(path)
    write_onnx(tmp_path / "a.onnx", eyes.network, eyes.config.num_outputs)
    picture = ready(working_image(road_picture(np.random.default_rng(1))[0]))[:192, :320]
    session = runtime.InferenceSession(str(tmp_path / "a.onnx"))
    (told,) = session.run(None, {"picture": picture.transpose(2, 0, 1)[None]})
    ours = np.asarray(eyes.network(jnp.asarray(picture)))
    np.testing.assert_allclose(told[0].transpose(1, 2, 0), ours, atol=1e-4)
