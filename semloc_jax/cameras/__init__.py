"""Cameras: 3D points of a camera frame to pixels and back (room: cameras; pure JAX).

In: points `p_cam` (z forward, x right, y down). Out: pixels `uv` (the centre of the top-left pixel is (0, 0)), rays,
rigs. Calibration files are read and written by `cameras.io`.
"""

from semloc_jax.cameras.angle_polynomial import PolynomialFisheyeCamera
from semloc_jax.cameras.base import Camera, stack_cameras
from semloc_jax.cameras.bev import BevCamera
from semloc_jax.cameras.cylinder import CylindricalCamera
from semloc_jax.cameras.double_sphere import DoubleSphereCamera
from semloc_jax.cameras.fisheye import KannalaBrandtCamera
from semloc_jax.cameras.pinhole import BrownConradyCamera, PinholeCamera
from semloc_jax.cameras.rig import Rig, mounted

__all__ = [
    "BevCamera",
    "BrownConradyCamera",
    "Camera",
    "CylindricalCamera",
    "DoubleSphereCamera",
    "KannalaBrandtCamera",
    "PinholeCamera",
    "PolynomialFisheyeCamera",
    "Rig",
    "mounted",
    "stack_cameras",
]
