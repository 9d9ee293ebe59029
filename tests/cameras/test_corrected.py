"""A corrected calibration keeps the layout of the file that it corrects."""

import json

import equinox as eqx
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from semloc_jax.cameras import DoubleSphereCamera, Rig
from semloc_jax.cameras.io import read_calibration, write_calibration
from semloc_jax.cameras.io.corrected import write_corrected
from semloc_jax.simulation.cameras import surround_rig

MOVE = np.eye(4)
MOVE[:3, :3] = Rotation.from_rotvec([0.01, -0.02, 0.03]).as_matrix()
MOVE[:3, 3] = 0.05, -0.02, 0.01


def corrected(rig):
    """The rig with every mount moved."""
    return Rig(rig.cameras, MOVE @ np.asarray(rig.T_base_cam), rig.names)


@pytest.mark.parametrize("key", ["T_body_cam", "T_cam_imu", "T_cn_cnm1"])
def test_camchains_keep_their_keys(tmp_path, key):
    write_calibration(surround_rig(), tmp_path / "given.yaml")
    text = (tmp_path / "given.yaml").read_text()
    content, previous = yaml.safe_load(text), None
    for number, entry in enumerate(content.values()):
        T = np.array(entry.pop("T_body_cam"))
        own = key if key != "T_cn_cnm1" or number else "T_cam_imu"
        value = {"T_body_cam": T, "T_cam_imu": np.linalg.inv(T)}.get(own)
        entry[own] = (np.linalg.inv(T) @ previous if value is None else value).tolist()
        entry["rostopic"] = f"/cam{number}"
        previous = T
    (tmp_path / "given.yaml").write_text("# measured in May\n" + yaml.safe_dump(content, sort_keys=False))
    rig = read_calibration(tmp_path / "given.yaml")
    better = corrected(rig)
    camera = eqx.tree_at(lambda c: (c.fx, c.k1), better.cameras[0], (np.asarray(200.0), np.asarray(-0.02)))
    better = Rig((camera, *better.cameras[1:]), better.T_base_cam, better.names)
    (path,) = write_corrected(better, tmp_path / "given.yaml", tmp_path / "out")
    after, again = yaml.safe_load(path.read_text()), read_calibration(path)
    assert path.read_text().startswith("# measured in May")
    assert [list(entry) for entry in after.values()] == [list(entry) for entry in content.values()]
    np.testing.assert_allclose(again.T_base_cam, better.T_base_cam, atol=1e-12)
    assert (float(again.cameras[0].fx), float(again.cameras[0].k1)) == (200.0, -0.02)
    assert after["cam1"]["intrinsics"] == content["cam1"]["intrinsics"]


def test_what_stands_before_the_focal_lengths_stays_there(tmp_path):
    lens = DoubleSphereCamera(196.1, 196.3, 318.6, 240.6, 640, 480, -0.18, 0.59)
    write_calibration(Rig([lens], np.eye(4)[None], ["left"]), tmp_path / "calib.yaml")
    rig = Rig([eqx.tree_at(lambda c: (c.fx, c.xi), lens, (np.asarray(200.0), np.asarray(-0.2)))], MOVE[None], ["left"])
    (path,) = write_corrected(rig, tmp_path, tmp_path / "out")
    assert yaml.safe_load(path.read_text())["cam0"]["intrinsics"] == [-0.2, 0.59, 200.0, 196.3, 318.6, 240.6]


def test_a_mounting_becomes_the_matrix_that_was_found(tmp_path):
    write_calibration(surround_rig(), tmp_path / "calib.yaml")
    content = yaml.safe_load((tmp_path / "calib.yaml").read_text())
    del content["cam0"]["T_body_cam"]
    content["cam0"]["mounted"] = {"position_m": [1.6, 0.0, 1.4], "down_deg": 3.0}
    (tmp_path / "calib.yaml").write_text(yaml.safe_dump(content))
    better = corrected(read_calibration(tmp_path))
    (path,) = write_corrected(better, tmp_path, tmp_path / "out")
    assert "mounted" not in yaml.safe_load(path.read_text())["cam0"]
    np.testing.assert_allclose(read_calibration(path).T_base_cam, better.T_base_cam, atol=1e-12)


def test_cameras_that_were_not_calibrated_stay(tmp_path):
    write_calibration(surround_rig(), tmp_path / "calib.yaml")
    rig = read_calibration(tmp_path)
    (path,) = write_corrected(corrected(rig.select(["rear"])), tmp_path, tmp_path / "out")
    moved = np.abs(np.asarray(read_calibration(path).T_base_cam) - np.asarray(rig.T_base_cam)).max(axis=(1, 2)) > 1e-6
    assert moved.tolist() == [name == "rear" for name in rig.names]


def test_woodscape_files_stay_woodscape_files(tmp_path):
    (tmp_path / "given").mkdir()
    content = {
        "extrinsic": {"quaternion": [0.59, -0.58, 0.4, -0.39], "translation": [3.7, 0.0, 0.7]},
        "intrinsic": {
            **{"model": "radial_poly", "k1": 339.7, "k2": -31.9, "k3": 48.2, "k4": -7.2, "aspect_ratio": 1.0},
            **{"cx_offset": 3.9, "cy_offset": -3.0, "width": 1280.0, "height": 966.0},
        },
        "name": "FV",
    }
    (tmp_path / "given" / "00164_FV.json").write_text(json.dumps(content))
    rig = read_calibration(tmp_path / "given")
    (path,) = write_corrected(corrected(rig), tmp_path / "given", tmp_path / "out")
    assert path.name == "00164_FV.json"
    assert json.loads(path.read_text())["intrinsic"] == content["intrinsic"]
    np.testing.assert_allclose(read_calibration(path).T_base_cam, corrected(rig).T_base_cam, atol=1e-12)
