"""Whether calibration and map fit what the drive shows: one fault at a time, over the last frames (room: localization;
host).

In: how much better a frame fits with another calibration, what lines and posts say alone. Out: WatchState; Suspicion: a
fault that the drive speaks for, its size, and how far the pose would move.
A fault of calibration or map hides in each single pose. A frame that is solved again with a lens a little longer or
shorter says by the difference which one is right, and where the vehicle then is; lines and posts that are held against
the masks each alone say whether they belong to one state of the road. What single frames say is summed up.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from semloc_jax.cameras import Rig

FOCAL = "focal"
_TURNS = ("pitch", "yaw")
CLASSES = ("lines_left", "lines_ahead", "posts_left", "posts_ahead")
"""Suspicions that are no calibration: what lies or what stands fits better elsewhere."""
_PLANE = [0, 1, 5]
"""Forward, left and heading in a tangent."""


@dataclass(frozen=True)
class WatchConfig:
    """What is watched, and from when on it counts. All values are ours."""

    level: ClassVar[int] = 1
    """Of the cost maps, on which lines and posts are compared: a repainted line lies tens of pixels aside."""
    aside_m: ClassVar[tuple[float, float]] = (1.5, 0.1)
    """How far aside lines and posts are compared, and in what steps."""
    ahead_m: ClassVar[tuple[float, float]] = (4.5, 0.25)
    focal_share: ClassVar[float] = 0.025
    """By how much the focal lengths of the other calibration differ: less is told by its own slope."""
    turn_rad: ClassVar[float] = 0.015
    step_m: float = 0.5
    """Way between two frames that are looked at: from one place the same errors are seen again."""
    memory_frames: float = 40.0
    share: float = 0.3
    """Share of what a frame says that is new: successive frames see the same map."""
    aside_sigma_rad: float = 0.02
    """How far aside cameras may look, before the drive says more [rad]."""
    least_levels: tuple[float, float, float] = (0.15, 0.25, 0.3)
    """No protection level is smaller: lateral [m], longitudinal [m], heading [deg]. Maps are surveyed and cameras are
    mounted to centimetres and tenths of a degree, and a fault of that size shows in nothing."""
    aside_m_memory: float = 20.0
    """Way over which a direction of travel is remembered: where the cameras look aside, the first lines and walls that
    come into view or leave it move the pose, which passes for a drive to the other side."""
    aside_rad: tuple[float, float] = (0.0055, 0.0063)
    """A direction of travel up to the first is that of a sound vehicle, whose axle and inertial unit are never mounted
    exactly along each other (a real one: 0.27 deg); from the second on it counts in full [rad]."""
    least_gain_nats: float = 2.0
    """What a frame must gain at least: less is left by masks and maps that are not perfect, in every frame anew."""
    count_nats: float = 3.0
    """A fault that so much speaks for joins the protection levels: less is what chance does among a dozen faults."""


class WatchState(NamedTuple):
    """Sums over frames; flat, as the number of calibrations is that of the cameras."""

    num: Float[np.ndarray, " a"] = np.zeros(0)
    """Frames that were solved again with each of the other calibrations."""
    gain: Float[np.ndarray, " a"] = np.zeros(0)
    """By how much they fitted better [nats]."""
    moved: Float[np.ndarray, " three_a"] = np.zeros(0)
    """How far their poses moved: forward [m], left [m], heading [rad]."""
    profiles: Float[np.ndarray, " two_n"] = np.zeros(0)
    """Costs of lines and of posts over the moves [nats]."""
    aside_rad: Float[np.ndarray, ""] = np.float64(0.0)
    """Largest direction of travel that the drive alone gave of late."""
    num_looks: Float[np.ndarray, ""] = np.float64(0.0)
    """Frames that the profiles were summed over."""
    num_frames: Int[np.ndarray, ""] = np.int64(0)
    way_m: Float[np.ndarray, ""] = np.float64(0.0)
    """Since the last frame that was looked at."""


class Suspicion(NamedTuple):
    """A fault that the drive speaks for."""

    name: str
    size: float
    nats: float
    """By how much the drive is better explained with it."""
    moved: Float[np.ndarray, "3"]
    """How far the pose would be off: forward [m], left [m], heading [rad]."""


def alternatives(num_cameras: int) -> tuple[str, ...]:
    """What is changed in the other calibrations, each a little up and a little down."""
    turns = [f"{turn} {k}" for k in range(num_cameras) for turn in _TURNS] if num_cameras > 1 else []
    return (FOCAL, *turns)


def next_rig(watch: WatchState, rig: Rig, config: WatchConfig) -> Rig:
    """The calibration that the next frame is solved with again."""
    names = alternatives(len(rig.names))
    at = int(watch.num_frames) % (2 * len(names))
    sign = 1.0 if at % 2 == 0 else -1.0
    if names[at // 2] == FOCAL:
        factor = 1.0 + sign * config.focal_share
        cameras = tuple(eqx.tree_at(lambda c: (c.fx, c.fy), c, (factor * c.fx, factor * c.fy)) for c in rig.cameras)
        return Rig(cameras, rig.T_base_cam, rig.names)
    turn, index = names[at // 2].split()
    T_base_cam = np.array(rig.T_base_cam, dtype=np.float64)
    T_base_cam[int(index), :3, :3] = _about(turn, sign * config.turn_rad) @ T_base_cam[int(index), :3, :3]
    return Rig(rig.cameras, T_base_cam, rig.names)


def _about(turn: str, angle_rad: float) -> np.ndarray:
    """Rotation about the left (pitch) or the upward (yaw) axis of the vehicle."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    if turn == "pitch":
        return np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def moves(config: WatchConfig) -> Float[np.ndarray, "n 3"]:
    """Where lines and posts are compared: aside first, then ahead; forward [m], left [m], turned [rad]."""
    aside, ahead = _places(config.aside_m), _places(config.ahead_m)
    found = np.zeros((len(aside) + len(ahead), 3))
    found[: len(aside), 1], found[len(aside) :, 0] = aside, ahead
    return found


