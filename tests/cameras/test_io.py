"""Calibration files: what is read is what was meant, and bad files are refused with a remedy."""

import copy
import logging

import cv2
import jax
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from semloc_jax.cameras import (
    BevCamera,
    BrownConradyCamera,
    CylindricalCamera,
    DoubleSphereCamera,
    KannalaBrandtCamera,
    PinholeCamera,
    PolynomialFisheyeCamera,
    Rig,
    mounted,
)
from semloc_jax.cameras.io import read_calibration, write_calibration
from semloc_jax.errors import SemlocError

T_CAM_IMU = np.eye(4)
T_CAM_IMU[:3, :3] = Rotation.from_euler("xyz", [-90, 0, -88], degrees=True).as_matrix()
T_CAM_IMU[:3, 3] = 0.1, -0.3, 0.05
T_CN_CNM1 = np.eye(4)
T_CN_CNM1[0, 3] = -0.11

DRIVE = {
    "cam0": {
        "name": "front",
        "camera_model": "pinhole",
        "distortion_model": "radtan",
        "intrinsics": [742.3, 743.1, 476.4, 291.7],
        "distortion_coeffs": [-0.118, 0.042, 0.0006, -0.0004],
        "resolution": [960, 600],
        "T_body_cam": [[0, 0, 1, 1.62], [-1, 0, 0, 0.04], [0, -1, 0, 1.43], [0, 0, 0, 1]],
    }
}
KALIBR = {
    "cam0": {
        "cam_overlaps": [1],
        "camera_model": "pinhole",
        "distortion_coeffs": [-0.01, 0.002, -0.003, 0.0004],
        "distortion_model": "equidistant",
        "intrinsics": [461.6, 460.2, 362.7, 246.4],
        "resolution": [752, 480],
        "rostopic": "/cam0/image_raw",
        "T_cam_imu": T_CAM_IMU.tolist(),
        "timeshift_cam_imu": 0.002,
    },
    "cam1": {
        "camera_model": "pinhole",
        "distortion_coeffs": [-0.28, 0.07, 0.0002, 0.0001],
        "distortion_model": "radtan",
        "intrinsics": [458.7, 457.3, 367.2, 248.4],
        "resolution": [752, 480],
        "T_cn_cnm1": T_CN_CNM1.tolist(),
    },
}
CAMERA_INFO = {
    "image_width": 1280,
    "image_height": 720,
    "camera_name": "wide",
    "camera_matrix": {"rows": 3, "cols": 3, "data": [900.0, 0, 640.5, 0, 901.0, 360.5, 0, 0, 1]},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": [-0.3, 0.1, 0.001, -0.002, 0.01]},
    "rectification_matrix": {"rows": 3, "cols": 3, "data": [1, 0, 0, 0, 1, 0, 0, 0, 1]},
}


@pytest.fixture
def write(tmp_path):
    def to_file(content, name="calib.yaml"):
        path = tmp_path / name
        path.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
        return path

    return to_file


def numbers_of(camera, *names):
    return [float(getattr(camera, name)) for name in names]


def test_drive_layout(write):
    rig = read_calibration(write(DRIVE))
    camera = rig.cameras[0]
    assert rig.names == ("front",)
    assert type(camera) is BrownConradyCamera
    assert numbers_of(camera, "fx", "fy", "cx", "cy") == [742.3, 743.1, 476.4, 291.7]
    assert numbers_of(camera, "k1", "k2", "p1", "p2", "k3") == [-0.118, 0.042, 0.0006, -0.0004, 0.0]
    assert camera.resolution == (960, 600)
    assert np.array_equal(rig.T_base_cam[0], DRIVE["cam0"]["T_body_cam"])


