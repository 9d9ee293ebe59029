"""Mask offset: a known shift is found to hundredths of a pixel whatever the erosion; half-size masks show."""

import cv2
import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.perception import MaskOffset, estimate_mask_offset, load_class_table, mask_offset, read_mask
from semloc_jax.perception.mask_offset import offsets_of_cameras

DRIVE = load_class_table("drive")
HEIGHT, WIDTH, FINE = 240, 360, 8


def bars(seed, shift=(0.0, 0.0), wider_px=0.0):
    """Share of each pixel covered by some bars, moved by `shift` and widened by `wider_px` on each side."""
    rng = np.random.default_rng(seed)
    fine = np.zeros((HEIGHT * FINE, WIDTH * FINE), np.uint8)
    for _ in range(9):
        ends = np.stack([rng.uniform(20, WIDTH - 20, 2), rng.uniform(20, HEIGHT - 20, 2)], axis=1)
        half = rng.uniform(2, 6) + wider_px
        along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        side = np.array([-along[1], along[0]]) * half
        corners = np.array([ends[0] - side, ends[0] + side, ends[1] + side, ends[1] - side]) + shift
        cv2.fillPoly(fine, [np.round(((corners + 0.5) * FINE - 0.5) * 16).astype(np.int32)], 255, shift=4)
    return cv2.resize(fine, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(float) / 255


def images(num, contrast=100):
    rng = np.random.default_rng(7)
    return [
        np.clip(80 + contrast * bars(seed) + rng.normal(0, 4, (HEIGHT, WIDTH)), 0, 255).astype(np.uint8)
        for seed in range(num)
    ]


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.4, -0.6), (-1.3, 0.8)])
@pytest.mark.parametrize("wider_px", [0.0, -0.7])
def test_a_known_shift_is_found_apart_from_erosion(shift, wider_px):
    masks = [np.where(bars(seed, shift, wider_px) >= 0.5, 10, 1).astype(np.uint8) for seed in range(8)]
    offset = estimate_mask_offset(images(8), masks, DRIVE)
    assert offset[:2] == pytest.approx(shift, abs=0.06)
    assert max(offset.sigma_du_px, offset.sigma_dv_px) < 0.05
    assert offset.is_significant == (shift != (0.0, 0.0))


def test_frames_that_say_different_offsets_do_not_count():
    # What lies off in some frames only is an edge beside the paint, not the way the masks were made.
    shifts = [(0.0, 0.0), (0.0, 0.0), (1.6, 1.5), (1.6, 1.5)] * 2
    masks = [np.where(bars(seed, shift) >= 0.5, 10, 1).astype(np.uint8) for seed, shift in enumerate(shifts)]
    offset = estimate_mask_offset(images(8), masks, DRIVE)
    assert offset.disagreement_px > 0.7
    assert not offset.is_significant


def test_one_frame_alone_is_not_believed():
    mask = np.where(bars(0, (1.0, 0.0)) >= 0.5, 10, 1).astype(np.uint8)
    offset = estimate_mask_offset(images(1), [mask], DRIVE)
    assert offset.du_px == pytest.approx(1.0, abs=0.1)
    assert not offset.is_significant


def test_dark_poles_before_a_bright_sky_serve_too():
    masks = [np.where(bars(seed, (0.5, 0.3)) >= 0.5, 20, 6).astype(np.uint8) for seed in range(8)]
    offset = estimate_mask_offset(images(8, contrast=-60), masks, DRIVE)
    assert offset[:2] == pytest.approx((0.5, 0.3), abs=0.08)


def test_mistakes_are_named():
    mask = np.ones((HEIGHT, WIDTH), np.uint8)
    with pytest.raises(SemlocError, match="1 images and 2 masks"):
        estimate_mask_offset(images(1), [mask, mask], DRIVE)
    with pytest.raises(SemlocError, match="360x240 and 240x360 px"):
        estimate_mask_offset(images(1), [mask.T], DRIVE)
    with pytest.raises(SemlocError, match="only 0 mask boundary points"):
        estimate_mask_offset(images(1), [mask], DRIVE)


def test_edges_are_those_of_the_whole_mask_though_only_what_is_around_paint_is_looked_at(monkeypatch):
    mask = np.where(bars(3) >= 0.5, 10, 1).astype(np.uint8)
    mask[:, : WIDTH // 2] = 1
    known = images(4)[3], mask, DRIVE, range(len(DRIVE.channels)), 0
    found = {}
    for around_px in (mask_offset._AROUND_PX, WIDTH, 0):
        monkeypatch.setattr(mask_offset, "_AROUND_PX", around_px)
        found[around_px] = mask_offset._frame_edges(*known)
    near, whole, too_near = found.values()
    assert sum(len(part.layer) for part in near) > 200
    np.testing.assert_equal(near, whole)
    assert not np.array_equal(too_near[0].gradient, whole[0].gradient)


@pytest.mark.data
def test_half_resolution_masks_of_the_road_drive_lie_half_a_pixel_off(road_dir):
    paths = sorted((road_dir / "rgb" / "front").glob("*.jpg"))[::12]
    pictures = [cv2.imread(str(path)) for path in paths]
    found = {}
    for source in ("sem", "sem_net"):
        masks = [read_mask(road_dir / source / "front" / f"{path.stem}.png") for path in paths]
        found[source] = estimate_mask_offset(pictures, masks, DRIVE)
    # Exact and degraded masks compared with each other differ by 0.36...0.48 px in both directions.
    difference = np.subtract(found["sem_net"][:2], found["sem"][:2])
    assert difference == pytest.approx((0.45, 0.45), abs=0.12)
    assert found["sem_net"].is_significant and not found["sem"].is_significant


def told(du_px, dv_px, disagreement_px=0.1):
    return MaskOffset(du_px, dv_px, 0.03, 0.03, 500, disagreement_px)


@pytest.mark.parametrize(
    ("right", "rear", "expected"),
    [
        (told(0.54, 0.40), told(1.9, 0.3, disagreement_px=2.0), {"left", "right", "rear"}),
        (told(0.54, 0.40), None, {"left", "right", "rear"}),
        (told(0.54, 0.40), told(0.02, 0.03), {"left", "right"}),  # its own frames say that there is none
        (told(-0.9, 0.40), None, {"left", "right"}),  # cameras that differ say nothing of a third
        (None, None, {"left"}),  # one camera alone says nothing of others
    ],
)
def test_a_camera_without_an_offset_of_its_own_takes_that_of_the_others(right, rear, expected):
    found = {"left": told(0.50, 0.46), "right": right, "rear": rear, "tele": None}
    size_px = {"left": (640, 400), "right": (640, 400), "rear": (640, 400), "tele": (1280, 800)}
    taken = offsets_of_cameras(found, size_px)
    assert set(taken) == expected  # never tele, whose masks are of another size
    assert taken["left"] == (0.50, 0.46)
    if "rear" in expected:
        assert taken["rear"] == pytest.approx((0.52, 0.43))
