"""PandaSet sequences (room: datasets; host).

In: camera/NAME/{NN.jpg, poses.json, intrinsics.json, timestamps.json}, meta/, annotations/cuboids/,
semantic_points_per_sweep.npz and, where made, masks_twinlite_front/NN.png. Out: PandaSetDrive.

The data set has no vehicle frame: here `base` is on the road, 1.7 m behind the front camera, z along the normal of the
road, x along the direction of travel, all fixed relative to the front camera. Cameras trigger one after the other, up
to 50 ms apart; `Drive.rig` holds their constant places and `Frame.rig` the places with the motion in between.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.datasets.base import IMAGE, Drive, Frame
from semloc_jax.datasets.pandaset.cuboids import draw_cuboids, read_cuboids
from semloc_jax.datasets.sensors import GnssTrack, WheelOdometry
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory
from semloc_jax.geometry.geodesy import enu_from_wgs84
from semloc_jax.geometry.plane import fit_plane
from semloc_jax.geometry.rigid import pose_from
from semloc_jax.maps import GeoOrigin
from semloc_jax.storage import FARTHEST_M, npz_arrays

FRONT = "front_camera"
CAMERAS = (FRONT, "front_left_camera", "front_right_camera", "left_camera", "right_camera", "back_camera")
ROAD, LANE_LINE, OTHER_MARK, SIGN = 7, 8, 10, 36
"""Classes of the labelled points."""
MASKS, MASK_TABLE = "masks_twinlite_front", "twinlite"
"""Folder of masks of the front camera, and the class table of the network that made them."""
FRONT_CAMERA_X_M = 1.7
"""Front camera ahead of the rear axle; our choice, the data set does not state it."""
_GNSS_SIGMA_M = 0.5
_MOVING_M = 0.15
_VELOCITY_SIGMA_MPS = 0.1
"""Of a component of the satellite velocity, ten a second, were they independent: 0.02 m/s that stays the same for
seconds, so that slopes of the course feel it as six times as much. The course's is this through the speed."""
_COURSE_HALF_S = 0.5
"""Course differences of neighbours, 0.1 s apart, are noise of some degrees per second; our choice."""
_ROAD_UNDER_M = (2.0, 4.0, 12.0)
"""Reach to the right, down and ahead of the front camera in which the road is taken as flat: the width of the car."""


@dataclass(frozen=True)
class LabelledPoints:
    """Lidar points with classes, in the map frame.

    Args:
        p_map: positions [m].
        intensity: reflectance, on a scale of its own for each sensor.
        sensor: 0 turning lidar, 1 forward lidar.
        class_id: class.
        sweep: frame index.
    """

    p_map: Float[np.ndarray, "n 3"]
    intensity: Float[np.ndarray, " n"]
    sensor: np.ndarray
    class_id: np.ndarray
    sweep: np.ndarray

    def seen(self, class_id: int, sweeps: slice = slice(None)) -> "LabelledPoints":
        """What the given sweeps saw of a class."""
        wanted = np.arange(int(self.sweep.max()) + 1)[sweeps]
        rows = (self.class_id == class_id) & np.isin(self.sweep, wanted)
        columns = (self.p_map, self.intensity, self.sensor, self.class_id, self.sweep)
        return LabelledPoints(*(column[rows] for column in columns))

    def of(self, class_id: int, sweeps: slice = slice(None)) -> Float[np.ndarray, "m 3"]:
        """Points of a class seen in the given sweeps."""
        return self.seen(class_id, sweeps).p_map


@dataclass(frozen=True)
class PandaSetDrive(Drive):
    """A PandaSet drive with its labelled points; the map is made by `build_map`.

    Args:
        points: labelled lidar points.
        origin: place of the map frame on the earth.
    """

    points: LabelledPoints = field(default=None, repr=False)
    origin: GeoOrigin | None = None


def is_pandaset(path: Path) -> bool:
    """Whether a folder is a PandaSet sequence."""
    return (path / "camera" / FRONT / "poses.json").is_file()


