"""Networks with sizes, letterbox and tiles: the mask lies on the image to a small part of a pixel, whatever is done."""

import dataclasses
import importlib.util

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.perception import load_class_table
from semloc_jax.perception.network import NetworkPreset, NetworkSegmenter, load_network_preset
from semloc_jax.perception.network_recipes import RECIPES
from semloc_jax.perception.onnx_header import read_onnx_header
from semloc_jax.perception.visibility import visibility, visibility_text
from semloc_jax.structs import ElementClass
from tests.perception.onnx_files import red_and_blue_apart, red_or_blue

PLAIN = {"mean": (0.0, 0.0, 0.0), "std": (1.0, 1.0, 1.0)}
HAS_RUNTIME = importlib.util.find_spec("onnxruntime") is not None
BACKENDS = [
    "opencv",
    pytest.param("onnxruntime", marks=pytest.mark.skipif(not HAS_RUNTIME, reason="onnxruntime is not installed")),
]


def square(size, box):
    """A red square on black; box is (left, top, right, bottom)."""
    image = np.zeros((size[1], size[0], 3), np.uint8)
    image[box[1] : box[3], box[0] : box[2], 2] = 255
    return image


def centre(mask, value=1):
    v, u = np.nonzero(mask == value)
    return u.mean(), v.mean()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("image_px", "letterbox", "tiles"),
    [
        ((192, 128), True, (1, 1)),  # the shape of the network
        ((192, 96), True, (1, 1)),  # flatter: filled above and below
        ((120, 128), True, (1, 1)),  # narrower: filled left and right
        ((192, 96), False, (1, 1)),  # stretched
        ((384, 256), True, (2, 2)),
        ((400, 250), True, (3, 2)),
        ((50, 30), True, (1, 1)),  # enlarged
    ],
)
def test_masks_lie_on_their_images(tmp_path, backend, image_px, letterbox, tiles):
    model = red_or_blue(tmp_path / "net.onnx", size=(96, 64), reduced=4)
    size = {"width_px": 96, "height_px": 64}
    preset = NetworkPreset(model=str(model), letterbox=letterbox, tiles=tiles, backend=backend, **size, **PLAIN)
    w, h = image_px
    box = (w // 3, h // 3, w // 3 + w // 4, h // 3 + h // 4)
    mask = NetworkSegmenter(preset)(square(image_px, box))
    assert mask.shape == (h, w)
    expected = (0.5 * (box[0] + box[2] - 1), 0.5 * (box[1] + box[3] - 1))
    # A pixel of the network's output covers this many pixels of the image; the mask is off by a small part of it.
    pixel = 4 * max(w / tiles[0] / 96, h / tiles[1] / 64)
    assert centre(mask) == pytest.approx(expected, abs=0.12 * pixel + 0.02)


def test_tiles_show_what_one_piece_misses(tmp_path):
    model = red_or_blue(tmp_path / "net.onnx", size=(96, 64), reduced=4)
    small = square((960, 640), (500, 300, 524, 324))
    one = NetworkSegmenter(NetworkPreset(model=str(model), width_px=96, height_px=64, **PLAIN))(small)
    many = NetworkSegmenter(NetworkPreset(model=str(model), width_px=96, height_px=64, tiles=(8, 8), **PLAIN))(small)
    assert (one == 1).sum() == 0
    assert (many == 1).sum() == pytest.approx(24 * 24, rel=0.25)


@pytest.mark.parametrize("backend", BACKENDS)
def test_batches_of_free_size(tmp_path, backend):
    model = red_or_blue(tmp_path / "net.onnx", size=None, batch=None)
    network = NetworkSegmenter(NetworkPreset(model=str(model), backend=backend, batch=3, **PLAIN))
    images = [square((40, 30), (i, i, i + 9, i + 5)) for i in range(5)] + [square((20, 30), (2, 3, 9, 9))]
    masks = network.segment(images)
    for image, mask in zip(images, masks, strict=True):
        assert np.array_equal(mask, image[..., 2] // 255)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_fixed_batch_is_filled(tmp_path, backend):
    model = red_or_blue(tmp_path / "net.onnx", size=(40, 30), batch=4)
    network = NetworkSegmenter(NetworkPreset(model=str(model), backend=backend, batch=4, **PLAIN))
    images = [square((40, 30), (i, i, i + 9, i + 5)) for i in range(6)]
    if backend == "opencv":  # which does not tell the batch of the file
        images = images[:4]
    for image, mask in zip(images, network.segment(images), strict=True):
        assert np.array_equal(mask, image[..., 2] // 255)


def test_normalisation_of_bytes(tmp_path):
    model = red_or_blue(tmp_path / "net.onnx", size=(48, 32))
    image = np.full((32, 48, 3), 0, np.uint8)
    image[..., 2] = 150
    as_bytes = NetworkPreset(model=str(model), value_range=255.0, mean=(140.0, 0.0, 0.0), std=(10.0, 1.0, 1.0))
    assert (NetworkSegmenter(as_bytes)(image) == 1).all()  # (150 - 140) / 10 = 1 > 0.5
    shifted = dataclasses.replace(as_bytes, mean=(148.0, 0.0, 0.0))
    assert (NetworkSegmenter(shifted)(image) == 0).all()  # (150 - 148) / 10 = 0.2


def test_presets_are_read_and_checked(tmp_path):
    red_or_blue(tmp_path / "net.onnx")
    path = tmp_path / "preset.yaml"
    path.write_text(
        "model: net.onnx\nclass_table: cityscapes\nwidth_px: 48\nheight_px: 32\ntiles: [2, 1]\nmean: [0, 0, 0]\n"
    )
    preset = load_network_preset(path)
    assert preset.model == str(tmp_path / "net.onnx")
    assert (preset.tiles, preset.mean, preset.class_table) == ((2, 1), (0.0, 0.0, 0.0), "cityscapes")
    for text, words in {
        "modle: x": "unknown key 'modle'; did you mean 'model'",
        "tiles: 3": "expected something like",
        "tiles: [1, 2, 3]": "3 values",
        "letterbox: 1": "expected something like True",
        "width_px: wide": "expected something like 0",
        "std: [0, 1, 1]": "std above 0",
        "[1, 2": "not readable as YAML",
        "just words": "holds no keys",
    }.items():
        path.write_text(text)
        with pytest.raises(SemlocError, match=words):
            load_network_preset(path)


@pytest.mark.parametrize("backend", BACKENDS)
def test_networks_that_do_not_fit_are_named(tmp_path, backend):
    (tmp_path / "broken.onnx").write_bytes(b"no network")
    with pytest.raises(SemlocError, match=r"broken\.onnx: .* cannot read it"):
        NetworkSegmenter(NetworkPreset(model=str(tmp_path / "broken.onnx"), backend=backend))
    with pytest.raises(SemlocError, match="no such file"):
        NetworkSegmenter(NetworkPreset(model=str(tmp_path / "none.onnx"), backend=backend))
    with pytest.raises(SemlocError, match="names no model"):
        NetworkSegmenter(NetworkPreset())


def test_what_masks_can_see_of_a_map():
    table = load_class_table("cityscapes")
    mask = np.zeros((10, 10), np.uint8)
    mask[:3, :2] = 5  # pole
    rows = {row.label: row for row in visibility(table, [mask, np.zeros_like(mask)])}
    assert rows[ElementClass.LANE_MARKING].channel == "" and not rows[ElementClass.LANE_MARKING].is_seen
    pole = rows[ElementClass.POLE]
    assert (pole.channel, pole.share, pole.frames) == ("pole", 0.03, 0.5)
    text = visibility_text(rows.values(), "cityscapes", {ElementClass.POLE: 7, ElementClass.LANE_MARKING: 90})
    assert "lane_marking    not in the table" in text and text.splitlines()[-1].endswith("of this map: pole")
    assert "curb" not in text


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_network_with_an_output_for_each_class_gives_their_bits(tmp_path, backend):
    """TwinLite: drivable area and lane lines apart, 0 ... 1 without mean; ids of the class table `twinlite`."""
    model = red_and_blue_apart(tmp_path / "twinlite.onnx")
    preset = dataclasses.replace(RECIPES["twinlite"], model=str(model), backend=backend)
    image = np.zeros((360, 640, 3), np.uint8)
    image[:180, :, 2] = 255  # red above: drivable
    image[:, 320:, 0] = 255  # blue to the right: lane line
    mask = NetworkSegmenter(preset)(image)
    assert [int(mask[v, u]) for v, u in ((90, 160), (90, 480), (270, 160), (270, 480))] == [2, 3, 0, 1]
    assert set(np.unique(mask)) <= load_class_table("twinlite").id_names.keys()


@pytest.mark.parametrize("backend", BACKENDS)
def test_one_of_several_outputs_has_to_be_named(tmp_path, backend):
    model = red_and_blue_apart(tmp_path / "net.onnx")
    with pytest.raises(
        SemlocError, match=r"2 outputs \(da, ll\), 1 expected; name what holds the classes: --output NAME"
    ):
        NetworkSegmenter(NetworkPreset(model=str(model), backend=backend))
    with pytest.raises(SemlocError, match="no output 'lines'; expected one of da, ll"):
        NetworkSegmenter(NetworkPreset(model=str(model), backend=backend, output="lines"))


@pytest.mark.parametrize("backend", BACKENDS)
def test_every_backend_takes_the_size_that_the_file_states(tmp_path, backend):
    segmenter = NetworkSegmenter(
        NetworkPreset(model=str(red_or_blue(tmp_path / "net.onnx", size=(96, 64))), backend=backend)
    )
    assert (segmenter.size_px, segmenter.backend.batch) == ((96, 64), 1)
    free = NetworkSegmenter(
        NetworkPreset(model=str(red_or_blue(tmp_path / "free.onnx", size=None, batch=None)), backend=backend)
    )
    assert (free.size_px, free.backend.batch) == (None, None)


def test_a_file_that_is_no_network_has_no_header(tmp_path):
    whole = red_or_blue(tmp_path / "net.onnx").read_bytes()
    for name, content in (("empty", b""), ("text", b"not a network"), ("cut", whole[: len(whole) // 2])):
        (tmp_path / name).write_bytes(content)
        header = read_onnx_header(tmp_path / name)
        assert header is None or header.inputs == () or header.outputs == ()
