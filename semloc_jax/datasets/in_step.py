"""Pictures of several cameras brought together to frames (room: datasets; host).

In: streams of pictures with their own times, a rig, the motion of the vehicle. Out: frames with one time each.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import equinox as eqx
import numpy as np
from jaxtyping import Float

from semloc_jax.cameras import Camera, Rig
from semloc_jax.datasets.base import IMAGE, Frame
from semloc_jax.datasets.pictures import StoredPicture, read_picture
from semloc_jax.datasets.sensors import WheelOdometry
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory

_LOG = logging.getLogger(__name__)
_SAME_TIME_S = 1e-3
_MIN_SHARE = 0.5
"""A camera that has a picture for fewer frames than this share is left out."""
_MAX_WAIT_S = 0.1
"""Pictures farther apart in time never belong to one frame, however slow the cameras are; our choice."""


@dataclass(frozen=True)
class PictureStream:
    """Pictures of one kind and camera in time order.

    Args:
        time_s: times of exposure [s].
        pictures: one for each time.
        ids: names of the frames, empty for their numbers.
    """

    time_s: Float[np.ndarray, " n"]
    pictures: tuple[Path | StoredPicture, ...]
    ids: tuple[str, ...] = ()

    def in_time_order(self) -> "PictureStream":
        """The stream sorted by time, the first of pictures of one time kept."""
        _, order = np.unique(self.time_s, return_index=True)
        ids = tuple(self.ids[i] for i in order) if self.ids else ()
        return PictureStream(self.time_s[order], tuple(self.pictures[i] for i in order), ids)


def frames_in_step(
    streams: Mapping[str, Mapping[str, PictureStream]],
    rig: Rig,
    odometry: WheelOdometry | None,
    where: str,
    variant: str = "",
) -> tuple[Rig, tuple[Frame, ...]]:
    """The rig of the cameras in step and one frame for each picture of the first of them.

    A frame takes from every other camera the picture nearest in time, within half a period. Where cameras trigger at
    different times and odometry is there, the extrinsics of the frame hold the motion in between.

    Args:
        streams: by kind (`rgb`, names of masks) and camera.
        rig: cameras, the first one gives the times.
        odometry: motion of the vehicle.
        where: what they belong to, for messages.
        variant: of every frame.

    Raises:
        SemlocError: there are no pictures, or their size is not that of the calibration.
    """
    leading = streams.get(IMAGE) or next(iter(streams.values()), {})
    names = [name for name in rig.names if name in leading and len(leading[name].time_s)]
    if not names:
        raise SemlocError(
            f"{where}: no pictures of the calibrated cameras {', '.join(rig.names)}; there are pictures of "
            f"{', '.join(leading) or 'none'}; name the cameras of the calibration like those of the recording"
        )
    ordered = {kind: {name: s.in_time_order() for name, s in by.items()} for kind, by in streams.items()}
    first = ordered[IMAGE if IMAGE in streams else next(iter(ordered))][names[0]]
    reach_s = _reach_s(first.time_s)
    by_kind = {kind: _partners(by, names, first.time_s, reach_s) for kind, by in ordered.items()}
    names = _in_step(names, by_kind.get(IMAGE) or next(iter(by_kind.values())), where)
    if not names:
        raise SemlocError(f"{where}: no camera has both pictures and times; check that the list of times is complete")
    rig = _sized(rig.select(names), ordered, where)
    frames = []
    for index, time_s in enumerate(first.time_s.tolist()):
        complete = _complete_kinds(ordered, by_kind, names, index)
        if (IMAGE in by_kind and IMAGE not in complete) or not complete:
            continue
        files = {kind: {name: s.pictures[at] for name, (s, at) in by.items()} for kind, by in complete.items()}
        offsets = [s.time_s[at] - time_s for s, at in next(iter(complete.values())).values()]
        frame_id = first.ids[index] if first.ids else f"{index:06d}"
        frames.append(Frame(len(frames), frame_id, time_s, variant, _moved(rig, time_s, offsets, odometry), files))
    if (num_left_out := len(first.time_s) - len(frames)) > 0:
        _LOG.warning("%s: %d of %d frames lack a camera; left out", where, num_left_out, len(first.time_s))
    if not frames:
        raise SemlocError(
            f"{where}: no frame has pictures of all of {', '.join(names)}; check the times of the cameras"
        )
    return rig, tuple(frames)


def _complete_kinds(
    streams: Mapping[str, Mapping[str, PictureStream]],
    partners: Mapping[str, Mapping[str, np.ndarray]],
    names: Sequence[str],
    index: int,
) -> dict[str, dict[str, tuple[PictureStream, int]]]:
    """Stream and row of the picture of a frame, by kind and camera; only kinds with a picture of every camera."""
    found = {
        kind: {name: (streams[kind][name], int(by[name][index])) for name in names if name in by}
        for kind, by in partners.items()
    }
    return {k: by for k, by in found.items() if len(by) == len(names) and all(at >= 0 for _, at in by.values())}


def fitted(camera: Camera, size_px: tuple[int, int], where: str) -> Camera:
    """The camera for pictures of another size of the same shape; a warning says so.

    Raises:
        SemlocError: the pictures have another shape than the calibration.
    """
    if size_px == camera.resolution:
        return camera
    width, height = camera.resolution
    if abs(size_px[0] * height - size_px[1] * width) > 0.01 * size_px[0] * height:
        raise SemlocError(
            f"{where}: pictures are {size_px[0]}x{size_px[1]} px, the calibration is for {width}x{height} px, another "
            "shape; expected the calibration of these pictures (are they cropped?)"
        )
    _LOG.warning(
        "%s: pictures are %dx%d px, the calibration is for %dx%d px; it is scaled", where, *size_px, width, height
    )
    return camera.resized(*size_px)


def odometry_from_poses(poses: Trajectory) -> WheelOdometry | None:
    """Speed and yaw rate between poses, as wheels would measure them; None for fewer than two poses."""
    if len(poses) < 2:
        return None
    T = poses.T_map_base
    step_s = np.diff(poses.time_s)
    turned = np.einsum("nji,njk->nik", T[:-1, :3, :3], T[1:, :3, :3])
    yaw = np.arctan2(turned[:, 1, 0], turned[:, 0, 0])
    moved = np.einsum("nji,nj->ni", T[:-1, :3, :3], np.diff(T[:, :3, 3], axis=0))
    # The chord points half the turn to the side of where the vehicle looked first, and is shorter than the arc.
    chord = moved[:, 0] * np.cos(0.5 * yaw) + moved[:, 1] * np.sin(0.5 * yaw)
    speed = chord / np.sinc(yaw / (2.0 * np.pi)) / step_s
    middle_s = 0.5 * (poses.time_s[1:] + poses.time_s[:-1])
    return WheelOdometry(
        poses.time_s,
        np.interp(poses.time_s, middle_s, speed),
        np.interp(poses.time_s, middle_s, yaw / step_s),
    )


def _reach_s(time_s: np.ndarray) -> float:
    return min(0.5 * float(np.median(np.diff(time_s))), _MAX_WAIT_S) if len(time_s) > 1 else _MAX_WAIT_S


def _partners(
    streams: Mapping[str, PictureStream], names: list[str], time_s: np.ndarray, reach_s: float
) -> dict[str, np.ndarray]:
    """For each camera and time the picture nearest in time, -1 where none is within reach."""
    found = {}
    for name in names:
        if name not in streams or not len(streams[name].time_s):
            continue
        theirs = streams[name].time_s
        right = np.clip(np.searchsorted(theirs, time_s), 0, len(theirs) - 1)
        left = np.maximum(right - 1, 0)
        nearest = np.where(np.abs(theirs[left] - time_s) < np.abs(theirs[right] - time_s), left, right)
        found[name] = np.where(np.abs(theirs[nearest] - time_s) <= reach_s, nearest, -1)
    return found


def _in_step(names: list[str], partners: Mapping[str, np.ndarray], where: str) -> list[str]:
    kept = [name for name in names if name in partners and np.mean(partners[name] >= 0) >= _MIN_SHARE]
    for name in sorted(set(names) - set(kept)):
        _LOG.warning(
            "%s: camera %s has pictures at fewer than half of the times of %s; left out", where, name, names[0]
        )
    return kept


def _sized(rig: Rig, streams: Mapping[str, Mapping[str, PictureStream]], where: str) -> Rig:
    """The rig with every camera as large as its images."""
    if IMAGE not in streams:
        return rig
    cameras = []
    for name, camera in zip(rig.names, rig.cameras, strict=True):
        height, width = read_picture(streams[IMAGE][name].pictures[0]).shape[:2]
        cameras.append(fitted(camera, (width, height), f"{where}: {name}"))
    return eqx.tree_at(lambda r: r.cameras, rig, tuple(cameras))


def _moved(rig: Rig, time_s: float, offsets_s: list[float], odometry: WheelOdometry | None) -> Rig:
    if odometry is None or np.abs(offsets_s).max() < _SAME_TIME_S:
        return rig
    T_base_cam = [
        odometry.relative_motion(time_s, time_s + offset) @ T
        for offset, T in zip(offsets_s, np.asarray(rig.T_base_cam), strict=True)
    ]
    return Rig(rig.cameras, np.stack(T_base_cam), rig.names)
