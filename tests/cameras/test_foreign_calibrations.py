"""Calibrations of data sets and other tools: pixels as their own formulas give them."""

import json
import logging
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from semloc_jax.cameras import (
    BrownConradyCamera,
    KannalaBrandtCamera,
    PinholeCamera,
    PolynomialFisheyeCamera,
)
from semloc_jax.cameras.io import read_calibration
from semloc_jax.cameras.plausibility import implausible
from semloc_jax.errors import SemlocError

RNG = np.random.default_rng(4)


def pixels_of(rig, index, p_base):
    T = np.asarray(rig.T_base_cam[index])
    uv, valid = rig.cameras[index].project((p_base - T[:3, 3]) @ T[:3, :3])
    return np.asarray(uv), np.asarray(valid)


COLMAP = """# Camera list
1 SIMPLE_PINHOLE 640 480 500.0 320.0 240.0
2 OPENCV 1280 720 900.0 901.0 640.5 360.5 -0.1 0.02 0.001 -0.002
3 OPENCV_FISHEYE 640 480 196.0 197.0 320.0 240.0 -0.01 -0.004 0.001 0.0
4 RADIAL 640 480 500.0 320.0 240.0 -0.1 0.01
"""


def test_colmap_counts_pixels_from_their_corner(tmp_path):
    (tmp_path / "cameras.txt").write_text(COLMAP)
    rig = read_calibration(tmp_path / "cameras.txt")
    assert rig.names == ("cam1", "cam2", "cam3", "cam4")
    models = [PinholeCamera, BrownConradyCamera, KannalaBrandtCamera, BrownConradyCamera]
    assert [type(camera) for camera in rig.cameras] == models
    # A point on the axis lies at the corner of four pixels: (320, 240) of COLMAP is (319.5, 239.5) here.
    np.testing.assert_allclose(rig.cameras[0].project(np.array([0.0, 0.0, 2.0]))[0], [319.5, 239.5])
    wide = rig.cameras[1]
    assert [float(getattr(wide, k)) for k in ("k1", "k2", "p1", "p2", "k3")] == [-0.1, 0.02, 0.001, -0.002, 0.0]
    assert float(rig.cameras[2].fy) == 197.0 and float(rig.cameras[3].k2) == 0.01


def test_woodscape_is_its_own_polynomial(tmp_path):
    k = [339.749, -31.988, 48.275, -7.201]
    content = {
        "intrinsic": {"model": "radial_poly", "k1": k[0], "k2": k[1], "k3": k[2], "k4": k[3], "cx_offset": 3.942,
                      "cy_offset": -3.093, "width": 1280.0, "height": 966.0, "aspect_ratio": 1.0},
        "extrinsic": {"quaternion": Rotation.from_euler("zyx", [0.1, 0.2, 0.3]).as_quat().tolist(),
                      "translation": [3.7, 0.0, 0.68]},
        "name": "FV",
    }  # fmt: skip
    (tmp_path / "0001_FV.json").write_text(json.dumps(content))
    rig = read_calibration(tmp_path / "0001_FV.json")
    assert rig.names == ("FV",) and type(rig.cameras[0]) is PolynomialFisheyeCamera
    p_cam = RNG.normal(size=(200, 3))
    theta = np.arctan2(np.hypot(p_cam[:, 0], p_cam[:, 1]), p_cam[:, 2])
    p_cam, theta = p_cam[theta < 1.7], theta[theta < 1.7]
    rho = k[0] * theta + k[1] * theta**2 + k[2] * theta**3 + k[3] * theta**4
    direction = p_cam[:, :2] / np.linalg.norm(p_cam[:, :2], axis=1, keepdims=True)
    expected = rho[:, None] * direction + [1280 / 2 - 0.5 + 3.942, 966 / 2 - 0.5 - 3.093]
    np.testing.assert_allclose(rig.cameras[0].project(p_cam)[0], expected, atol=1e-6)
    np.testing.assert_allclose(rig.T_base_cam[0, :3, :3], Rotation.from_euler("zyx", [0.1, 0.2, 0.3]).as_matrix())


@pytest.mark.data
def test_real_fisheyes_agree_on_the_ground(data_dir):
    """Four cameras of one car: nothing implausible, and every camera sees the road beside it."""
    folder = data_dir / "fisheye_woodscape_clickcalib" / "calibrations" / "optimized"
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    rig = read_calibration(folder)
    assert rig.names == ("FV", "MVL", "MVR", "RV")
    assert implausible(rig) == []
    places = {"FV": (6.0, 0.0), "MVL": (2.0, 3.0), "MVR": (2.0, -3.0), "RV": (-3.0, 0.0)}
    for index, name in enumerate(rig.names):
        uv, valid = pixels_of(rig, index, np.array([[*places[name], 0.0]]))
        assert valid.all() and np.all(rig.cameras[index].in_image(*uv.T))


