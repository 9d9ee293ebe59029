"""Rigs: selection, groups, and whether the whole chain from map to pixel meets the rendered drives."""

import json
from itertools import pairwise

import cv2
import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from semloc_jax.cameras import KannalaBrandtCamera, PinholeCamera, Rig
from semloc_jax.cameras.bev import T_base_bev
from semloc_jax.cameras.io import read_calibration
from semloc_jax.errors import SemlocError

PINHOLE = PinholeCamera(700, 700, 480, 300, 960, 600)
FISHEYE = KannalaBrandtCamera(196, 196, 320, 240, 640, 480, -0.013)


def poses(num):
    T = np.tile(np.eye(4), (num, 1, 1))
    T[:, 0, 3] = np.arange(num)
    return T


@pytest.fixture
def rig():
    return Rig([PINHOLE, FISHEYE, PINHOLE.shifted(1, 2)], poses(3), ["front", "left", "rear"])


def test_select_keeps_cameras_with_their_poses(rig):
    chosen = rig.select(["rear", "front"])
    assert chosen.names == ("rear", "front")
    assert float(chosen.cameras[0].cx) == 481.0
    assert chosen.T_base_cam[:, 0, 3].tolist() == [2.0, 0.0]
    assert len(chosen) == 2


def test_groups_hold_one_model_each(rig):
    first, second = rig.groups()
    assert (first.index, second.index) == ((0, 2), (1,))
    assert np.array_equal(first.camera.cx, [480.0, 481.0])
    assert first.T_base_cam[:, 0, 3].tolist() == [0.0, 2.0]
    assert type(second.camera) is KannalaBrandtCamera


def test_rig_passes_through_jit(rig):
    total = jax.jit(lambda r: sum(camera.fx for camera in r.cameras) + r.T_base_cam[:, 0, 3].sum())(rig)
    assert float(total) == pytest.approx(700 + 196 + 700 + 3)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Rig([PINHOLE], poses(2), ["front"]), "one pose and one name"),
        (lambda: Rig([PINHOLE, FISHEYE], poses(2), ["front", "front"]), "rename"),
        (lambda: Rig([PINHOLE], poses(1), ["front"]).select(["back"]), "expected one of front"),
    ],
)
def test_faulty_rigs_say_what_to_do(make, words):
    with pytest.raises(SemlocError, match=words):
        make()


def test_top_view_looks_down_on_the_road():
    """One metre ahead is up in the image, one metre to the left is left."""
    T = T_base_bev()
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    p_bev = np.linalg.inv(T) @ np.array([[1.0, 0, 0, 1], [0, 1.0, 0, 1], [0, 0, 1.0, 1]]).T
    assert np.allclose(p_bev[:3].T, [[0, -1, 0], [-1, 0, 0], [0, 0, -1]])


def read_truth(folder, index):
    row = np.loadtxt(folder / "poses_body.tum")[index]
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_quat(row[4:]).as_matrix(), row[1:4]
    return T


def polygon_centroid(uv):
    u, v = uv.T
    cross = u * np.roll(v, -1) - np.roll(u, -1) * v
    return np.array([(cross * (u + np.roll(u, -1))).sum(), (cross * (v + np.roll(v, -1))).sum()]) / (3 * cross.sum())


def outline_of(feature):
    """Corners of a painted bar (LineString with width) or of an area [k 3]."""
    points = np.array(
        feature["geometry"]["coordinates"][0 if feature["geometry"]["type"] == "Polygon" else slice(None)]
    )
    if feature["geometry"]["type"] == "Polygon":
        return points[:-1]
    along = points[-1] - points[0]
    left = np.cross([0, 0, 1.0], along / np.linalg.norm(along)) * feature["properties"]["width"] / 2
    return np.array([points[0] + left, points[0] - left, points[-1] - left, points[-1] + left])


@pytest.mark.data
@pytest.mark.parametrize(
    ("drive", "classes"), [("road_dir", {"sign", "crosswalk", "arrow", "lane_dashed"}), ("garage_dir", {"slot_line"})]
)
def test_projected_outlines_meet_the_rendered_elements(drive, classes, request):
    """Axes, extrinsics, distortion and pixel centres at once: outlines lie on their pixels without an offset."""
    folder = request.getfixturevalue(drive)
    rig = read_calibration(folder / "calib.yaml")
    elements = json.loads((folder / "element_ids.json").read_text())
    features = json.loads((folder / "map.geojson").read_text())["features"]
    outlines = {f["id"]: outline_of(f) for f in features if f["properties"]["class"] in classes}
    offsets = []
    for index in range(0, len(np.loadtxt(folder / "poses_body.tum")), 10):
        T_map_base = read_truth(folder, index)
        for name, camera, T_base_cam in zip(rig.names, rig.cameras, rig.T_base_cam, strict=True):
            ids = cv2.imread(str(folder / "depth" / name / f"{index:06d}_elem.png"), cv2.IMREAD_UNCHANGED)
            for key, outline in outlines.items():
                mask = ids == elements.index(key)
                if mask.sum() > 150:
                    offsets += offset_of(mask, outline, camera, np.linalg.inv(T_map_base @ T_base_cam))
    offsets = np.array(offsets)
    assert len(offsets) >= 5
    assert np.abs(np.median(offsets, axis=0)).max() < 0.1
    assert np.median(np.linalg.norm(offsets, axis=1)) < 0.25


def offset_of(mask, outline, camera, T_cam_map):
    """Centroid of the mask minus that of the projected outline, if all of the outline is in view."""
    closed = np.vstack([outline, outline[:1]])
    dense = np.concatenate([np.linspace(a, b, 100, endpoint=False) for a, b in pairwise(closed)])
    uv, valid = (np.asarray(a) for a in camera.project(dense @ T_cam_map[:3, :3].T + T_cam_map[:3, 3]))
    if not (valid & np.asarray(camera.in_image(uv[:, 0], uv[:, 1], 3.0))).all():
        return []
    filled = cv2.fillPoly(np.zeros(mask.shape, np.uint8), [np.round(uv * 16).astype(np.int32)], 1, shift=4) > 0
    if (filled & mask).sum() < 0.9 * (filled | mask).sum():
        return []  # partly hidden
    rows, columns = np.nonzero(mask)
    return [np.array([columns.mean(), rows.mean()]) - polygon_centroid(uv)]
