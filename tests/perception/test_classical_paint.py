"""Classical paint segmenter: paint of any shape in any direction, and not what merely shines."""

from functools import lru_cache

import cv2
import numpy as np
import pytest

from semloc_jax.cameras import PinholeCamera
from semloc_jax.cameras.io import read_calibration
from semloc_jax.errors import SemlocError
from semloc_jax.perception import ClassicalPaintSegmenter, GroundView, load_class_table, read_mask
from tests.perception.test_ground_view import pose

SCALE = 50.0
"""Pixels per metre of the painted ground."""
CAMERA = PinholeCamera(600.0, 600.0, 479.5, 299.5, 960, 600)


@lru_cache(maxsize=1)
def ground_texture(yellow_on_concrete):
    """Top view of 40 m x 40 m around the camera with paint, shadow and texture; brightness BGR and paint mask."""
    rng = np.random.default_rng(3)
    size = int(40 * SCALE)
    paint = np.zeros((size, size), np.uint8)

    def polygon(*corners_m):
        corners = [(size / 2 - y * SCALE, size / 2 - x * SCALE) for x, y in corners_m]
        cv2.fillPoly(paint, [np.round(corners).astype(np.int32)], 255)

    for y in (-1.75, 1.75, 5.0):
        polygon((-20, y - 0.07), (20, y - 0.07), (20, y + 0.07), (-20, y + 0.07))
    polygon((14.0, -1.5), (14.4, -1.5), (14.4, 1.5), (14.0, 1.5))
    for y in np.arange(-1.2, 1.3, 0.8):
        polygon((9.0, y - 0.2), (11.5, y - 0.2), (11.5, y + 0.2), (9.0, y + 0.2))
    for x in np.arange(-3.0, 5.1, 1.2):
        polygon((x, 7.0), (x, 9.5), (x + 0.4, 9.5), (x + 0.4, 7.0))
    polygon((6.0, -0.1), (7.5, -0.1), (7.5, -0.35), (8.2, 0.0), (7.5, 0.35), (7.5, 0.1), (6.0, 0.1))
    road, stroke = (150, (70, 175, 190)) if yellow_on_concrete else (85, (200, 205, 205))
    grey = road + cv2.GaussianBlur(rng.normal(0, 25, (size, size)), (0, 0), 2.0)
    top = np.where(paint[..., None] > 0, np.array(stroke, float), grey[..., None])
    # A shadow across everything, with a soft edge.
    shade = np.ones((size, 1))
    shade[size // 2 - int(7.2 * SCALE) : size // 2 - int(4.5 * SCALE)] = 0.55
    return top * cv2.GaussianBlur(shade, (1, 9), 0)[..., None], paint


def photograph(top, T_base_cam, noise=3.0):
    """The ground as the camera sees it, with four rays a pixel, sky above and some noise; and ground share of paint."""
    samples = []
    for du, dv in ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)):
        v, u = np.mgrid[:600, :960].astype(float)
        ray = np.asarray(CAMERA.unproject(np.stack([u + du, v + dv], axis=-1))[0]) @ T_base_cam[:3, :3].T
        reach = T_base_cam[2, 3] / np.maximum(-ray[..., 2], 1e-6)
        xy = T_base_cam[:2, 3] + reach[..., None] * ray[..., :2]
        at = (top.shape[0] / 2 - xy[..., ::-1] * SCALE).astype(np.float32)
        seen = cv2.remap(top.astype(np.float32), at, None, cv2.INTER_LINEAR, borderValue=(90, 90, 90))
        samples.append(np.where((reach < 30)[..., None] if seen.ndim == 3 else reach < 30, seen, 0.0))
    picture = np.mean(samples, axis=0)
    if picture.ndim == 3:
        picture[:200] = (210, 180, 160)
        picture += np.random.default_rng(1).normal(0, noise, picture.shape)
    return picture


@lru_cache
def scene(yellow_on_concrete, yaw_deg):
    """Pose of a camera, its picture of the painted ground, not to be written into, and the share of paint of pixels."""
    T_base_cam = pose(yaw_deg, 12.0, 1.6)
    top, paint = ground_texture(yellow_on_concrete)
    picture = np.clip(photograph(top, T_base_cam), 0, 255).astype(np.uint8)
    picture.setflags(write=False)
    return T_base_cam, picture, photograph(paint, T_base_cam) / 255


def scores(mask, truth, around_px=1):
    """Share of the mask that lies on paint and share of the paint that the mask covers, `around_px` allowed."""
    near = np.ones((2 * around_px + 1,) * 2, np.uint8)
    wide_truth, wide_mask = (cv2.dilate(part.astype(np.uint8), near) > 0 for part in (truth, mask))
    return (mask & wide_truth).sum() / max(mask.sum(), 1), (truth & wide_mask).sum() / truth.sum()


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0])
@pytest.mark.parametrize("yellow_on_concrete", [False, True])
def test_paint_is_found_in_any_direction_through_a_shadow(yellow_on_concrete, yaw_deg):
    T_base_cam, image, share = scene(yellow_on_concrete, yaw_deg)
    ids = ClassicalPaintSegmenter(CAMERA, T_base_cam)(image)
    mask, truth = ids == 1, share > 127 / 255
    near = GroundView.of(CAMERA, T_base_cam, range_m=13.0).bev_uv[..., 0] > 0
    precision, recall = scores(mask & near, truth & near)
    assert precision > 0.97
    assert recall > (0.75 if yellow_on_concrete else 0.9)
    assert load_class_table("lane_paint").report(ids).fits