@pytest.mark.parametrize("coefficients", [[1e-320] * 4, [1e-320, 0.0, 0.0, 0.0], [-1e-300, 1e-310, 0.0, 0.0]])
@pytest.mark.parametrize("model", ["radtan", "equidistant"])
def test_coefficients_next_to_nothing_bend_nothing(write, model, coefficients):
    content = changed(DRIVE, ["cam0", "distortion_model"], model)
    near, none = (
        read_calibration(write(changed(content, ["cam0", "distortion_coeffs"], values))).cameras[0]
        for values in (coefficients, [0.0] * 4)
    )
    points = np.array([[0.3, 0.1, 2.0], [-1.0, 0.4, 2.0]])
    np.testing.assert_allclose(near.project(points)[0], none.project(points)[0], atol=1e-9)
    assert np.all(near.project(points)[1])


def with_mounting(value):
    content = changed(DRIVE, ["cam0", "T_body_cam"], None)
    content["cam0"]["mounted"] = value
    return content


def test_a_camera_mounted_by_rule_and_level(write):
    value = {"position_m": [1.62, 0.04, 1.43], "down_deg": 3.0, "roll_deg": 0.5}
    rig = read_calibration(write(with_mounting(value)))
    np.testing.assert_allclose(rig.T_base_cam[0], mounted((1.62, 0.04, 1.43), down_deg=3.0, roll_deg=0.5), atol=1e-12)


def test_kalibr_poses_are_inverted_and_chained(write):
    rig = read_calibration(write(KALIBR, "camchain-imucam.yaml"))
    assert rig.names == ("cam0", "cam1")
    assert [type(camera) for camera in rig.cameras] == [KannalaBrandtCamera, BrownConradyCamera]
    assert np.allclose(rig.T_base_cam[0], np.linalg.inv(T_CAM_IMU), atol=1e-12)
    assert np.allclose(rig.T_base_cam[1], np.linalg.inv(T_CN_CNM1 @ T_CAM_IMU), atol=1e-12)


def test_a_kalibr_file_of_a_double_sphere(write):
    """Two numbers stand before the focal lengths, and there is no distortion."""
    lens = {"camera_model": "ds", "intrinsics": [-0.18, 0.59, 186.2, 186.1, 252.8, 254.9], "distortion_model": "none"}
    entry = KALIBR["cam0"] | lens | {"distortion_coeffs": [], "resolution": [512, 512]}
    (camera,) = read_calibration(write({"cam0": entry}, "camchain-imucam.yaml")).cameras
    assert type(camera) is DoubleSphereCamera and camera.resolution == (512, 512)
    assert numbers_of(camera, "xi", "alpha", "fx", "fy", "cx", "cy") == lens["intrinsics"]


def test_openvins_poses_and_directive(write):
    entry = changed(KALIBR, ["cam0", "T_cam_imu"], None)["cam0"] | {"T_imu_cam": np.linalg.inv(T_CAM_IMU).tolist()}
    rig = read_calibration(write("%YAML:1.0\n\n" + yaml.safe_dump({"cam0": entry})))
    assert np.allclose(rig.T_base_cam[0], np.linalg.inv(T_CAM_IMU), atol=1e-12)


def test_eleven_cameras_keep_their_order(write):
    content = {f"cam{i}": DRIVE["cam0"] | {"name": f"c{i}"} for i in range(11)}
    assert read_calibration(write(content)).names == tuple(f"c{i}" for i in range(11))


def test_camera_info_file(write, caplog):
    with caplog.at_level(logging.WARNING):
        rig = read_calibration(write(CAMERA_INFO, "wide.yaml"))
    camera = rig.cameras[0]
    assert rig.names == ("wide",)
    assert numbers_of(camera, "fx", "fy", "cx", "cy", "k3") == [900.0, 901.0, 640.5, 360.5, 0.01]
    assert camera.resolution == (1280, 720)
    assert np.array_equal(rig.T_base_cam, np.eye(4)[None])
    assert "no extrinsics" in caplog.text