def read_pandaset(path: str | Path, front_correction: Float[np.ndarray, "4 4"] | None = None) -> PandaSetDrive:
    """A PandaSet sequence.

    Args:
        path: folder of the sequence.
        front_correction: pose of the true front camera in the published one; see `build.calibrated`.

    Raises:
        SemlocError: a file is missing or is not what PandaSet writes.
    """
    path = Path(path)
    if not is_pandaset(path):
        raise SemlocError(f"PandaSet {path}: no camera/{FRONT}/poses.json; expected the folder of one sequence")
    names = [name for name in CAMERAS if (path / "camera" / name / "poses.json").is_file()]
    poses = {name: _camera_poses(path / "camera" / name) for name in names}
    points = _labelled_points(path / "semantic_points_per_sweep.npz")
    front = poses[FRONT]
    T_front_base = _base_in_front_camera(front, points)
    truth = Trajectory(front.time_s, front.T_map_base @ T_front_base)
    T_base_cam = np.stack([_constant_extrinsics(truth, poses[name]) for name in names])
    if front_correction is not None:
        T_base_cam[names.index(FRONT)] = T_base_cam[names.index(FRONT)] @ front_correction
    rig = Rig([_camera(path / "camera" / name) for name in names], T_base_cam, names)
    origin, gnss, odometry = _gnss(path, truth)
    return PandaSetDrive(
        name=path.resolve().name,
        path=path,
        frames=_frames(path, rig, poses, truth),
        rig=rig,
        table_name=MASK_TABLE if (path / MASKS).is_dir() else "",
        mask_sources=(MASKS,) if (path / MASKS).is_dir() else (),
        truth=truth,
        gnss=gnss,
        odometry=odometry,
        points=points,
        origin=origin,
    )


def _frames(path: Path, rig: Rig, poses: dict[str, Trajectory], truth: Trajectory) -> tuple[Frame, ...]:
    frames = []
    for index, time_s in enumerate(truth.time_s.tolist()):
        name = f"{index:02d}"
        offsets = {camera: poses[camera].time_s[index] - time_s for camera in rig.names}
        moved = np.stack([_motion(truth, time_s, offsets[camera]) for camera in rig.names])
        frame_rig = Rig(rig.cameras, moved @ np.asarray(rig.T_base_cam), rig.names)
        files = {IMAGE: {camera: path / "camera" / camera / f"{name}.jpg" for camera in rig.names}}
        if (path / MASKS).is_dir():
            files[MASKS] = {FRONT: path / MASKS / f"{name}.png"}
        frame = Frame(index, name, time_s, "day", frame_rig, files)
        cuboids = path / "annotations" / "cuboids" / f"{name}.pkl.gz"
        if cuboids.is_file():
            frame = replace(frame, draw_dynamic=_drawing(cuboids, frame_rig, truth.T_map_base[index]))
        frames.append(frame)
    return tuple(frames)


def _drawing(cuboids: Path, rig: Rig, T_map_base: np.ndarray) -> Callable[[str], np.ndarray]:
    def draw(camera: str) -> np.ndarray:
        index = rig.index(camera)
        T_cam_map = np.linalg.inv(T_map_base @ np.asarray(rig.T_base_cam)[index])
        return draw_cuboids(read_cuboids(cuboids).movable(), rig.cameras[index], T_cam_map)

    return draw


def _motion(truth: Trajectory, time_s: float, offset_s: float) -> np.ndarray:
    """T_base(time)_base(time + offset); beyond the ends of the log the motion continues unchanged."""
    if not truth.time_s[0] <= time_s + offset_s <= truth.time_s[-1]:
        return np.linalg.inv(_motion(truth, time_s, -offset_s))
    start, end = truth.interpolate(np.array([time_s, time_s + offset_s]))
    return np.linalg.inv(start) @ end


def _constant_extrinsics(truth: Trajectory, camera: Trajectory) -> np.ndarray:
    """T_base_cam as the mean over all frames, each at the time of that camera's own trigger."""
    inside = (camera.time_s >= truth.time_s[0]) & (camera.time_s <= truth.time_s[-1])
    T = np.linalg.inv(truth.interpolate(camera.time_s[inside])) @ camera.T_map_base[inside]
    return pose_from(Rotation.from_matrix(T[:, :3, :3]).mean().as_matrix(), np.median(T[:, :3, 3], axis=0))


def _base_in_front_camera(front: Trajectory, points: LabelledPoints) -> np.ndarray:
    """T_front_base from the road under the vehicle and the direction in which it drives."""
    road = points.p_map[np.isin(points.class_id, (ROAD, LANE_LINE))]
    normals, heights = [], []
    for T in front.T_map_base[::4]:
        near = np.abs((road - T[:3, 3]) @ T[:3, :3]) < _ROAD_UNDER_M
        plane = fit_plane(road[near.all(axis=1)])
        normals.append(T[:3, :3].T @ plane.normal)
        heights.append((T[:3, 3] - plane.point) @ plane.normal)
    up, height = np.median(normals, axis=0), float(np.median(heights))
    up /= np.linalg.norm(up)
    steps = np.einsum("nji,nj->ni", front.T_map_base[:-1, :3, :3], np.diff(front.T_map_base[:, :3, 3], axis=0))
    length = np.linalg.norm(steps, axis=1)
    moving = length > _MOVING_M
    forward = np.median(steps[moving] / length[moving, None], axis=0) if moving.any() else np.array([0.0, 0.0, 1.0])
    forward -= (forward @ up) * up
    forward /= np.linalg.norm(forward)
    return pose_from(np.stack([forward, np.cross(up, forward), up], axis=1), -height * up - FRONT_CAMERA_X_M * forward)