def test_outline_lies_on_the_edge_of_the_paint():
    T_base_cam, image, share = scene(False, 0.0)
    mask = ClassicalPaintSegmenter(CAMERA, T_base_cam)(image)
    rows = slice(330, 440)
    for columns in (slice(100, 470), slice(560, 860)):  # without the arrow
        covered = share[rows, columns].sum(axis=1)
        place = np.arange(columns.stop - columns.start)
        centre = (share[rows, columns] * place).sum(axis=1) / np.maximum(covered, 1e-9)
        found = (mask == 1)[rows, columns]
        lanes = (covered > 1) & (found.sum(axis=1) > 0) & (np.abs(found.sum(axis=1) - covered) < 2)
        ours = (found * place).sum(axis=1) / np.maximum(found.sum(axis=1), 1)
        assert lanes.sum() > 30
        assert abs(np.mean((ours - centre)[lanes])) < 0.1
        assert abs(np.mean((found.sum(axis=1) - covered)[lanes])) < 0.35


def test_a_bright_rim_on_a_dark_tyre_is_no_paint():
    T_base_cam, image, _ = scene(False, 0.0)
    image = image.copy()
    cv2.circle(image, (480, 470), 40, (25, 25, 25), -1)
    cv2.circle(image, (480, 470), 14, (200, 200, 200), -1)
    mask = ClassicalPaintSegmenter(CAMERA, T_base_cam)(image)
    assert not (mask[425:515, 435:525] == 1).any()


def test_hidden_pixels_come_out_as_ignored():
    hidden = np.zeros((600, 960), bool)
    hidden[500:] = True
    T_base_cam, image, _ = scene(False, 0.0)
    mask = ClassicalPaintSegmenter(CAMERA, T_base_cam, hidden=hidden)(image)
    assert (mask[500:] == 255).all() and (mask[:500] != 255).all()


def test_what_is_bright_on_traffic_is_no_paint_and_paint_beside_it_stays():
    T_base_cam, image, _ = scene(False, 0.0)
    segmenter = ClassicalPaintSegmenter(CAMERA, T_base_cam, hidden=np.zeros((600, 960), bool))
    plain = segmenter(image)
    traffic = np.zeros((600, 960), bool)
    traffic[380:560, 430:530] = True
    van = image.copy()
    van[traffic] = 60
    van[390:550, 445:452] = van[390:550, 505:512] = 230
    mask = segmenter(van, traffic=traffic)
    assert (mask[traffic] == 255).all()
    away = ~cv2.dilate(traffic.astype(np.uint8), np.ones((41, 41), np.uint8)).astype(bool)
    assert (mask[away] != plain[away]).mean() < 0.001 and (plain[away] == 1).any()
    with pytest.raises(SemlocError, match="traffic"):
        segmenter(image, traffic=traffic[:100])


def test_mistakes_are_named():
    with pytest.raises(SemlocError, match="give both camera and T_base_cam"):
        ClassicalPaintSegmenter(CAMERA)
    with pytest.raises(SemlocError, match="640x480 px for a camera of 960x600"):
        ClassicalPaintSegmenter(CAMERA, pose(0.0, 12.0, 1.6))(np.zeros((480, 640, 3), np.uint8))
    with pytest.raises(SemlocError, match="expected BGR"):
        ClassicalPaintSegmenter()(np.zeros((480, 640), np.uint8))


@pytest.mark.slow
@pytest.mark.data
def test_rendered_drive_by_day_and_by_night(road_dir):
    rig = read_calibration(road_dir / "calib.yaml")
    segment = ClassicalPaintSegmenter(rig.cameras[0], np.asarray(rig.T_base_cam[0]))
    in_range = GroundView.of(rig.cameras[0], np.asarray(rig.T_base_cam[0]), range_m=35.0).bev_uv[..., 0] > 0
    table = load_class_table("drive")
    paint_ids = [i for channel in table.channels[:5] for i in channel.mask_ids]
    paths = sorted((road_dir / "rgb" / "front").glob("*.jpg"))
    for first, last, least_recall in ((0, 100, 0.8), (100, 150, 0.5)):
        masks, truths = [], []
        for path in paths[first:last:16]:
            masks.append((segment(cv2.imread(str(path))) == 1) & in_range)
            truth = read_mask(road_dir / "sem" / "front" / f"{path.stem}.png")
            truths.append(np.isin(truth, paint_ids) & in_range)
        precision, recall = scores(np.concatenate(masks), np.concatenate(truths), around_px=2)
        assert precision > 0.9
        assert recall > least_recall


@pytest.mark.data
def test_real_highway_images_without_calibration_show_both_lane_lines(data_dir):
    folder = data_dir / "udacity_laneline" / "test_images"
    if not folder.is_dir():
        pytest.skip(f"no udacity_laneline in {data_dir}")
    segment = ClassicalPaintSegmenter()
    paths = sorted(folder.glob("*.jpg"))
    for path in paths:
        mask = segment(cv2.imread(str(path))) == 1
        assert mask[:310].sum() == 0
        assert mask[330:, :460].sum() > 300 and mask[330:, 500:].sum() > 300
        assert mask.mean() < 0.04
    assert len(paths) == 6