def test_camera_info_message(write):
    """As `rostopic echo` prints it, with a fisheye and extrinsics added by hand."""
    message = {
        "width": 640,
        "height": 480,
        "distortion_model": "equidistant",
        "D": [0.01, 0.02, 0.003, 0.0],
        "K": CAMERA_INFO["camera_matrix"]["data"],
        "T_base_cam": DRIVE["cam0"]["T_body_cam"],
    }
    rig = read_calibration(write(message))
    assert type(rig.cameras[0]) is KannalaBrandtCamera
    assert rig.T_base_cam[0, 0, 3] == 1.62
    no_distortion = message | {"distortion_model": "", "D": []}
    assert type(read_calibration(write(no_distortion)).cameras[0]) is PinholeCamera


@pytest.mark.parametrize("suffix", ["yaml", "xml"])
@pytest.mark.parametrize(
    ("coefficients", "extra", "model"),
    [
        ([-0.3, 0.1, 0.001, -0.002, 0.01], {}, BrownConradyCamera),
        ([0.01, 0.02, 0.003, 0.0], {}, KannalaBrandtCamera),
        ([0.01, 0.02, 0.003, 0.0], {"fisheye_model": 0}, BrownConradyCamera),
        ([0.01, 0.02, 0.003, 0.0], {"fisheye_model": 1}, KannalaBrandtCamera),
    ],
)
def test_opencv_file_storage(tmp_path, suffix, coefficients, extra, model):
    path = tmp_path / f"left.{suffix}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 1280)
    storage.write("image_height", 720)
    storage.write("camera_matrix", np.reshape(CAMERA_INFO["camera_matrix"]["data"], (3, 3)))
    storage.write("distortion_coefficients", np.array(coefficients))
    for key, value in extra.items():
        storage.write(key, value)
    storage.release()
    rig = read_calibration(path)
    assert type(rig.cameras[0]) is model
    assert rig.names == ("left",)
    assert rig.cameras[0].resolution == (1280, 720)
    assert numbers_of(rig.cameras[0], "fx", "k1") == [900.0, coefficients[0]]


@pytest.mark.data
def test_folder_of_opencv_files(data_dir):
    folder = data_dir / "fisheye_neozhao" / "yaml"
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    rig = read_calibration(folder)
    assert rig.names == ("back", "front", "left", "right")
    assert all(type(camera) is KannalaBrandtCamera for camera in rig.cameras)
    assert rig.cameras[0].resolution == (960, 640)
    assert numbers_of(rig.cameras[0], "fx", "k4") == pytest.approx([304.34907840374234, 2.3821781880039081e-05])


@pytest.mark.data
@pytest.mark.parametrize("drive", ["road_dir", "garage_dir"])
def test_a_drive_survives_a_round_trip(drive, request, tmp_path):
    assert_round_trip(read_calibration(request.getfixturevalue(drive)), tmp_path)


def test_every_model_survives_a_round_trip(tmp_path):
    cameras = [
        PinholeCamera(700.1, 700.2, 480.3, 300.4, 960, 600),
        BrownConradyCamera(700, 700, 480, 300, 960, 600, -0.3, 0.02, 1e-4, -2e-4, 0.001),
        KannalaBrandtCamera(196, 196, 320, 240, 640, 480, -0.013, -0.004, 0.001, 0.0, max_theta_rad=1.675),
        CylindricalCamera(150, 480, 120, 960, 400, fy=170, max_phi_rad=1.2),
        BevCamera(0.02, 349.5, 599.5, 700, 900, max_height_m=0.3),
        PolynomialFisheyeCamera(339.7, 339.7, 643.4, 479.4, 1280, 966, -0.094, 0.142, -0.021, max_theta_rad=1.7),
    ]
    T = np.tile(np.eye(4), (6, 1, 1))
    T[:, :3, :3] = Rotation.random(6, random_state=0).as_matrix()
    assert_round_trip(Rig(cameras, T, ["a", "b", "c", "d", "e", "f"]), tmp_path)


def assert_round_trip(rig, tmp_path):
    write_calibration(rig, tmp_path / "calib.yaml")
    again = read_calibration(tmp_path / "calib.yaml")
    assert again.names == rig.names
    assert jax.tree.structure(again) == jax.tree.structure(rig)
    for ours, theirs in zip(jax.tree.leaves(again), jax.tree.leaves(rig), strict=True):
        assert np.allclose(ours, theirs, rtol=1e-15, atol=1e-15)


