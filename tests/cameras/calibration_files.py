"""One right calibration file of each kind, for tests that break them."""

import json
from pathlib import Path

import cv2
import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from semloc_jax.cameras import Rig
from semloc_jax.cameras.io import write_calibration

COLMAP = """# Camera list
1 SIMPLE_PINHOLE 640 480 500.0 320.0 240.0
2 OPENCV 1280 720 900.0 901.0 640.5 360.5 -0.1 0.02 0.001 -0.002
3 OPENCV_FISHEYE 640 480 196.0 197.0 320.0 240.0 -0.01 -0.004 0.001 0.0
4 FULL_OPENCV 640 480 500.0 500.0 320.0 240.0 0.3 -0.1 0.0 0.0 -0.006 0.6 -0.07 -0.02
"""


def calibration_files(folder: Path, front: Rig, surround: Rig) -> dict[str, Path]:
    """Writes the files and returns their paths by kind."""
    K = [700.0, 0.0, 480.0, 0.0, 700.0, 300.0, 0.0, 0.0, 1.0]
    write_calibration(surround, folder / "calib.yaml")
    info = {"image_width": 960, "image_height": 600, "distortion_model": "rational_polynomial"}
    info |= {"camera_matrix": {"rows": 3, "cols": 3, "data": K}, "T_base_cam": np.asarray(front.T_base_cam[0]).tolist()}
    info |= {"distortion_coefficients": {"data": [0.3, -0.1, 0.0004, -0.0003, -0.006, 0.6, -0.07, -0.02]}}
    (folder / "info.yaml").write_text(yaml.safe_dump(info))
    for suffix in ("yaml", "xml"):
        storage = cv2.FileStorage(str(folder / f"opencv.{suffix}"), cv2.FILE_STORAGE_WRITE)
        storage.write("image_size", np.array([960, 600]))
        storage.write("K", np.reshape(K, (3, 3)))
        storage.write("D", np.array([0.01, 0.02, 0.003, 0.0]))
        storage.write("T_base_cam", np.asarray(front.T_base_cam[0]))
        storage.release()
    (folder / "cameras.txt").write_text(COLMAP)
    kitti = f"P0: {_row(np.reshape(K, (3, 3)) @ np.eye(3, 4))}\nTr: 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27\n"
    (folder / "kitti.txt").write_text(kitti)
    theta = np.linspace(0.0, 1.7, 300)
    inverse = np.polynomial.polynomial.polyfit(theta - np.pi / 2, 380 * (theta - 0.02 * theta**3), 9)
    (folder / "ocam.txt").write_text(
        f"#direct\n\n3 -380.0 0.0 6e-4\n\n#inverse\n\n10 {_row(inverse)}\n\n#center\n\n483.2 641.7\n\n#affine\n\n"
        "1.0 0.0 0.0\n\n#size\n\n966 1280\n"
    )
    lens = {
        "model": "radial_poly",
        "k1": 339.7,
        "k2": -32.0,
        "k3": 48.3,
        "k4": -7.2,
        "cx_offset": 3.9,
        "cy_offset": -3.1,
    }
    place = {"quaternion": [0.59, -0.58, 0.4, -0.39], "translation": [3.7, 0.0, 0.68]}
    content = {"intrinsic": lens | {"width": 1280.0, "height": 966.0, "aspect_ratio": 1.0}, "extrinsic": place}
    (folder / "wood.json").write_text(json.dumps(content))
    tables = folder / "v1.0-mini"
    tables.mkdir()
    (tables / "sensor.json").write_text(json.dumps([{"token": "a", "channel": "CAM_FRONT", "modality": "camera"}]))
    quaternion = Rotation.from_matrix(front.T_base_cam[0, :3, :3]).as_quat()[[3, 0, 1, 2]].tolist()
    row = {"token": "c", "sensor_token": "a", "translation": [1.7, 0.0, 1.5], "rotation": quaternion}
    row |= {"camera_intrinsic": np.reshape(K, (3, 3)).tolist()}
    (tables / "calibrated_sensor.json").write_text(json.dumps([row]))
    names = {"camchain": "calib.yaml", "camera_info": "info.yaml", "opencv": "opencv.yaml", "opencv_xml": "opencv.xml"}
    names |= {"colmap": "cameras.txt", "kitti": "kitti.txt", "ocam": "ocam.txt", "woodscape": "wood.json"}
    return {kind: folder / name for kind, name in (names | {"nuscenes": "v1.0-mini/calibrated_sensor.json"}).items()}


def _row(values: np.ndarray) -> str:
    return " ".join(f"{value:.12g}" for value in np.ravel(values))
