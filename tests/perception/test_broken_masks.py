"""Broken masks, presets and class tables: read, or refused in one line, in bounded time; never another exception."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.perception import load_class_table, read_mask
from semloc_jax.perception.network import NetworkPreset, NetworkSegmenter, load_network_preset
from semloc_jax.perception.visibility import visibility, visibility_text
from tests.maps.io.mutations import COUNTS, break_often, stops_hangs
from tests.perception.onnx_files import red_or_blue

TABLES = Path(__file__).resolve().parents[2] / "semloc_jax" / "perception" / "class_tables"
PRESET = "model: net.onnx\nclass_table: cityscapes\nwidth_px: 48\nheight_px: 32\ntiles: [2, 1]\nmean: [0.4, 0.4, 0.4]\n"


def chunk(kind, content):
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png(width, height, data, depth=8, layout=0):
    header = struct.pack(">IIBBBBB", width, height, depth, layout, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def kept(path, content):
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("count", COUNTS)
def test_broken_masks(tmp_path, count):
    mask = np.random.default_rng(0).integers(0, 27, (60, 96), dtype=np.uint8)
    original = cv2.imencode(".png", mask)[1].tobytes()

    def use(content):
        # A checksum guards every part: what is read is what was written.
        assert np.array_equal(read_mask(kept(tmp_path / "mask.png", content)), mask)

    assert break_often(original, 3 * count, use) > count


@pytest.mark.parametrize("count", COUNTS)
def test_broken_bits_behind_right_checksums(tmp_path, count):
    """Damage that the checksums do not see, as a faulty program writes it."""
    rng = np.random.default_rng(1)
    rows = b"".join(b"\0" + rng.integers(0, 27, 96, dtype=np.uint8).tobytes() for _ in range(60))

    def use(content):
        assert read_mask(kept(tmp_path / "mask.png", png(96, 60, content))).shape == (60, 96)

    break_often(zlib.compress(rows), count, use)


def test_bombs_are_refused(tmp_path):
    """Sizes that no memory holds, and a small file that unpacks without end."""
    zeros = zlib.compress(b"\0" * 10_000_000, 9)
    for width, height in ((2**31 - 1, 2**31 - 1), (0, 5), (100_000, 100_000), (60_000, 60_000)):
        with pytest.raises(SemlocError):
            attempt_or_raise(tmp_path / "mask.png", png(width, height, zeros))
    with pytest.raises(SemlocError):
        attempt_or_raise(tmp_path / "mask.png", png(8, 8, zeros, depth=16))


def attempt_or_raise(path, content):
    path.write_bytes(content)
    with stops_hangs():
        return read_mask(path)


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("name", ["cityscapes", "mapillary", "drive"])
def test_broken_class_tables(tmp_path, name, count):
    """Tables that are read say what masks of another table show in them, whatever that is."""
    mask = np.arange(256, dtype=np.uint8).reshape(16, 16)

    def use(content):
        table = load_class_table(kept(tmp_path / "table.yaml", content))
        table.report([mask])
        visibility_text(visibility(table, [mask]), table.name, None)

    break_often((TABLES / f"{name}.yaml").read_bytes(), count, use)


@pytest.mark.parametrize("count", COUNTS)
def test_broken_presets(tmp_path, count):
    def use(content):
        load_network_preset(kept(tmp_path / "preset.yaml", content))

    assert break_often(PRESET.encode(), count, use) > 0


@pytest.mark.parametrize("count", COUNTS)
def test_broken_networks(tmp_path, count):
    pytest.importorskip("onnxruntime")
    original = red_or_blue(tmp_path / "net.onnx").read_bytes()
    image = np.zeros((32, 48, 3), np.uint8)

    def use(content):
        path = kept(tmp_path / "broken.onnx", content)
        NetworkSegmenter(NetworkPreset(model=str(path), backend="onnxruntime"))(image)

    assert break_often(original, count, use) > 0
