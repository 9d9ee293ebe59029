"""Surround view calibrated on ground points: simulated with a known answer, and the real WoodScape sample."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from semloc_jax.calibration.ground_points import GroundPairs, calibrate_on_ground, read_ground_pairs
from semloc_jax.calibration.observability import Knowledge
from semloc_jax.cameras import Rig
from semloc_jax.cameras.io import read_calibration
from semloc_jax.errors import SemlocError
from semloc_jax.simulation.cameras import surround_rig


def simulated(num=15):
    """True rig and exact pixels of ground points in the four overlaps."""
    rig, rng = surround_rig(), np.random.default_rng(2)
    corners = {("front", "left"): (4.6, 2.0), ("front", "right"): (4.6, -2.0)}
    corners |= {("rear", "left"): (-1.5, 2.0), ("rear", "right"): (-1.5, -2.0)}
    names, uv = [], []
    for pair, corner in corners.items():
        for point in np.append(corner, 0.0) + rng.uniform([-1.0, -0.8, 0.0], [1.0, 0.8, 0.0], (num, 3)):
            names.append(pair)
            uv.append([])
            for name in pair:
                T = np.asarray(rig.T_base_cam[rig.index(name)])
                pixel, valid = rig.cameras[rig.index(name)].project(T[:3, :3].T @ (point - T[:3, 3]))
                assert valid
                uv[-1].append(np.asarray(pixel))
    return rig, GroundPairs(tuple(names), np.array(uv))


@pytest.mark.slow
def test_simulated_cameras_agree_again_and_their_gauge_is_named():
    rig, pairs = simulated()
    T, rng = np.array(rig.T_base_cam), np.random.default_rng(3)
    for pose in T:
        pose[:3, :3] = Rotation.from_rotvec(np.radians(rng.normal(0.0, 1.0, 3))).as_matrix() @ pose[:3, :3]
        pose[:3, 3] += rng.normal(0.0, 0.02, 3)
    found = calibrate_on_ground(Rig(rig.cameras, T, rig.names), pairs)
    assert found.before_m > 0.08
    assert found.after_m < 0.004
    assert max(found.held_out_m) < 0.01
    held = [d for d in found.observability.directions if d.verdict is Knowledge.HELD]
    assert len(held) >= 3  # the vehicle's own x, y and heading
    assert all("vehicle" in d.reason for d in held)


@pytest.mark.data
@pytest.mark.slow
def test_woodscape_from_the_shipped_calibration(data_dir):
    sample = data_dir / "fisheye_woodscape_clickcalib"
    if not sample.is_dir():
        pytest.skip(f"no {sample}: the WoodScape sample with its calibrations")
    pairs = read_ground_pairs(Path(__file__).with_name("woodscape_ground_points.csv"))
    found = calibrate_on_ground(read_calibration(sample / "calibrations" / "original"), pairs)
    assert found.before_m == pytest.approx(0.349, abs=1e-3)
    assert found.after_m <= 0.078
    assert np.mean(found.held_out_m) < 0.17 < np.mean(found.held_out_before_m)
    assert max(found.held_out_m) < 0.25


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("camera_a,u_a,v_a,camera_b,u_b\nfront,1,2,left,3\n", "no column v_b"),
        ("camera_a,u_a,v_a,camera_b,u_b,v_b\nfront,1,x,left,3,4\n", "expected pixels as numbers"),
        ("", "no column camera_a"),
    ],
)
def test_bad_tables_are_refused(tmp_path, text, words):
    (tmp_path / "points.csv").write_text(text)
    with pytest.raises(SemlocError, match=words):
        read_ground_pairs(tmp_path / "points.csv")


def test_too_few_points_unknown_cameras_and_the_sky_are_refused():
    rig, pairs = simulated(4)
    with pytest.raises(SemlocError, match="expected at least 3 for each camera"):
        calibrate_on_ground(rig, GroundPairs(pairs.cameras[:4], pairs.uv[:4]))
    with pytest.raises(SemlocError, match="top"):
        calibrate_on_ground(rig, GroundPairs((("top", "left"), *pairs.cameras[1:]), pairs.uv))
    sky = pairs.uv.copy()
    sky[0, 0] = 320.0, 20.0
    with pytest.raises(SemlocError, match="not on the ground"):
        calibrate_on_ground(rig, GroundPairs(pairs.cameras, sky))