def _places(reach: tuple[float, float]) -> np.ndarray:
    num = round(reach[0] / reach[1])
    return reach[1] * np.arange(-num, num + 1)


def learned(
    watch: WatchState,
    num_cameras: int,
    aside_rad: float,
    gain_nats: float,
    moved: Float[np.ndarray, "6"],
    profiles: Float[np.ndarray, "2 n"],
    config: WatchConfig,
) -> WatchState:
    """The sums after one more frame.

    Args:
        watch: Before.
        num_cameras: Of the rig.
        aside_rad: Direction of travel to be remembered.
        gain_nats: By how much the frame fits better with `next_rig`.
        moved: How far its pose moved (right tangent).
        profiles: Costs of lines and of posts at `moves`.
        config: Memory.
    """
    size = 2 * len(alternatives(num_cameras))
    if watch.num.shape != (size,):
        zeros = (np.zeros(size), np.zeros(size), np.zeros(3 * size), np.zeros(profiles.size))
        watch = WatchState(*zeros, num_frames=watch.num_frames)
    keep = np.exp(-1.0 / config.memory_frames)
    new = (np.arange(size) == int(watch.num_frames) % size) & np.isfinite(gain_nats + np.sum(moved))
    usable = np.isfinite(profiles).all()
    return WatchState(
        keep * watch.num + new,
        keep * watch.gain + np.where(new, np.nan_to_num(gain_nats), 0.0),
        keep * watch.moved + (new[:, None] * np.nan_to_num(moved[_PLANE])).ravel(),
        keep * watch.profiles + (np.asarray(profiles, np.float64).ravel() if usable else 0.0),
        np.float64(aside_rad),
        np.float64(keep * watch.num_looks + usable),
        np.int64(watch.num_frames + 1),
        np.float64(0.0),
    )


def suspicions(watch: WatchState, num_cameras: int, config: WatchConfig) -> list[Suspicion]:
    """Every fault that the drive speaks for, the clearest first."""
    if not len(watch.num):
        return []
    found = [*_calibrations(watch, num_cameras, config), *_classes_apart(watch, config)]
    return sorted(found, key=lambda s: -s.nats)


def _calibrations(watch: WatchState, num_cameras: int, config: WatchConfig) -> list[Suspicion]:
    """Where a parabola through the costs of the calibration and of the two beside it has its minimum."""
    found = []
    for k, name in enumerate(alternatives(num_cameras)):
        num = watch.num[2 * k : 2 * k + 2]
        if (num < 0.5).any():
            continue
        up, down = -watch.gain[2 * k : 2 * k + 2] / num
        step_up, step_down = watch.moved.reshape(-1, 3)[2 * k : 2 * k + 2] / num[:, None]
        slope, bend = 0.5 * (up - down), 0.5 * (up + down)
        # Beyond the neighbours nothing was looked at, but a fault may be larger.
        at = float(np.clip(-0.5 * slope / bend, -2.0, 2.0)) if bend > 0.0 else -2.0 * float(np.sign(slope))
        better = -(slope * at + bend * at**2) if bend > 0.0 else max(-up, -down)
        # Both neighbours say it, as often as they were asked.
        nats = config.share * float(num.sum()) * max(better - config.least_gain_nats, 0.0)
        unit = config.focal_share if name == FOCAL else config.turn_rad
        found.append(Suspicion(name, at * unit, nats, at * 0.5 * (step_up - step_down)))
    return found


def _classes_apart(watch: WatchState, config: WatchConfig) -> list[Suspicion]:
    """Whether lines or posts, each alone, fit better beside the pose: they then do not belong to one map."""
    table, num_aside, found = moves(config), len(_places(config.aside_m)), []
    for group, costs in zip(("lines", "posts"), watch.profiles.reshape(2, -1), strict=True):
        for axis, word, step_m in ((1, "left", config.aside_m[1]), (0, "ahead", config.ahead_m[1])):
            of_axis = slice(num_aside) if axis == 1 else slice(num_aside, None)
            places, cost = table[of_axis, axis], costs[of_axis]
            is_here = np.abs(places) <= 1.5 * step_m
            best = int(np.argmin(np.where(is_here, np.inf, cost)))
            moved = np.zeros(3)
            moved[axis] = places[best]
            better = float(np.min(cost[is_here]) - cost[best]) - config.least_gain_nats * float(watch.num_looks)
            nats = config.share * max(better, 0.0)
            found.append(Suspicion(f"{group}_{word}", float(places[best]), nats, moved))
    return found