# A lens as OCamCalib calibrates it: its radius grows as 380 (theta - 0.02 theta^3) px.
def ocam_radius(theta):
    return 380.0 * (theta - 0.02 * theta**3)


def write_ocam(path, c=1.001, d=1e-4, e=-2e-4):
    theta = np.linspace(0.0, 1.7, 400)
    inverse = np.polynomial.polynomial.polyfit(theta - np.pi / 2, ocam_radius(theta), 9)
    direct = [-380.0, 0.0, 6e-4, 1e-7, 1e-10]
    path.write_text(
        "#polynomial coefficients for the DIRECT mapping function\n\n"
        f"5 {' '.join(map(str, direct))}\n\n#inverse\n\n10 {' '.join(f'{v:.12f}' for v in inverse)}\n\n"
        f"#center: row and column\n\n483.2 641.7\n\n#affine\n\n{c} {d} {e}\n\n#image size: height, width\n\n966 1280\n"
    )
    return inverse


def test_ocamcalib_is_followed_to_a_tenth_of_a_pixel(tmp_path):
    inverse = write_ocam(tmp_path / "calib_results.txt")
    rig = read_calibration(tmp_path / "calib_results.txt")
    assert rig.cameras[0].resolution == (1280, 966)
    p_cam = RNG.normal(size=(400, 3)) + [0.0, 0.0, 0.6]
    # world2cam of the toolbox: x down the rows, y along the columns, the lens looks along -z.
    x, y, z = p_cam[:, 1], p_cam[:, 0], -p_cam[:, 2]
    norm = np.hypot(x, y)
    rho = np.polynomial.polynomial.polyval(np.arctan(z / norm), inverse)
    px, py = x / norm * rho, y / norm * rho
    rows, columns = 1.001 * px + 1e-4 * py + 483.2, -2e-4 * px + py + 641.7
    uv, valid = (np.asarray(a) for a in rig.cameras[0].project(p_cam))
    inside = valid & (columns > 0) & (columns < 1279) & (rows > 0) & (rows < 965)
    assert inside.sum() > 150
    miss = np.hypot(uv[:, 0] - columns, uv[:, 1] - rows)[inside]
    assert miss.max() < 0.2  # of which the shear, left out, is 0.13 px at the corner


def test_ocamcalib_that_no_fisheye_follows(tmp_path, caplog):
    write_ocam(tmp_path / "a.txt", d=2e-3)
    with caplog.at_level(logging.WARNING):
        read_calibration(tmp_path / "a.txt")
    assert "shear" in caplog.text
    text = (tmp_path / "a.txt").read_text().replace("10 ", "9 ", 1)
    (tmp_path / "b.txt").write_text(text)
    with pytest.raises(SemlocError, match="coefficients after the count 9"):
        read_calibration(tmp_path / "b.txt")


K = np.array([[718.856, 0.0, 607.1928], [0.0, 718.856, 185.2157], [0.0, 0.0, 1.0]])
TR = np.array(
    [
        [4.27e-4, -0.99996, -8.08e-3, -0.0119],
        [-7.21e-3, 8.08e-3, -0.99994, -0.0540],
        [0.99997, 4.85e-4, -7.2e-3, -0.2921],
    ]
)


def kitti_line(key, matrix):
    return f"{key}: {' '.join(f'{v:.12e}' for v in np.ravel(matrix))}\n"


def test_kitti_pixels_are_those_of_its_matrices(tmp_path):
    U, _, Vt = np.linalg.svd(TR[:, :3])
    Tr = np.column_stack([U @ Vt, TR[:, 3]])
    P2 = K @ np.column_stack([np.eye(3), [0.06, 0.001, 0.003]])
    P3 = K @ np.column_stack([np.eye(3), [-0.47, 0.002, 0.002]])
    text = kitti_line("P0", K @ np.eye(3, 4)) + kitti_line("P2", P2) + kitti_line("P3", P3) + kitti_line("Tr", Tr)
    (tmp_path / "calib.txt").write_text(text)
    rig = read_calibration(tmp_path / "calib.txt")
    assert rig.names == ("image_0", "image_2", "image_3")
    p_lidar = np.column_stack([RNG.uniform(5, 40, 50), RNG.uniform(-4, 4, 50), RNG.uniform(-2, 1, 50)])
    p_cam0 = p_lidar @ Tr[:, :3].T + Tr[:, 3]
    for index, P in ((1, P2), (2, P3)):
        homogeneous = np.column_stack([p_cam0, np.ones(50)]) @ P.T
        uv, _ = pixels_of(rig, index, p_lidar + [0.76, 0.0, 1.73])
        np.testing.assert_allclose(uv, homogeneous[:, :2] / homogeneous[:, 2:], atol=1e-6)
    assert np.allclose(rig.T_base_cam[0, 2, 3], 1.65, atol=0.05)  # cameras stand 1.65 m above the road
    assert implausible(rig) == []


