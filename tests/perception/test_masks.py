"""Mask files: ids arrive unchanged, and whatever is no mask is refused with the reason."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.perception import read_mask

IDS = np.random.default_rng(0).integers(0, 256, (37, 53), dtype=np.uint8)


def write_png(path, rows, depth, layout, palette=None):
    """A PNG written by hand, independent of any image library."""

    def chunk(kind, content):
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    width = rows.shape[1] * 8 // depth
    data = b"".join(b"\0" + row.tobytes() for row in rows)
    header = struct.pack(">IIBBBBB", width, rows.shape[0], depth, layout, 0, 0, 0)
    colours = chunk(b"PLTE", palette.tobytes()) if palette is not None else b""
    body = chunk(b"IHDR", header) + colours + chunk(b"IDAT", zlib.compress(data)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)


def test_grey_png_gives_its_ids(tmp_path):
    cv2.imwrite(str(tmp_path / "m.png"), IDS)
    assert np.array_equal(read_mask(tmp_path / "m.png", size_px=(53, 37)), IDS)


def test_palette_png_gives_its_indices_and_not_its_colours(tmp_path):
    palette = np.random.default_rng(1).integers(0, 256, (256, 3), dtype=np.uint8)
    write_png(tmp_path / "m.png", IDS, 8, 3, palette)
    assert np.array_equal(read_mask(tmp_path / "m.png"), IDS)


@pytest.mark.parametrize("depth", [1, 2, 4])
@pytest.mark.parametrize("layout", [0, 3])
def test_packed_png_gives_its_ids(tmp_path, depth, layout):
    ids = np.random.default_rng(depth).integers(0, 2**depth, (9, 16), dtype=np.uint8)
    bits = np.unpackbits(ids[..., None], axis=-1)[..., -depth:]
    palette = np.arange(3 * 2**depth, dtype=np.uint8) if layout == 3 else None
    write_png(tmp_path / "m.png", np.packbits(bits.reshape(9, -1), axis=-1), depth, layout, palette)
    assert np.array_equal(read_mask(tmp_path / "m.png"), ids)


def test_a_file_cut_off_anywhere_is_refused(tmp_path):
    cv2.imwrite(str(tmp_path / "m.png"), IDS)
    whole = (tmp_path / "m.png").read_bytes()
    for size in (9, 40, len(whole) // 2, len(whole) - 1):
        (tmp_path / "m.png").write_bytes(whole[:size])
        with pytest.raises(SemlocError, match="cut off or damaged"):
            read_mask(tmp_path / "m.png")


def test_a_flipped_byte_is_noticed(tmp_path):
    cv2.imwrite(str(tmp_path / "m.png"), IDS)
    whole = bytearray((tmp_path / "m.png").read_bytes())
    whole[len(whole) // 2] ^= 255
    (tmp_path / "m.png").write_bytes(bytes(whole))
    with pytest.raises(SemlocError, match="cut off or damaged"):
        read_mask(tmp_path / "m.png")


@pytest.mark.parametrize(
    ("image", "name", "message"),
    [
        (np.dstack([IDS] * 3), "m.png", "RGB colour.*map its colours back"),
        (np.dstack([IDS] * 4), "m.png", "RGB with alpha"),
        (IDS.astype(np.uint16), "m.png", "grey, 16 bit"),
        (IDS, "m.jpg", "not a PNG file"),
    ],
)
def test_what_is_no_mask_is_refused(tmp_path, image, name, message):
    cv2.imwrite(str(tmp_path / name), image)
    with pytest.raises(SemlocError, match=message):
        read_mask(tmp_path / name)


def test_missing_file_and_wrong_size(tmp_path):
    with pytest.raises(SemlocError, match="no such file"):
        read_mask(tmp_path / "none.png")
    cv2.imwrite(str(tmp_path / "m.png"), IDS)
    with pytest.raises(SemlocError, match="given 53x37 px, expected 960x600"):
        read_mask(tmp_path / "m.png", size_px=(960, 600))
