"""Sequences to bags, for tools that read nothing else and for tests (room: datasets; host).

In: Drive. Out: a ROS 1 .bag or the folder of a ROS 2 bag (sqlite3 or mcap).
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from semloc_jax.cameras import Camera
from semloc_jax.cameras.models import model_of
from semloc_jax.datasets.bags.store import rosbags_module
from semloc_jax.datasets.base import IMAGE, Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.geometry.geodesy import Geodetic, wgs84_from_enu
from semloc_jax.storage import making

BASE, TRANSFORMS = "base_link", "tf2_msgs/msg/TFMessage"


def write_bag(
    drive: Drive,
    path: str | Path,
    storage: Literal["sqlite3", "mcap", "ros1"] = "mcap",
    origin: Geodetic | None = None,
    frames: Sequence[Frame] | None = None,
    compressed: bool = False,
    clock_offset_s: float = 0.0,
) -> Path:
    """Writes images, masks, calibration and sensors of a drive as a bag, which takes its place when it is whole.

    Topics: /CAMERA/image_raw (or image_raw/compressed), /CAMERA/KIND for masks, /CAMERA/camera_info, /gnss/fix,
    /odom (twist), /imu, /tf_static (base_link to cameras) and, where there is a truth, /tf (map to base_link).

    Args:
        drive: the drive.
        path: .bag file for ros1, else a folder that does not exist yet.
        storage: sqlite3, mcap or ros1.
        origin: place on the earth of the frame of the fixes; needed where they are in the frame of a map.
        frames: which; None for all.
        compressed: images as jpg files (the files of the drive themselves where they are jpg) and masks as png.
        clock_offset_s: added to every time; ROS has no times before zero [s].

    Raises:
        SemlocError: rosbags is missing, the path exists, a camera has no ROS model, or a time is negative.
    """
    path = Path(path)
    if path.exists():
        raise SemlocError(f"bag {path}: is there already; give a new name")
    with making(path) as partial:
        scribe = _Scribe(partial, storage, clock_offset_s)
        with scribe.writer:
            _write_calibration(scribe, drive)
            for frame in drive.frames if frames is None else frames:
                _write_frame(scribe, frame, compressed)
            _write_sensors(scribe, drive, origin)
            scribe.flush()
    return path


class _Scribe:
    """Makes messages of one ROS version and writes them in time order."""

    def __init__(self, path: Path, storage: str, clock_offset_s: float = 0.0) -> None:
        rosbags = rosbags_module()
        from rosbags import rosbag1, rosbag2

        stores = rosbags.typesys.Stores
        self._offset_s = clock_offset_s
        self.is_ros1 = storage == "ros1"
        self.types = rosbags.typesys.get_typestore(stores.ROS1_NOETIC if self.is_ros1 else stores.ROS2_HUMBLE)
        if self.is_ros1:  # the library's types of ROS 1 lack those of tf2
            text = "geometry_msgs/TransformStamped[] transforms"
            self.types.register(rosbags.typesys.get_types_from_msg(text, TRANSFORMS))
        plugin = None if self.is_ros1 else rosbag2.StoragePlugin[storage.upper()]
        self.writer: Any = (
            rosbag1.Writer(path) if self.is_ros1 else rosbag2.Writer(path, version=9, storage_plugin=plugin)
        )
        self._connections: dict[str, Any] = {}
        self._waiting: list[tuple[int, str, bytes]] = []

    def make(self, name: str, **fields: Any) -> Any:
        """A message or a part of one, e.g. make("geometry_msgs/msg/Point", x=1.0, y=2.0, z=0.0)."""
        return self.types.types[name](**fields)

    def header(self, time_s: float, frame: str) -> Any:
        """A header with that time."""
        stamp_ns = self._stamp_ns(time_s)
        stamp = self.make(
            "builtin_interfaces/msg/Time", sec=stamp_ns // 1_000_000_000, nanosec=stamp_ns % 1_000_000_000
        )
        sequence = {"seq": 0} if self.is_ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **sequence)

    def put(self, topic: str, time_s: float, kind: str, message: Any) -> None:
        """Keep a message for writing."""
        if topic not in self._connections:
            self._connections[topic] = self.writer.add_connection(topic, kind, typestore=self.types)
        serialize = self.types.serialize_ros1 if self.is_ros1 else self.types.serialize_cdr
        self._waiting.append((self._stamp_ns(time_s), topic, bytes(serialize(message, kind))))

    def vector(self, kind: str, xyz: Iterable[float]) -> Any:
        """A Vector3 or Point."""
        return self.make(f"geometry_msgs/msg/{kind}", **dict(zip("xyz", map(float, xyz), strict=True)))

    def transform(self, time_s: float, parent: str, child: str, T: np.ndarray) -> Any:
        """A TransformStamped."""
        quaternion = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
        rotation = self.make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", quaternion, strict=True)))
        motion = self.make(
            "geometry_msgs/msg/Transform", translation=self.vector("Vector3", T[:3, 3]), rotation=rotation
        )
        header = self.header(time_s, parent)
        return self.make("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=motion)

    def _stamp_ns(self, time_s: float) -> int:
        stamp_ns = round((time_s + self._offset_s) * 1e9)
        if stamp_ns < 0:
            raise SemlocError(f"bag: time {time_s:.3f} s is before zero, which ROS does not know; give clock_offset_s")
        return stamp_ns

    def flush(self) -> None:
        """Write everything in time order."""
        for time_ns, topic, raw in sorted(self._waiting, key=lambda entry: entry[0]):
            self.writer.write(self._connections[topic], time_ns, raw)


def _write_calibration(scribe: _Scribe, drive: Drive) -> None:
    start_s = drive.frames[0].time_s
    links = []
    for name, camera, T in zip(drive.rig.names, drive.rig.cameras, drive.rig.T_base_cam, strict=True):
        scribe.put(f"/{name}/camera_info", start_s, "sensor_msgs/msg/CameraInfo", _camera_info(scribe, camera, name))
        links.append(scribe.transform(start_s, BASE, _optical(name), np.asarray(T)))
    scribe.put("/tf_static", start_s, TRANSFORMS, scribe.make(TRANSFORMS, transforms=links))


def _camera_info(scribe: _Scribe, camera: Camera, name: str) -> Any:
    model = model_of(camera)
    if model is None or not model.ros:
        raise SemlocError(f"bag: camera {name} is a {type(camera).__name__}; expected pinhole, radtan or equidistant")
    K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], dtype=np.float64)
    D = np.array([float(getattr(camera, key)) for key in model.coefficients] or [0.0] * 5)
    fields = {"d": D, "k": K.ravel(), "r": np.eye(3).ravel(), "p": np.hstack([K, np.zeros((3, 1))]).ravel()}
    if scribe.is_ros1:
        fields = {key.upper(): value for key, value in fields.items()}
    region = scribe.make(
        "sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    width, height = camera.resolution
    return scribe.make(
        "sensor_msgs/msg/CameraInfo",
        header=scribe.header(0.0, _optical(name)),
        width=width,
        height=height,
        distortion_model=model.ros,
        binning_x=0,
        binning_y=0,
        roi=region,
        **fields,
    )


def _write_frame(scribe: _Scribe, frame: Frame, compressed: bool) -> None:
    for kind, by_camera in frame.files.items():
        for camera in by_camera:
            if not frame.has(kind, camera):
                continue
            topic = f"/{camera}/image_raw" if kind == IMAGE else f"/{camera}/{kind}"
            picture = frame.image(camera) if kind == IMAGE else frame.mask(kind, camera)
            header = scribe.header(frame.time_s, _optical(camera))
            if compressed:
                stored, is_jpg = frame.path(kind, camera), kind == IMAGE
                is_ready = isinstance(stored, Path) and stored.suffix == (".jpg" if is_jpg else ".png")
                data = stored.read_bytes() if is_ready else cv2.imencode(".jpg" if is_jpg else ".png", picture)[1]
                message = scribe.make(
                    "sensor_msgs/msg/CompressedImage",
                    header=header,
                    format="jpeg" if is_jpg else "png",
                    data=np.frombuffer(bytes(data), np.uint8),
                )
                scribe.put(f"{topic}/compressed", frame.time_s, "sensor_msgs/msg/CompressedImage", message)
            else:
                message = scribe.make(
                    "sensor_msgs/msg/Image",
                    header=header,
                    height=picture.shape[0],
                    width=picture.shape[1],
                    encoding="bgr8" if picture.ndim == 3 else "mono8",
                    is_bigendian=0,
                    step=picture.strides[0],
                    data=np.ascontiguousarray(picture).ravel(),
                )
                scribe.put(topic, frame.time_s, "sensor_msgs/msg/Image", message)


def _write_sensors(scribe: _Scribe, drive: Drive, origin: Geodetic | None) -> None:
    if drive.gnss is not None:
        _write_fixes(scribe, drive, origin)
    if drive.odometry is not None:
        for time_s, speed, rate in zip(
            drive.odometry.time_s, drive.odometry.speed_mps, drive.odometry.yaw_rate_radps, strict=True
        ):
            twist = scribe.make(
                "geometry_msgs/msg/Twist",
                linear=scribe.vector("Vector3", (speed, 0.0, 0.0)),
                angular=scribe.vector("Vector3", (0.0, 0.0, rate)),
            )
            kind = "geometry_msgs/msg/TwistStamped"
            scribe.put("/odom", time_s, kind, scribe.make(kind, header=scribe.header(time_s, BASE), twist=twist))
    if drive.imu is not None:
        for time_s, gyro, accel in zip(drive.imu.time_s, drive.imu.gyro_radps, drive.imu.accel_mps2, strict=True):
            scribe.put("/imu", time_s, "sensor_msgs/msg/Imu", _imu(scribe, time_s, gyro, accel))
    if drive.truth is not None:
        for time_s, T in zip(drive.truth.time_s, drive.truth.T_map_base, strict=True):
            link = scribe.transform(time_s, "map", BASE, T)
            scribe.put("/tf", time_s, TRANSFORMS, scribe.make(TRANSFORMS, transforms=[link]))


def _write_fixes(scribe: _Scribe, drive: Drive, origin: Geodetic | None) -> None:
    place = drive.gnss.origin or origin
    if place is None:
        raise SemlocError("bag: the fixes are in the frame of a map; give the origin of the map on the earth")
    lat, lon, alt = wgs84_from_enu(drive.gnss.p_enu, tuple(place))
    status = scribe.make("sensor_msgs/msg/NavSatStatus", status=0, service=1)
    for index, time_s in enumerate(drive.gnss.time_s):
        message = scribe.make(
            "sensor_msgs/msg/NavSatFix",
            header=scribe.header(time_s, BASE),
            status=status,
            latitude=float(lat[index]),
            longitude=float(lon[index]),
            altitude=float(alt[index]),
            position_covariance=np.diag(drive.gnss.sigma_m[index] ** 2).ravel(),
            position_covariance_type=2,
        )
        scribe.put("/gnss/fix", time_s, "sensor_msgs/msg/NavSatFix", message)


def _imu(scribe: _Scribe, time_s: float, gyro: np.ndarray, accel: np.ndarray) -> Any:
    identity = scribe.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    unknown = np.zeros(9)
    unknown[0] = -1.0  # as REP-145 says: no orientation is measured
    return scribe.make(
        "sensor_msgs/msg/Imu",
        header=scribe.header(time_s, BASE),
        orientation=identity,
        orientation_covariance=unknown,
        angular_velocity=scribe.vector("Vector3", gyro),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=scribe.vector("Vector3", accel),
        linear_acceleration_covariance=np.zeros(9),
    )


def _optical(camera: str) -> str:
    return f"{camera}_optical_frame"
