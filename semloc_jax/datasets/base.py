"""What every data set looks like from outside (room: datasets; host).

In: files of a recorded or simulated drive. Out: Drive: frames, cameras, sensors, maps and truth behind one face.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from semloc_jax.cameras import Rig
from semloc_jax.datasets.gnss import GnssPrior, gnss_prior
from semloc_jax.datasets.pictures import StoredPicture, as_colour, read_picture
from semloc_jax.datasets.sensors import GnssTrack, Imu, WheelOdometry
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory
from semloc_jax.geometry.geodesy import Geodetic

IMAGE = "rgb"
"""Kind of file that holds the colour images; every other kind is a source of masks."""


@dataclass(frozen=True)
class Frame:
    """The images and masks of one time; files are read on first use.

    Args:
        index: place in the drive.
        id: name of its files.
        time_s: time of the vehicle pose [s], mid exposure.
        variant: weather or lighting, empty where unknown.
        rig: cameras of this frame. Where cameras trigger at different times, its extrinsics hold the motion of the
            vehicle between `time_s` and each trigger; else it is the rig of the drive.
        files: file, or message of a recording, for each kind (`rgb`, mask sources) and camera.
        draw_dynamic: draws the moving objects of a camera, where the data set knows them.
    """

    index: int
    id: str
    time_s: float
    variant: str
    rig: Rig
    files: Mapping[str, Mapping[str, Path | StoredPicture]] = field(repr=False)
    draw_dynamic: Callable[[str], np.ndarray] | None = field(default=None, repr=False)

    def image(self, camera: str) -> np.ndarray:
        """Colour image uint8[h w 3] in OpenCV's order blue green red."""
        return as_colour(read_picture(self.path(IMAGE, camera)))

    def mask(self, source: str, camera: str) -> np.ndarray:
        """Class ids uint8[h w] from the given source, e.g. `sem` or `sem_net`."""
        mask = read_picture(self.path(source, camera))
        if mask.ndim != 2 or mask.dtype != np.uint8:
            raise SemlocError(
                f"mask {self.path(source, camera)}: got {mask.dtype}{list(mask.shape)}; expected one channel of uint8 "
                "class ids; save class ids instead of colours"
            )
        return mask

    def masks(self, source: str) -> list[np.ndarray]:
        """Class ids of every camera, in the order of the rig."""
        return [self.mask(source, camera) for camera in self.rig.names]

    def dynamic_mask(self, camera: str) -> np.ndarray | None:
        """bool[h w], True on objects that may move; None where the data set does not know them."""
        return None if self.draw_dynamic is None else self.draw_dynamic(camera)

    def has(self, kind: str, camera: str) -> bool:
        """Whether there is a file of this kind for the camera."""
        stored = self.files.get(kind, {}).get(camera)
        return stored.is_file() if isinstance(stored, Path) else stored is not None

    def path(self, kind: str, camera: str) -> Path | StoredPicture:
        """File, or message of a recording, of one kind and camera.

        Raises:
            SemlocError: the data set has no such kind or camera.
        """
        by_camera = self.files.get(kind)
        if by_camera is None:
            raise SemlocError(f"frame {self.id}: no '{kind}'; expected one of {', '.join(self.files)}")
        if camera not in by_camera:
            raise SemlocError(f"frame {self.id}: no camera '{camera}'; expected one of {', '.join(by_camera)}")
        return by_camera[camera]


@dataclass(frozen=True)
class Drive:
    """One drive.

    Args:
        name: for messages and result folders.
        path: folder it was read from.
        frames: in time order.
        rig: cameras with constant extrinsics.
        table_name: class table of its masks, a preset of the perception room; empty where there are no masks.
        class_ids: id of each class name in the masks, where the data set states them.
        mask_sources: kinds of masks on disk, best first.
        maps: map file by kind, best first.
        truth: reference poses T_map_base, None where unknown.
        gnss: fixes, None where there are none.
        odometry: wheel odometry, None where there is none.
        imu: inertial data, None where there is none.
    """

    name: str
    path: Path
    frames: tuple[Frame, ...]
    rig: Rig
    table_name: str = ""
    class_ids: Mapping[str, int] = field(default_factory=dict)
    mask_sources: tuple[str, ...] = ()
    maps: Mapping[str, Path] = field(default_factory=dict)
    truth: Trajectory | None = None
    gnss: GnssTrack | None = None
    odometry: WheelOdometry | None = None
    imu: Imu | None = None

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def map_path(self) -> Path | None:
        """The best map of the data set."""
        return next(iter(self.maps.values()), None)

    @property
    def variants(self) -> tuple[str, ...]:
        """Weather and lighting conditions in the order in which they appear."""
        return tuple(dict.fromkeys(frame.variant for frame in self.frames))

    def truth_at(self, frame: Frame) -> np.ndarray:
        """True T_map_base [4 4] of a frame.

        Raises:
            SemlocError: the drive has no truth at that time.
        """
        if self.truth is None:
            raise SemlocError(f"drive {self.name}: has no reference poses; expected a file poses_body.tum")
        return self.truth.interpolate(np.array([frame.time_s]))[0]

    def gnss_prior(self, time_s: float, causal: bool = False) -> GnssPrior:
        """First guess of the pose from the fixes; see `datasets.gnss.gnss_prior`.

        Raises:
            SemlocError: the drive has no fixes.
        """
        if self.gnss is None:
            raise SemlocError(f"drive {self.name}: has no satellite fixes; expected gps.csv; give an initial pose")
        return gnss_prior(self.gnss, time_s, self.odometry, causal)

    def in_map_of(self, origin: Geodetic | None) -> "Drive":
        """The drive with its fixes in the frame of a map that sits at `origin` on the earth.

        Raises:
            SemlocError: the fixes are known on the earth only and the map does not say where it is.
        """
        if self.gnss is None or self.gnss.origin is None:
            return self
        if origin is None:
            raise SemlocError(
                f"drive {self.name}: its fixes are in latitude and longitude and the map does not say where on the "
                "earth its frame is; give it a place (semloc convert MAP OUT.gpkg --origin LAT,LON,HEIGHT), or --prior "
                "FILE.tum in the frame of the map"
            )
        return replace(self, gnss=self.gnss.seen_from(origin))
