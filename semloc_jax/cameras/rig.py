"""The cameras of one vehicle, where they sit, and the same with other lenses (room: cameras; pure JAX).

In: cameras and extrinsics, or what one measures with a rule. Out: Rig, its selections and groups of one camera model.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from semloc_jax.cameras.base import Camera, stack_cameras
from semloc_jax.errors import SemlocError
from semloc_jax.geometry.rigid import pose_from


class CameraGroup(NamedTuple):
    """Cameras of one model, stacked for `vmap`."""

    index: tuple[int, ...]
    """Their indices in the rig."""
    camera: Camera
    """One camera with a leading axis on every leaf."""
    T_base_cam: Float[Array | np.ndarray, "n 4 4"]


class Rig(eqx.Module):
    """Cameras, their poses T_base_cam [n 4 4] in the base frame (rear axle on the ground), and their names."""

    cameras: tuple[Camera, ...]
    T_base_cam: Float[Array | np.ndarray, "n 4 4"]
    names: tuple[str, ...] = eqx.field(static=True)
    finer: int = eqx.field(static=True, default=1)
    """Pixels on a side for one that the cameras took; see `perception.finer_masks`."""

    def __init__(
        self,
        cameras: Sequence[Camera],
        T_base_cam: Float[Array | np.ndarray, "n 4 4"] | Sequence,
        names: Sequence[str],
        finer: int = 1,
    ) -> None:
        """Cameras, extrinsics and names, in one order."""
        self.cameras, self.names, self.finer = tuple(cameras), tuple(names), finer
        if not isinstance(T_base_cam, jax.Array) and any(isinstance(T, jax.Array) for T in T_base_cam):
            T_base_cam = jnp.stack([jnp.asarray(T) for T in T_base_cam])
        self.T_base_cam = T_base_cam if isinstance(T_base_cam, jax.Array) else np.asarray(T_base_cam, dtype=np.float64)
        if not len(self.cameras) == len(self.names) == len(self.T_base_cam):
            raise SemlocError(
                f"rig: given {len(self.cameras)} cameras, {len(self.T_base_cam)} poses and {len(self.names)} names; "
                "expected one pose and one name for each camera"
            )
        # Names become folders, and many file systems do not tell capital from small letters.
        if len({name.casefold() for name in self.names}) != len(self.names):
            raise SemlocError(
                f"rig: given names {list(self.names)}; expected names that differ by more than case; rename the cameras"
            )

    def __len__(self) -> int:
        """Number of cameras."""
        return len(self.cameras)

    def index(self, name: str) -> int:
        """Where a camera stands in the rig.

        Raises:
            SemlocError: There is no camera of that name.
        """
        if name not in self.names:
            raise SemlocError(f"camera '{name}': not in the calibration; expected one of {', '.join(self.names)}")
        return self.names.index(name)

    def select(self, names: Sequence[str]) -> "Rig":
        """The rig with these cameras only, in this order."""
        if tuple(names) == tuple(self.names):
            return self
        index = [self.index(name) for name in names]
        return Rig([self.cameras[i] for i in index], self.T_base_cam[np.array(index, dtype=int)], names, self.finer)

    def with_cameras(self, cameras: Sequence[Camera]) -> "Rig":
        """Other cameras in the same places."""
        return Rig(cameras, self.T_base_cam, self.names, self.finer)

    def with_places(self, T_base_cam: Float[Array | np.ndarray, "n 4 4"]) -> "Rig":
        """The same cameras in other places."""
        return Rig(self.cameras, T_base_cam, self.names, self.finer)

    def with_pixels(self, times: int) -> "Rig":
        """The rig of pictures with `times` pixels on a side for each."""
        if times == 1:
            return self
        cameras = [camera.resized(times * camera.width, times * camera.height) for camera in self.cameras]
        return Rig(cameras, self.T_base_cam, self.names, times * self.finer)

    def groups(self) -> tuple[CameraGroup, ...]:
        """The cameras grouped by model, each group stacked."""
        models = dict.fromkeys(type(camera) for camera in self.cameras)
        groups = []
        for model in models:
            index = tuple(i for i, camera in enumerate(self.cameras) if type(camera) is model)
            camera = stack_cameras([self.cameras[i] for i in index])
            groups.append(CameraGroup(index, camera, self.T_base_cam[np.array(index)]))
        return tuple(groups)


_R_BODY_CAM = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""A camera that looks along base x, upright."""


def mounted(
    position_m: Sequence[float | int], yaw_deg: float | int = 0, down_deg: float | int = 0, roll_deg: float | int = 0
) -> Float[np.ndarray, "4 4"]:
    """T_base_cam [4 4] of a camera that looks `yaw_deg` to the left of straight ahead and `down_deg` below the horizon.

    Args:
        position_m: Centre of the lens in the base frame [m]: x forward of the rear axle, y to the left, z above ground.
        yaw_deg: 0 looks ahead, 90 to the left, -90 to the right, 180 back.
        down_deg: Tilt towards the road.
        roll_deg: Turn about the line of sight.

    >>> T_base_cam = sj.mounted((1.6, 0.0, 1.4), down_deg=3.0)
    >>> T_base_cam[:3, 2].round(3)  # the line of sight: ahead and a little down
    array([ 0.999,  0.   , -0.052])
    """
    (cy, cp, cr), (sy, sp, sr) = (turn(np.radians([yaw_deg, down_deg, roll_deg])) for turn in (np.cos, np.sin))
    yaw = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    down = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    roll = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return pose_from(yaw @ down @ roll @ _R_BODY_CAM, position_m)
