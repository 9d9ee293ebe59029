"""A video with a csv of times (room: datasets; host).

In: drive.mp4 (avi, mkv, mov) with drive.csv or times.csv (column t, one row for each picture) and a calibration beside
it; gps.csv or gps.nmea, wheel_odom.csv, imu.csv and poses.tum where they lie there. Out: Drive.
"""

import logging
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from semloc_jax.cameras.io import read_calibration
from semloc_jax.datasets.base import IMAGE, Drive
from semloc_jax.datasets.beside import calibration_beside, logs_beside, maps_beside
from semloc_jax.datasets.clock import TIME_NAMES, seconds
from semloc_jax.datasets.in_step import PictureStream, frames_in_step
from semloc_jax.datasets.tables import column_names, read_columns
from semloc_jax.errors import SemlocError

_LOG = logging.getLogger(__name__)
_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov", ".m4v")
_TIME = (*TIME_NAMES, "pts")
_MAX_SKIP = 60


class Video:
    """A video file that is read forward and, where that is farther, by seeking."""

    def __init__(self, path: Path) -> None:
        """Open a video.

        Raises:
            SemlocError: the file cannot be decoded.
        """
        self.path = path
        self._capture = cv2.VideoCapture(str(path))
        self.num_frames = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)) if self._capture.isOpened() else 0
        self.rate_hz = float(self._capture.get(cv2.CAP_PROP_FPS))
        if self.num_frames < 1:
            raise SemlocError(f"video {path}: cannot be decoded; expected mp4, avi, mkv or mov that OpenCV reads")
        self._next = 0

    def picture(self, index: int) -> np.ndarray:
        """Picture number `index`, uint8[h w 3], blue green red.

        Raises:
            SemlocError: the video ends before it or is damaged there.
        """
        if not self._next <= index <= self._next + _MAX_SKIP:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, index)
            self._next = index
        while self._next < index and self._capture.grab():
            self._next += 1
        found, picture = self._capture.read()
        if not found or self._next != index:
            raise SemlocError(f"video {self.path}: no picture {index} of {self.num_frames}; the file is damaged there")
        self._next += 1
        return picture


@dataclass(frozen=True)
class VideoPicture:
    """One picture of a video, decoded on first use."""

    video: Video
    index: int

    def __str__(self) -> str:
        return f"{self.video.path} picture {self.index}"

    def read(self) -> np.ndarray:
        """The picture, uint8[h w 3], blue green red."""
        return self.video.picture(self.index)


def is_video(path: Path) -> bool:
    """Whether a path is a video file."""
    return path.suffix.lower() in _SUFFIXES and path.is_file()


def read_video(path: str | Path, calibration: str | Path | None = None) -> Drive:
    """Drive of a video of one camera, with what lies beside it.

    Times are those of the csv, one for each picture; without a csv pictures follow each other at the rate of the video
    from 0 s on.

    Raises:
        SemlocError: the video cannot be decoded, there is no calibration, or the csv has another number of rows.
    """
    path = Path(path)
    video = Video(path)
    given = calibration or calibration_beside(path)
    if given is None:
        raise SemlocError(f"video {path}: no calibration; give --calib FILE, or put a calib.yaml beside it")
    rig = read_calibration(given)
    if len(rig) > 1 and path.stem not in rig.names:
        raise SemlocError(f"video {path}: the calibration has cameras {', '.join(rig.names)}; name the video after one")
    rig = rig.select([path.stem if path.stem in rig.names else rig.names[0]])
    pictures = tuple(VideoPicture(video, index) for index in range(video.num_frames))
    stream = PictureStream(_times(video), pictures, tuple(f"{index:06d}" for index in range(video.num_frames)))
    logs = logs_beside(path)
    rig, frames = frames_in_step({IMAGE: {rig.names[0]: stream}}, rig, logs.odometry, f"video {path}")
    return Drive(
        name=path.stem,
        path=path,
        frames=frames,
        rig=rig,
        maps=maps_beside(path),
        truth=logs.truth,
        gnss=logs.gnss,
        odometry=logs.odometry,
        imu=logs.imu,
    )


def _times(video: Video) -> np.ndarray:
    for file in (video.path.with_suffix(".csv"), video.path.with_name("times.csv")):
        if not file.is_file():
            continue
        names = column_names(file, {"time": _TIME})
        if not names:
            raise SemlocError(f"table {file}: no column of times; expected one of {', '.join(_TIME)}")
        values = read_columns(file, [names["time"]])[names["time"]]
        if len(values) != video.num_frames:
            raise SemlocError(
                f"table {file}: {len(values)} times for {video.num_frames} pictures of {video.path.name}; expected one "
                "for each; were pictures dropped?"
            )
        return seconds(values, f"table {file}", names["time"])[0]
    if not 0.0 < video.rate_hz < 1000.0:
        raise SemlocError(f"video {video.path}: states a rate of {video.rate_hz} Hz; put a csv of times beside it")
    _LOG.warning(
        "video %s: nothing states times; pictures follow each other at %g Hz from 0 s. Write %s: a column t with a row "
        "for each of its %d pictures",
        *(video.path, video.rate_hz, video.path.with_suffix(".csv").name, video.num_frames),
    )
    return np.arange(video.num_frames) / video.rate_hz
