"""Calibrations and roads that a frame is solved with again, one thing changed at a time (room: localization; host).

In: Rig, WatchConfig. Out: names of what is changed, and rigs with it.
"""

import equinox as eqx
import numpy as np

from semloc_jax.cameras import BrownConradyCamera, Camera, PinholeCamera, Rig
from semloc_jax.cameras.other_lenses import FOCAL_SHARE, longer, with_distortion
from semloc_jax.localization.watch_config import WatchConfig
from semloc_jax.runtime.memory import once_for_each

FOCAL, RADIAL, WIDTH = "focal", "radial", "width"
_TURNS = ("pitch", "yaw")
ASIDE = "yaw all"
"""All cameras look aside alike: those at the front and at the rear then do not agree how far to the side the vehicle
stands."""
STEPS = np.array([1.0, -1.0, 2.0, -2.0])
"""How far each alternative is changed, in its units. The far ones are asked only where near ones fit better so far:
beyond the reach of the masks costs end, and the near ones do not tell the size of a large fault."""
OTHER_SIGN = len(STEPS)
"""Place among `changed_rigs` of a distortion of the wrong sign."""


def alternatives(num_cameras: int) -> tuple[str, ...]:
    """What is changed in the other calibrations, each a little up and a little down; and the width of the road in the
    map, which height and lens make up for."""
    turns = [ASIDE, *(f"{turn} {k}" for k in range(num_cameras) for turn in _TURNS)] if num_cameras > 1 else []
    return (FOCAL, RADIAL, WIDTH, *turns)


def unit_of(name: str, config: WatchConfig) -> float:
    """By how much one of `alternatives` is changed: a share of the image, a width [m] or an angle [rad]."""
    units = {FOCAL: FOCAL_SHARE, RADIAL: config.radial_share, WIDTH: config.width_m}
    return units.get(name, config.turn_rad)


@once_for_each
def changed_rigs(rig: Rig, name: str, config: WatchConfig) -> tuple[Rig, ...]:
    """The calibrations that a frame is solved with again: one alternative in its `STEPS`; after those of the distortion
    comes `OTHER_SIGN`, where lenses have any."""
    other = with_distortion(rig, -1.0) if name == RADIAL else None
    steps = tuple(_changed(rig, name, step * unit_of(name, config)) for step in STEPS)
    return steps if other is None else (*steps, other)


def widths(name: str, config: WatchConfig) -> tuple[float, ...]:
    """By how much the road is wider with each of `changed_rigs` [m]."""
    return (*(STEPS * (config.width_m if name == WIDTH else 0.0)).tolist(), 0.0)


def _changed(rig: Rig, name: str, by: float) -> Rig:
    if name == WIDTH:
        return rig
    if name == FOCAL:
        return longer(rig, by)
    if name == RADIAL:
        return rig.with_cameras(tuple(_bent(camera, by) for camera in rig.cameras))
    turn, which = name.split()
    cameras = slice(None) if name == ASIDE else int(which)
    T_base_cam = np.array(rig.T_base_cam, dtype=np.float64)
    T_base_cam[cameras, :3, :3] = _about(turn, by) @ T_base_cam[cameras, :3, :3]
    return rig.with_places(T_base_cam)


def _bent(camera: Camera, share: float) -> Camera:
    """A lens whose radial term makes the side of the image larger by a share."""
    if isinstance(camera, PinholeCamera):
        camera = BrownConradyCamera(camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
    if not hasattr(camera, "k1"):
        return camera
    side = 0.5 * float(camera.width) / float(camera.fx)
    return eqx.tree_at(lambda c: c.k1, camera, camera.k1 + share / side**2)


def _about(turn: str, angle_rad: float) -> np.ndarray:
    """Rotation about the left (pitch) or the upward (yaw) axis of the vehicle."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    if turn == "pitch":
        return np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
