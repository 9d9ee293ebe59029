"""A right calibration raises no word; each of the usual mistakes is named for what it is."""

import equinox as eqx
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from semloc_jax.cameras import KannalaBrandtCamera, PinholeCamera, Rig
from semloc_jax.cameras.io import read_calibration
from semloc_jax.cameras.plausibility import implausible, view_angles_deg
from semloc_jax.simulation.cameras import front_rig, mounted, surround_rig

FROM_VEHICLE = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def with_pose(rig, T, index=0):
    poses = np.array(rig.T_base_cam)
    poses[index] = T
    return Rig(rig.cameras, poses, rig.names)


def with_camera(rig, **fields):
    camera = rig.cameras[0]
    for name, value in fields.items():
        camera = eqx.tree_at(lambda c, name=name: getattr(c, name), camera, np.asarray(float(value)))
    return Rig([camera, *rig.cameras[1:]], rig.T_base_cam, rig.names)


def kinds(rig, sizes=None):
    return [finding.kind for finding in implausible(rig, sizes)]


def the_text(rig, sizes=None):
    (finding,) = implausible(rig, sizes)
    return str(finding)


@pytest.mark.parametrize("rig", [front_rig(), surround_rig(), front_rig(320, 200)], ids=["front", "surround", "small"])
def test_right_calibrations_raise_no_word(rig):
    assert (
        implausible(rig, {name: camera.resolution for name, camera in zip(rig.names, rig.cameras, strict=True)}) == []
    )


@pytest.mark.data
@pytest.mark.parametrize("name", ["rendered_road", "rendered_garage"])
def test_drives_raise_no_word(data_dir, name):
    assert implausible(read_calibration(data_dir / name)) == []


@pytest.mark.data
def test_six_real_cameras_raise_no_word(data_dir):
    from semloc_jax.datasets import open_drive

    assert implausible(open_drive(data_dir / "pandaset_002").rig) == []


@pytest.mark.parametrize("yaw", [0.0, 90.0, -135.0])
def test_angles_of_view(yaw):
    T = mounted((1.0, 0.0, 1.2), yaw_deg=yaw, down_deg=12.0, roll_deg=0.0)
    assert view_angles_deg(T) == pytest.approx((yaw, 12.0, 0.0), abs=1e-9)
    rolled = T.copy()
    # Turned clockwise about its line of sight, as the camera sees it: its right side goes down.
    rolled[:3, :3] = T[:3, :3] @ Rotation.from_euler("z", 5, degrees=True).as_matrix()
    assert view_angles_deg(rolled)[2] == pytest.approx(5.0 / 1.0, abs=0.2)


def test_a_camera_under_the_ground():
    T = np.array(front_rig().T_base_cam[0])
    T[2, 3] *= -1
    assert "1.43 m under the ground" in the_text(with_pose(front_rig(), T))
    T[2, 3] = 0.02
    assert "at the height of the axle" in the_text(with_pose(front_rig(), T))
    T[2, 3] = 7.0
    assert "expected a place on a vehicle" in the_text(with_pose(front_rig(), T))


def test_the_inverse_matrix_is_recognised():
    found = implausible(with_pose(front_rig(), np.linalg.inv(front_rig().T_base_cam[0])))
    assert any("the matrix is T_cam_base; invert it" in finding.text for finding in found)


def test_axes_of_a_vehicle_instead_of_a_lens():
    T = front_rig().T_base_cam[0] @ np.linalg.inv(FROM_VEHICLE)
    assert "T_base_cam wants x right, y down, z forward" in the_text(with_pose(front_rig(), T))


def test_upside_down():
    T = front_rig().T_base_cam[0] @ np.diag([-1.0, -1.0, 1.0, 1.0])
    assert "upside down" in the_text(with_pose(front_rig(), T))


def test_a_mirrored_vehicle_frame():
    """y to the right: the left camera stands on the right side and looks there."""
    rig, poses = surround_rig(), np.array(surround_rig().T_base_cam)
    flipped = poses.copy()
    flipped[1], flipped[3] = poses[3], poses[1]
    found = implausible(Rig(rig.cameras, flipped, rig.names))
    assert {finding.camera for finding in found} == {"left", "right"}
    assert all("away from what its name says" in finding.text for finding in found)


def test_another_resolution():
    rig = front_rig()
    assert "pictures are 1920x1200 px, the calibration is for 960x600 px" in the_text(rig, {"front": (1920, 1200)})
    doubled = rig.cameras[0].resized(1920, 1200)
    half_told = with_camera(rig, fx=doubled.fx, fy=doubled.fy, cx=doubled.cx, cy=doubled.cy)
    assert "fx fy cx cy belong to another size" in the_text(half_told)
    swapped = with_camera(rig, cx=rig.cameras[0].cy, cy=rig.cameras[0].cx)
    assert kinds(swapped) == ["size"]
    assert "fx / fy is 1.33" in the_text(with_camera(rig, fx=1.333 * float(rig.cameras[0].fy)))


def test_degrees_where_radians_are_meant():
    camera = KannalaBrandtCamera(196, 196, 320, 240, 640, 480, max_theta_rad=96.0)
    rig = Rig([camera], front_rig().T_base_cam, ["front"])
    assert "max_theta_rad is 96" in the_text(rig) and "given in degrees? use 1.676" in the_text(rig)


def test_radians_where_degrees_are_meant():
    """Yaws of 90 and -90 deg given in radians to something that took degrees: 1.6 deg."""
    poses = np.array(surround_rig().T_base_cam)
    for index, (position, yaw, down) in enumerate(
        [((3.8, 0.0, 0.66), 0.3, 22.0), ((1.95, 1.02, 0.98), 90.5, 38.0), ((-0.96, 0.0, 0.84), 181.0, 26.5),
         ((1.95, -1.02, 0.98), -89.4, 37.0)]
    ):  # fmt: skip
        poses[index] = mounted(position, np.radians(yaw), np.radians(down), 0.0)
    found = implausible(Rig(surround_rig().cameras, poses, surround_rig().names))
    assert any("radians where degrees were meant" in finding.text for finding in found)


def test_missing_extrinsics_and_lenses_that_cannot_be():
    rig = Rig([PinholeCamera(700, 700, 480, 300, 960, 600)], np.eye(4)[None], ["front"])
    assert "has no place on the vehicle" in the_text(rig)
    assert "sees 2 deg across" in the_text(with_camera(front_rig(), fx=30000, fy=30000, k1=0, k2=0, p1=0, p2=0))
    twice = Rig([front_rig().cameras[0]] * 2, np.repeat(front_rig().T_base_cam, 2, axis=0), ["a", "b"])
    assert "the very place and direction of a" in the_text(twice)


def test_coefficients_in_the_wrong_order():
    rig = Rig([KannalaBrandtCamera(300, 300, 320, 240, 640, 480, -2.9, 0.4, 0.0, 0.0)], front_rig().T_base_cam, ["a"])
    assert "lens" in kinds(rig)