def changed(content, path, value):
    """A deep copy with one entry replaced, or removed where value is None."""
    content = copy.deepcopy(content)
    *parents, last = path
    entry = content
    for key in parents:
        entry = entry[key]
    if value is None:
        del entry[last]
    else:
        entry[last] = value
    return content


T_MIRRORED = np.array(DRIVE["cam0"]["T_body_cam"]) * [1, -1, 1, 1]
T_SCALED = np.array(DRIVE["cam0"]["T_body_cam"]) * [1.01, 1, 1, 1]
T_MILLIMETRES = np.array(DRIVE["cam0"]["T_body_cam"], dtype=float)
T_MILLIMETRES[:3, 3] *= 1000
T_NAN = np.array(DRIVE["cam0"]["T_body_cam"], dtype=float)
T_NAN[0, 3] = np.nan

OPENCV_OTHER = "%YAML:1.0\n---\nA: !!opencv-matrix\n   rows: 1\n   cols: 1\n   dt: d\n   data: [ 1. ]\n"

UNDISTORTED = changed(DRIVE, ["cam0", "distortion_model"], "none")
BAD_FILES = [
    ("", "holds no keys"),
    ("cam0: [1, 2", "line 1"),
    ({"something": 1}, "match no known layout"),
    ({"cam0": [1, 2]}, "expected a mapping"),
    (changed(DRIVE, ["cam0", "intrinsics"], None), "key 'intrinsics' is missing"),
    (changed(DRIVE, ["cam0", "resolution"], None), "key 'resolution' is missing"),
    (changed(DRIVE, ["cam0", "distortion_model"], None), "key 'distortion_model' is missing"),
    (changed(DRIVE, ["cam0", "intrinsics"], [742.3, 743.1, 476.4]), "given 3 numbers; expected 4"),
    (changed(DRIVE, ["cam0", "intrinsics"], [-742.3, 743.1, 476.4, 300]), "positive"),
    (changed(DRIVE, ["cam0", "intrinsics"], ["a", 743.1, 476.4, 300]), "expected 4 numbers"),
    (changed(DRIVE, ["cam0", "distortion_coeffs"], [0.1, 0.2]), "given 2 numbers; expected 4 or 5"),
    (changed(DRIVE, ["cam0", "distortion_coeffs"], [0.1, 0.2, float("nan"), 0]), "expected finite"),
    (changed(DRIVE, ["cam0", "distortion_model"], "nobodys"), "'nobodys' is not supported"),
    (changed(DRIVE, ["cam0", "camera_model"], "nobodys"), "'nobodys' is not supported; expected one of pinhole"),
    (changed(UNDISTORTED, ["cam0", "camera_model"], "ds"), "given 4 numbers; expected 6"),
    (changed(DRIVE, ["cam0", "resolution"], [960.5, 600]), "whole pixels"),
    (changed(DRIVE, ["cam0", "resolution"], [960, 0]), "whole pixels"),
    (changed(DRIVE, ["cam0", "T_body_cam"], T_MIRRORED.tolist()), "mirrored"),
    (changed(DRIVE, ["cam0", "T_body_cam"], T_SCALED.tolist()), "not a rotation"),
    (changed(DRIVE, ["cam0", "T_body_cam"], T_MILLIMETRES.tolist()), "millimetres"),
    (changed(DRIVE, ["cam0", "T_body_cam"], T_NAN.tolist()), "finite"),
    (changed(DRIVE, ["cam0", "T_body_cam"], np.array(DRIVE["cam0"]["T_body_cam"]).T.tolist()), "transposed"),
    (changed(DRIVE, ["cam0", "T_body_cam"], np.eye(3).tolist()), "given 9 numbers; expected 16 or 12"),
    (with_mounting([1.6, 0.0, 1.4]), "expected position_m: [x, y, z] and yaw_deg, down_deg, roll_deg"),
    (with_mounting({"position_m": [1.6, 0.0, 1.4], "pitch_deg": 3.0}), "expected position_m"),
    (with_mounting({"down_deg": 3.0}), "'position_m' is missing"),
    (with_mounting({"position_m": [1620.0, 40.0, 1430.0]}), "millimetres"),
    (changed(KALIBR, ["cam1", "T_cn_cnm1"], None), "no pose"),
    (DRIVE | {"cam1": DRIVE["cam0"]}, "rename"),
    (changed(CAMERA_INFO, ["image_width"], None), "image_width"),
    (changed(CAMERA_INFO, ["distortion_coefficients"], None), "'distortion_coefficients' is missing"),
    (changed(CAMERA_INFO, ["distortion_model"], "rational_polynomial"), "given 5 numbers; expected 8"),
    (changed(CAMERA_INFO, ["camera_matrix", "data"], [900.0, 3, 640, 0, 901, 360, 0, 0, 1]), "no skew"),
    (changed(CAMERA_INFO, ["camera_matrix", "data"], [900.0, 0, 640]), "given 3 numbers; expected 9"),
    ("%YAML:1.0\n---\nfoo: 3\n", "match no known layout"),
    (OPENCV_OTHER, "none of the keys camera_m"),
    ("<opencv_storage> <a", "not readable as an OpenCV"),
]


