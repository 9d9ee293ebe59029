"""Cameras of simulated vehicles (room: simulation; host).

In: an image size. Out: Rig.
"""

import numpy as np

from semloc_jax.cameras import BrownConradyCamera, KannalaBrandtCamera, Rig, mounted


def front_rig(width_px: int = 960, height_px: int = 600) -> Rig:
    """One camera behind the windscreen: radtan, 66 deg wide, 3 deg down."""
    scale = width_px / 960.0
    camera = BrownConradyCamera(
        742.3 * scale,
        743.1 * scale,
        0.5 * (width_px - 1) - 3.1 * scale,
        0.5 * (height_px - 1) - 7.8 * scale,
        width_px,
        height_px,
        k1=-0.118,
        k2=0.042,
        p1=0.0006,
        p2=-0.0004,
    )
    return Rig([camera], mounted((1.62, 0.04, 1.43), yaw_deg=0.2, down_deg=3.0, roll_deg=0.5)[None], ["front"])


def surround_rig(width_px: int = 640, height_px: int = 480) -> Rig:
    """Four fisheyes on bumpers and mirrors: equidistant, +-96 deg."""
    focal = 196.0 * width_px / 640.0
    places = {
        "front": ((3.8, 0.0, 0.66), 0.3, 22.0, 0.4),
        "left": ((1.95, 1.02, 0.98), 90.5, 38.0, 0.6),
        "rear": ((-0.96, 0.0, 0.84), 181.0, 26.5, -0.5),
        "right": ((1.95, -1.02, 0.98), -89.4, 37.0, 0.3),
    }
    cameras, poses = [], []
    for number, (position, yaw, down, roll) in enumerate(places.values()):
        f = focal * (1.0 + 0.004 * (number - 1.5))
        cx, cy = 0.5 * (width_px - 1) + 1.3 * number - 2.0, 0.5 * (height_px - 1) + 0.7 * number
        k = (-0.013, -0.0042, 0.0011, -0.0002)
        camera = KannalaBrandtCamera(f, 1.0007 * f, cx, cy, width_px, height_px, *k, max_theta_rad=np.radians(96.0))
        cameras.append(camera)
        poses.append(mounted(position, yaw, down, roll))
    return Rig(cameras, np.stack(poses), list(places))
