"""Bags to sequences (room: datasets; host).

In: a ROS 1 .bag, a ROS 2 bag folder, .db3 or .mcap; images raw and compressed, CameraInfo, NavSatFix, Imu, Odometry,
TwistStamped, tf. Out: Drive, whose pictures are read from the bag on first use.
"""

import logging
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from semloc_jax.cameras import Rig
from semloc_jax.cameras.io import read_calibration
from semloc_jax.datasets.bags import logs
from semloc_jax.datasets.bags.frames import BASE_FRAMES, MAP_FRAMES, FrameTree, clean
from semloc_jax.datasets.bags.images import COMPRESSED, RAW, BagPicture
from semloc_jax.datasets.bags.store import BagStore
from semloc_jax.datasets.bags.topics import CameraTopics, camera_topics
from semloc_jax.datasets.base import IMAGE, Drive
from semloc_jax.datasets.beside import calibration_beside, maps_beside
from semloc_jax.datasets.in_step import PictureStream, frames_in_step
from semloc_jax.datasets.sensors import WheelOdometry
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory

_LOG = logging.getLogger(__name__)
INFO, FIX, IMU = "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/NavSatFix", "sensor_msgs/msg/Imu"
ODOMETRY, TWIST, TF = "nav_msgs/msg/Odometry", "geometry_msgs/msg/TwistStamped", "tf2_msgs/msg/TFMessage"
_TF_ROS1 = "tf/msg/tfMessage"
_SUFFIXES = (".bag", ".db3", ".mcap")