def test_nuscenes_tables(tmp_path):
    T = np.array([1.72, 0.004, 1.495])
    q = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]).as_quat()
    write = lambda name, rows: (tmp_path / f"{name}.json").write_text(json.dumps(rows))  # noqa: E731
    write("sensor", [{"token": "a", "channel": "CAM_FRONT", "modality": "camera"},
                     {"token": "b", "channel": "LIDAR_TOP", "modality": "lidar"}])  # fmt: skip
    row = {"token": "c", "sensor_token": "a", "translation": T.tolist(), "rotation": q[[3, 0, 1, 2]].tolist(),
           "camera_intrinsic": [[1252.8, 0, 826.6], [0, 1252.8, 469.9], [0, 0, 1]]}  # fmt: skip
    write("calibrated_sensor", [row, row | {"token": "d", "sensor_token": "b", "camera_intrinsic": []}])
    for path in (tmp_path, tmp_path / "calibrated_sensor.json"):
        rig = read_calibration(path)
        assert rig.names == ("CAM_FRONT",) and rig.cameras[0].resolution == (1600, 900)
    assert implausible(rig) == []
    uv, _ = pixels_of(rig, 0, np.array([[11.72, 0.004, 1.495]]))
    np.testing.assert_allclose(uv, [[826.6, 469.9]], atol=1e-9)
    write("calibrated_sensor", [row | {"rotation": [0, 0, 0, 0]}])
    with pytest.raises(SemlocError, match="unit quaternion w x y z"):
        read_calibration(tmp_path)


@pytest.mark.data
def test_argoverse2_cameras_stand_on_the_road(data_dir):
    pytest.importorskip("pyarrow")
    folder = data_dir / "av2_7fab2350"
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    rig = read_calibration(folder)
    assert len(rig) == 9 and rig.names[0] == "ring_front_center"
    assert rig.cameras[0].resolution == (1550, 2048)
    assert implausible(rig) == []
    # A point 20 m ahead of the front camera at its height is seen near the principal point.
    p = rig.T_base_cam[0, :3, 3] + 20.0 * rig.T_base_cam[0, :3, 2]
    uv, _ = pixels_of(rig, 0, p[None])
    np.testing.assert_allclose(uv[0], [777.9906, 1013.5243], atol=1e-3)
    # Road points of the lidar beside the car lie on the plane z = 0 of the base frame to 5 cm.
    from pyarrow import feather

    sweep = next((folder / "sensors" / "lidar").glob("*.feather"))
    points = feather.read_table(sweep).to_pandas()[["x", "y", "z"]].to_numpy(float)
    near = (np.abs(points[:, 0] - 0.5) < 1.5) & (np.abs(points[:, 1]) < 4.0) & (points[:, 2] < 0.3)
    assert np.median(points[near, 2]) + 0.33 == pytest.approx(0.0, abs=0.05)


def test_a_missing_library_names_the_extra(tmp_path, monkeypatch):
    (tmp_path / "intrinsics.feather").write_bytes(b"x")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(SemlocError, match=r'pip install "pyarrow'):
        read_calibration(tmp_path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 OPENCV 640 480 500 500 320\n", r"camera 1 \(OPENCV\): given 3 numbers; expected 8"),
        ("1 THIN_PRISM 640 480 500 500 320 240\n", "model 'THIN_PRISM' is not supported"),
        ("1 PINHOLE 640 480 500 -500 320 240\n", "expected positive pixels"),
        ("1 PINHOLE 640 480 500 nan 320 240\n", "expected finite"),
        ("P0: 1 2 3\n", "P0: given 3 numbers; expected 12"),
        ("P0: a b c d e f g h i j k l\n", "expected 12 numbers"),
    ],
)
def test_bad_text_files_are_refused(tmp_path, text, words):
    (tmp_path / "calib.txt").write_text(text)
    with pytest.raises(SemlocError, match=words):
        read_calibration(tmp_path / "calib.txt")
