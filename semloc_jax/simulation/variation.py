"""What another drive of the same world has of its own (room: simulation; host).

In: the number of the drive. Out: its random numbers, how its cameras are mounted, how bad its masks are.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from semloc_jax.cameras import Rig
from semloc_jax.geometry import rigid
from semloc_jax.simulation.degrade import Degradation

_MOUNT_M, _MOUNT_DEG = 0.005, 0.3
_QUALITY = (0.6, 1.5)
_SPEED = (0.88, 1.0)
"""No drive is faster than the first, so that all of them stay where the world was built."""
_DRIVE, _PICTURE = 11, 12

PictureRandom = Callable[[int, int], np.random.Generator]


@dataclass(frozen=True)
class Variation:
    """One drive of a world.

    Args:
        rng: of traffic, motion and sensors.
        of_picture: random numbers of the masks and the image of a frame and a camera.
        is_first: whether it is drive 0, whose cameras and masks are as asked for.
        is_restartable: whether each picture has random numbers of its own, so that those on disk can stay.
    """

    rng: np.random.Generator
    of_picture: PictureRandom
    is_first: bool
    is_restartable: bool

    def mounted(self, rig: Rig) -> Rig:
        """The cameras, each a few millimetres and tenths of a degree off for drives other than the first."""
        if self.is_first:
            return rig
        size = np.repeat([_MOUNT_M, np.radians(_MOUNT_DEG)], 3)
        off = np.stack([rigid.exp(size * xi) for xi in self.rng.normal(size=(len(rig), 6))])
        return Rig(rig.cameras, np.asarray(rig.T_base_cam) @ off, rig.names)

    def degradation(self, level: Degradation) -> Degradation:
        """How bad the masks are: up to half as bad again, or better by a third."""
        if self.is_first:
            return level
        worse = float(self.rng.uniform(*_QUALITY))
        names = ("wobble_px", "erosion_share", "missing_share", "swap_share", "num_holes", "num_false")
        return replace(level, **{name: min(worse * getattr(level, name), _most(name)) for name in names})

    def speed(self, speed_mps: float) -> float:
        """The mean speed [m/s]."""
        return speed_mps if self.is_first else speed_mps * float(self.rng.uniform(*_SPEED))


def variation(key: Sequence[int], drive: int, rng: np.random.Generator, has_own_pictures: bool) -> Variation:
    """Drive `drive` of a world.

    Args:
        key: seed of the world.
        drive: 0 goes on with the random numbers of the world.
        rng: that of the world.
        has_own_pictures: whether each picture of drive 0 has its own random numbers, too.
    """
    own = rng if drive == 0 else np.random.default_rng([*key, _DRIVE, drive])
    restartable = has_own_pictures or drive > 0

    def of_picture(frame: int, camera: int) -> np.random.Generator:
        return np.random.default_rng([*key, _PICTURE, drive, frame, camera]) if restartable else own

    return Variation(own, of_picture, drive == 0, restartable)


def _most(name: str) -> float:
    return 0.9 if name.endswith("_share") else np.inf