def _camera_poses(folder: Path) -> Trajectory:
    """Poses of a camera, camera to map."""
    rows, time_s = _json(folder / "poses.json"), _json(folder / "timestamps.json")
    T = pose_from(
        Rotation.from_quat([[row["heading"][key] for key in "xyzw"] for row in rows]).as_matrix(),
        [[row["position"][key] for key in "xyz"] for row in rows],
    )
    return Trajectory(np.array(time_s, dtype=np.float64), T)


def _camera(folder: Path) -> PinholeCamera:
    k = _json(folder / "intrinsics.json")
    # Front images are 1920x1080; the copies of the others are halved together with their intrinsics.
    width, height = (1920, 1080) if k["fx"] > 1000.0 or k["cx"] > 700.0 else (960, 540)
    return PinholeCamera(k["fx"], k["fy"], k["cx"], k["cy"], width, height)


def _labelled_points(path: Path) -> LabelledPoints:
    if not path.is_file():
        raise SemlocError(
            f"PandaSet {path}: no such file; expected labelled points [x y z intensity sensor class sweep]"
        )
    data = npz_arrays(path, f"PandaSet {path}")["data"]
    if data.ndim != 2 or data.shape[1] != 7 or not (np.abs(data) < FARTHEST_M).all():
        raise SemlocError(
            f"PandaSet {path}: an array {data.shape}, or numbers that are NaN, infinite or beyond the earth; expected "
            "labelled points [x y z intensity sensor class sweep]; get the file again"
        )
    integers = data[:, 4:].astype(np.int64)
    return LabelledPoints(data[:, :3].astype(np.float64), data[:, 3].astype(np.float64), *integers.T)


def _gnss(path: Path, truth: Trajectory) -> tuple[GeoOrigin | None, GnssTrack | None, WheelOdometry | None]:
    """Fixes registered to the map frame at the first of them, and the speed and course rate of their velocity."""
    if not (path / "meta" / "gps.json").is_file():
        return None, None, None
    rows = _json(path / "meta" / "gps.json")
    time_s = np.array(_json(path / "meta" / "timestamps.json"), dtype=np.float64)
    place = np.array([[row["lat"], row["long"], row["height"]] for row in rows])
    enu = enu_from_wgs84(*place.T, tuple(place[0]))
    p_enu = enu + truth.T_map_base[0, :3, 3]
    velocity = np.array([[row["xvel"], row["yvel"]] for row in rows])
    speed = np.linalg.norm(velocity, axis=1)
    origin = GeoOrigin(*place[0])
    gnss = GnssTrack(time_s, p_enu, np.full(p_enu.shape, _GNSS_SIGMA_M))
    return origin, gnss, WheelOdometry(time_s, speed, _course_rate(time_s, velocity))


def _course_rate(time_s: np.ndarray, velocity: Float[np.ndarray, "n 2"]) -> np.ndarray:
    """Rate of the direction of travel [rad/s]: slope of the course over `_COURSE_HALF_S` to both sides.

    The course of a slow vehicle is noise, as 1 / speed: every sample counts by its squared speed. Of a slope no more is
    believed than exceeds its own noise (James and Stein), so a vehicle that stands or starts does not turn.
    """
    course = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))
    moving = np.sum(velocity**2, axis=1)
    rate = np.zeros(len(time_s))
    for k, now_s in enumerate(time_s):
        weight = moving * (np.abs(time_s - now_s) <= _COURSE_HALF_S)
        total = weight.sum()
        if total <= 0.0:
            continue
        lag = time_s - weight @ time_s / total
        spread = weight @ lag**2
        slope = weight @ (lag * course) / spread if spread > 0.0 else 0.0
        if spread * slope**2 > _VELOCITY_SIGMA_MPS**2:
            rate[k] = slope - _VELOCITY_SIGMA_MPS**2 / (spread * slope)
    return rate


def _json(path: Path) -> list | dict:
    if not path.is_file():
        raise SemlocError(f"PandaSet {path}: no such file; expected a complete sequence folder")
    return json.loads(path.read_text())