def is_bag(path: Path) -> bool:
    """Whether a path is a bag of ROS 1 or ROS 2."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() and any(f.suffix in _SUFFIXES[1:] for f in path.iterdir())
    return path.suffix in _SUFFIXES and path.is_file()


def read_bag(path: str | Path, calibration: str | Path | None = None, base_frame: str | None = None) -> Drive:
    """Drive of a bag.

    Cameras are named by the part of their namespace in which they differ; topics whose name says sem, seg, mask or
    label hold masks. The path of the base frame in the frame `map`, where tf tells it, is the truth.

    Args:
        path: .bag, .db3, .mcap or the folder of a ROS 2 bag.
        calibration: calibration file instead of CameraInfo and tf; a calib.yaml beside the bag is used where these are
            missing.
        base_frame: name of the vehicle frame (rear axle on the ground); None looks for base_link and its like.

    Raises:
        SemlocError: rosbags is not installed, the bag is damaged, or it lacks pictures or a calibration.
    """
    path = Path(path)
    store = BagStore(path)
    images = {topic: store.counts[topic] for topic in store.topics_of(RAW, COMPRESSED)}
    if not images:
        held = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(store.types.items())[:8]) or "nothing"
        raise SemlocError(f"bag {path}: no image topic; it holds {held}; expected sensor_msgs Image or CompressedImage")
    cameras = camera_topics(images, store.topics_of(INFO))
    streams, messages, tree = _read_once(store, cameras)
    base = base_frame or tree.first_of(BASE_FRAMES)
    rig = _rig(path, store, cameras, messages, tree, base, calibration)
    twist = _busiest(store, messages, (ODOMETRY, TWIST))
    odometry = None if twist is None else _odometry(messages[twist], tree, base, f"bag {path}: {twist}")
    fixes, inertial = _busiest(store, messages, (FIX,)), _busiest(store, messages, (IMU,))
    rig, frames = frames_in_step(streams, rig, odometry, f"bag {path}")
    return Drive(
        name=path.resolve().stem,
        path=path,
        frames=frames,
        rig=rig,
        mask_sources=tuple(kind for kind in streams if kind != IMAGE),
        maps=maps_beside(path),
        truth=_truth(tree, messages, store, base),
        gnss=logs.gnss_from_fixes(messages[fixes], _place(tree, base, messages[fixes])) if fixes else None,
        odometry=odometry,
        imu=logs.imu_from_messages(messages[inertial], _place(tree, base, messages[inertial])) if inertial else None,
    )


def _read_once(
    store: BagStore, cameras: Mapping[str, CameraTopics]
) -> tuple[dict[str, dict[str, PictureStream]], dict[str, logs.Messages], FrameTree]:
    """Pictures by kind and camera, small messages by topic, frames: one pass over the bag."""
    wanted = {c.image: (IMAGE, name) for name, c in cameras.items() if c.image}
    wanted |= {topic: (kind, name) for name, c in cameras.items() for kind, topic in c.masks.items()}
    small = store.topics_of(INFO, FIX, IMU, ODOMETRY, TWIST, TF, _TF_ROS1)
    stamps: dict[str, list[tuple[int, int]]] = defaultdict(list)
    messages: dict[str, logs.Messages] = defaultdict(list)
    tree = FrameTree()
    for topic, recorded_ns, raw in store.messages([*wanted, *small]):
        if topic in wanted:
            stamps[topic].append((store.stamp_ns(raw, recorded_ns), recorded_ns))
        elif store.types[topic] == INFO and messages[topic]:
            continue  # a camera does not change during a drive
        elif store.types[topic] in (TF, _TF_ROS1):
            for link in store.decoded(topic, raw).transforms:
                T, time_s = link.transform, _stamp_s(link, recorded_ns)
                tree.add(time_s, link.header.frame_id, link.child_frame_id, T.translation, T.rotation)
        else:
            message = store.decoded(topic, raw)
            messages[topic].append((_stamp_s(message, recorded_ns), message))
    streams: dict[str, dict[str, PictureStream]] = {}
    for topic, (kind, camera) in wanted.items():
        times = np.array([stamp for stamp, _ in stamps[topic]], dtype=np.int64)
        pictures = tuple(BagPicture(store, topic, recorded_ns) for _, recorded_ns in stamps[topic])
        streams.setdefault(kind, {})[camera] = PictureStream(_seconds(times), pictures)
    return streams, messages, tree


def _rig(
    path: Path,
    store: BagStore,
    cameras: Mapping[str, CameraTopics],
    messages: Mapping[str, logs.Messages],
    tree: FrameTree,
    base: str | None,
    calibration: str | Path | None,
) -> Rig:
    """The cameras with CameraInfo and a place on the vehicle; else those of a calibration file."""
    problems, models, poses = [], [], []
    given = calibration or None
    for name, topics in cameras.items() if given is None else ():
        info = messages[topics.info][0][1] if topics.info and messages.get(topics.info) else None
        if info is None:
            problems.append(f"camera {name} has no CameraInfo")
            continue
        T = _place(tree, base, [(0.0, info)])
        if T is None:
            problems.append(
                f"tf does not link '{clean(info.header.frame_id)}' of camera {name} with {base or 'a base'}"
            )
            continue
        models.append((name, logs.camera_of(info, topics.is_rectified, f"bag {path}: {topics.info}")))
        poses.append(T)
    if models:
        for problem in problems:
            _LOG.warning("bag %s: %s; it is left out", path, problem)
        return Rig([model for _, model in models], np.stack(poses), [name for name, _ in models])
    given = given or calibration_beside(path)
    if given is None:
        frames = ", ".join(tree.frames[:12]) or "none"
        raise SemlocError(
            f"bag {path}: no calibrated camera: {'; '.join(problems)} (frames of tf: {frames}); expected one of "
            f"{', '.join(BASE_FRAMES[:3])} in tf; or give --calib FILE, or put a calib.yaml beside the bag"
        )
    return read_calibration(given)


def _place(tree: FrameTree, base: str | None, messages: logs.Messages) -> np.ndarray | None:
    """T_base_sensor of the frame that the messages name; None where tf does not tell it."""
    frame = clean(messages[0][1].header.frame_id)
    return tree.constant(base, frame) if base is not None and frame in tree else (np.eye(4) if frame == base else None)


def _odometry(messages: logs.Messages, tree: FrameTree, base: str | None, where: str) -> WheelOdometry | None:
    first = messages[0][1]
    # The twist of an Odometry is in its child frame, that of a TwistStamped in the frame of its header.
    frame = clean(getattr(first, "child_frame_id", "") or first.header.frame_id)
    T = tree.constant(base, frame) if base is not None and frame in tree and base in tree else None
    return logs.odometry_from_twists(messages, T, where)


def _truth(
    tree: FrameTree, messages: Mapping[str, logs.Messages], store: BagStore, base: str | None
) -> Trajectory | None:
    """Path of the base in the map, from tf, else from an Odometry in the frame of the map."""
    parent = tree.first_of(MAP_FRAMES)
    if parent is not None and base is not None and (path := tree.path(parent, base)) is not None:
        return path
    found = FrameTree()
    for topic, kept in messages.items():
        if store.types[topic] != ODOMETRY or clean(kept[0][1].header.frame_id) not in MAP_FRAMES:
            continue
        parent, child = kept[0][1].header.frame_id, kept[0][1].child_frame_id
        for time_s, message in kept:
            found.add(time_s, parent, child, message.pose.pose.position, message.pose.pose.orientation)
        return found.path(clean(parent), clean(child))
    return None


def _busiest(store: BagStore, messages: Mapping[str, logs.Messages], types: tuple[str, ...]) -> str | None:
    """The topic with most messages of the first of the types that there is."""
    for kind in types:
        topics = [topic for topic in store.topics_of(kind) if messages.get(topic)]
        if topics:
            best = max(topics, key=lambda topic: store.counts[topic])
            if len(topics) > 1:
                _LOG.warning("bag %s: %s is used of %s", store.path, best, ", ".join(topics))
            return best
    return None


def _stamp_s(message: Any, recorded_ns: int) -> float:
    stamp = message.header.stamp
    stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
    return float(_seconds(np.array([stamp_ns if stamp_ns > 0 else recorded_ns], dtype=np.int64))[0])


def _seconds(stamp_ns: np.ndarray) -> np.ndarray:
    """Seconds of whole nanoseconds, good to 0.2 us."""
    return stamp_ns // 1_000_000_000 + (stamp_ns % 1_000_000_000) / 1e9