@pytest.mark.parametrize(("content", "words"), BAD_FILES, ids=[words for _, words in BAD_FILES])
def test_bad_files_are_refused_with_place_and_remedy(content, words, write):
    path = write(content)
    with pytest.raises(SemlocError) as caught:
        read_calibration(path)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert "calib.yaml" in str(caught.value) or words == "rename"


def test_missing_files_and_empty_folders(tmp_path):
    with pytest.raises(SemlocError, match="no such file"):
        read_calibration(tmp_path / "calib.yaml")
    with pytest.raises(SemlocError, match="holds no"):
        read_calibration(tmp_path)


RATIONAL = [0.32, -0.11, 0.0004, -0.0003, -0.006, 0.66, -0.07, -0.02]
"""As wide-angle cameras are calibrated with CALIB_RATIONAL_MODEL."""


def write_opencv(path, coefficients, focal_px=900.0):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_size", np.array([1280, 720]))
    storage.write("K", np.array([[focal_px, 0, 640.5], [0, focal_px, 360.5], [0, 0, 1]]))
    storage.write("D", np.array(coefficients, dtype=float))
    storage.release()
    return path


def test_rational_coefficients_are_followed_to_a_third_of_a_pixel(tmp_path):
    (camera,) = read_calibration(write_opencv(tmp_path / "left.yaml", RATIONAL)).cameras
    assert type(camera) is BrownConradyCamera
    grid = np.stack(np.meshgrid(np.linspace(0, 1279, 24), np.linspace(0, 719, 16)), axis=-1).reshape(-1, 2)
    ray, valid = (np.asarray(a) for a in camera.unproject(grid))
    assert valid.all()
    K = np.array([[900.0, 0, 640.5], [0, 900.0, 360.5], [0, 0, 1]])
    uv, _ = cv2.projectPoints(ray[:, None], np.zeros(3), np.zeros(3), K, np.array(RATIONAL))
    assert np.abs(uv[:, 0] - grid).max() < 0.3


def test_rational_coefficients_that_cannot_be_followed_are_refused(tmp_path):
    path = write_opencv(tmp_path / "left.yaml", [3.0, -0.2, 0.0, 0.0, 0.1, 3.4, 0.7, -0.8], 450.0)
    with pytest.raises(SemlocError, match=r"rational distortion \(8 coefficients\) is .* px off"):
        read_calibration(path)
    with pytest.raises(SemlocError, match="thin-prism"):
        read_calibration(write_opencv(tmp_path / "right.yaml", [*RATIONAL, 0.01, 0.0, 0.0, 0.0]))
