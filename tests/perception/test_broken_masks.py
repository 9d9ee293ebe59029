"""Broken masks, presets and class tables: read, or refused in one line, in bounded time; never another exception.

SEMLOC_FUZZ is the number of broken copies of each file (default 30).
"""

import os
import struct
import time
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.perception import load_class_table, read_mask
from semloc_jax.perception.network import NetworkPreset, NetworkSegmenter, load_network_preset
from tests.maps.io.mutations import mutations
from tests.perception.onnx_files import red_or_blue

COUNT = int(os.environ.get("SEMLOC_FUZZ", "30"))
MAX_S = 10.0
TABLES = Path(__file__).resolve().parents[2] / "semloc_jax" / "perception" / "class_tables"
PRESET = "model: net.onnx\nclass_table: cityscapes\nwidth_px: 48\nheight_px: 32\ntiles: [2, 1]\nmean: [0.4, 0.4, 0.4]\n"


def chunk(kind, content):
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png(width, height, data, depth=8, layout=0):
    header = struct.pack(">IIBBBBB", width, height, depth, layout, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def attempt(path, content, read, number=0):
    path.write_bytes(content)
    started = time.perf_counter()
    try:
        return read(path)
    except SemlocError as error:
        assert "\n" not in str(error) and len(str(error)) < 2000, (number, error)
        return None
    finally:
        assert time.perf_counter() - started < MAX_S, number


def test_broken_masks(tmp_path):
    mask = np.random.default_rng(0).integers(0, 27, (60, 96), dtype=np.uint8)
    original = cv2.imencode(".png", mask)[1].tobytes()
    for number, content in enumerate(mutations(original, 3, 4 * COUNT)):
        found = attempt(tmp_path / "mask.png", content, read_mask, number)
        # A checksum guards every part: what is read is what was written.
        assert found is None or np.array_equal(found, mask), number


def test_broken_bits_behind_right_checksums(tmp_path):
    """Damage that the checksums do not see, as a faulty program writes it."""
    rng = np.random.default_rng(1)
    rows = b"".join(b"\0" + rng.integers(0, 27, 96, dtype=np.uint8).tobytes() for _ in range(60))
    for number, content in enumerate(mutations(zlib.compress(rows), 5, COUNT)):
        found = attempt(tmp_path / "mask.png", png(96, 60, content), read_mask, number)
        assert found is None or found.shape == (60, 96)


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
    started = time.perf_counter()
    try:
        return read_mask(path)
    finally:
        assert time.perf_counter() - started < MAX_S


@pytest.mark.parametrize("name", ["cityscapes", "mapillary", "drive"])
def test_broken_class_tables(tmp_path, name):
    original = (TABLES / f"{name}.yaml").read_bytes()
    for number, content in enumerate(mutations(original, 11, COUNT)):
        attempt(tmp_path / "table.yaml", content, load_class_table, number)


def test_broken_presets_and_networks(tmp_path):
    for number, content in enumerate(mutations(PRESET.encode(), 13, 2 * COUNT)):
        attempt(tmp_path / "preset.yaml", content, load_network_preset, number)
    original = red_or_blue(tmp_path / "net.onnx").read_bytes()
    image = np.zeros((32, 48, 3), np.uint8)
    for number, content in enumerate(mutations(original, 17, COUNT)):
        attempt(
            tmp_path / "broken.onnx",
            content,
            lambda path: NetworkSegmenter(NetworkPreset(model=str(path), backend="onnxruntime"))(image),
            number,
        )
