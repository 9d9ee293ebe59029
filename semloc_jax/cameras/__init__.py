"""Cameras: 3D points of a camera frame to pixels and back (room: cameras).

In: points `p_cam` (z forward, x right, y down) and calibration files. Out: pixels `uv` (the centre of the top-left
pixel is (0, 0)), rays, rigs.
"""

from semloc_jax.cameras.angle_polynomial import PolynomialFisheyeCamera
from semloc_jax.cameras.base import Camera, stack_cameras
from semloc_jax.cameras.bev import BevCamera
from semloc_jax.cameras.cylinder import CylindricalCamera
from semloc_jax.cameras.fisheye import KannalaBrandtCamera
from semloc_jax.cameras.io import read_calibration, write_calibration
from semloc_jax.cameras.pinhole import BrownConradyCamera, PinholeCamera
from semloc_jax.cameras.rig import Rig

__all__ = [
    "BevCamera",
    "BrownConradyCamera",
    "Camera",
    "CylindricalCamera",
    "KannalaBrandtCamera",
    "PinholeCamera",
    "PolynomialFisheyeCamera",
    "Rig",
    "read_calibration",
    "stack_cameras",
    "write_calibration",
]
