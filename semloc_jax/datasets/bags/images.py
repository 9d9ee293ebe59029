"""Image messages of ROS, raw and compressed (room: datasets; host).

In: decoded sensor_msgs Image or CompressedImage. Out: uint8[h w] or uint8[h w 3], blue green red.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from semloc_jax.datasets.bags.store import BagStore
from semloc_jax.datasets.pictures import decode_picture
from semloc_jax.errors import SemlocError

RAW, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_CHANNELS = {
    "mono8": 1,
    "8UC1": 1,
    "8SC1": 1,
    "bgr8": 3,
    "8UC3": 3,
    "rgb8": 3,
    "bgra8": 4,
    "8UC4": 4,
    "rgba8": 4,
    "mono16": 1,
    "16UC1": 1,
    "yuv422": 2,
    "uyvy": 2,
    "yuv422_yuy2": 2,
    "yuyv": 2,
    "bayer_rggb8": 1,
    "bayer_bggr8": 1,
    "bayer_gbrg8": 1,
    "bayer_grbg8": 1,
}
_TO_BGR = {
    "rgb8": cv2.COLOR_RGB2BGR,
    "bgra8": cv2.COLOR_BGRA2BGR,
    "8UC4": cv2.COLOR_BGRA2BGR,
    "rgba8": cv2.COLOR_RGBA2BGR,
    "yuv422": cv2.COLOR_YUV2BGR_UYVY,
    "uyvy": cv2.COLOR_YUV2BGR_UYVY,
    "yuv422_yuy2": cv2.COLOR_YUV2BGR_YUY2,
    "yuyv": cv2.COLOR_YUV2BGR_YUY2,
    # OpenCV names a pattern by its second row, ROS by its first.
    "bayer_rggb8": cv2.COLOR_BayerBG2BGR,
    "bayer_bggr8": cv2.COLOR_BayerRG2BGR,
    "bayer_gbrg8": cv2.COLOR_BayerGR2BGR,
    "bayer_grbg8": cv2.COLOR_BayerGB2BGR,
}


@dataclass(frozen=True)
class BagPicture:
    """One image message, read on first use."""

    store: BagStore
    topic: str
    recorded_ns: int

    def __str__(self) -> str:
        return f"{self.store.path} {self.topic} at {self.recorded_ns} ns"

    def read(self) -> np.ndarray:
        """The picture of the message.

        Raises:
            SemlocError: the message is damaged or has an encoding that is not known.
        """
        message = self.store.decoded(self.topic, self.store.at(self.topic, self.recorded_ns))
        if self.store.types[self.topic] == COMPRESSED:
            return decode_picture(np.asarray(message.data, np.uint8), f"bag image {self}")
        return picture_of(message, f"bag image {self}")


def picture_of(message: Any, where: str) -> np.ndarray:
    """The picture of a raw image message.

    Raises:
        SemlocError: an encoding that is not known, or fewer bytes than the size requires.
    """
    channels = _CHANNELS.get(message.encoding)
    if channels is None:
        raise SemlocError(
            f"{where}: encoding '{message.encoding}' is not supported; expected one of {', '.join(_CHANNELS)}"
        )
    height, width, step = int(message.height), int(message.width), int(message.step)
    is_deep = message.encoding in ("mono16", "16UC1")
    row = width * channels * (2 if is_deep else 1)
    data = np.asarray(message.data, np.uint8)
    if not (0 < row <= step and height > 0 and data.size >= height * step):
        raise SemlocError(
            f"{where}: {data.size} bytes for {width}x{height} px of {message.encoding}, {step} bytes a row; expected "
            f"{height} x {row}; record it again"
        )
    rows = data[: height * step].reshape(height, step)[:, :row]
    if is_deep:
        # The upper byte of each value is the picture in 8 bit.
        return np.ascontiguousarray(rows.reshape(height, width, 2)[..., 0 if message.is_bigendian else 1])
    pixels = np.ascontiguousarray(rows).reshape((height, width) if channels == 1 else (height, width, channels))
    code = _TO_BGR.get(message.encoding)
    return pixels if code is None else cv2.cvtColor(pixels, code)
