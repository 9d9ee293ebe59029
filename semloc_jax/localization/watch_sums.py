"""Whether calibration and map fit what the drive shows: one fault at a time, over the last frames (room: localization;
host).

In: how much better a frame fits with another calibration or another width of the road, what lines and posts say alone.
Out: WatchState; Suspicion: a fault that the drive speaks for, its size, and how far the pose would move.
A fault of calibration or map hides in each single pose. A frame that is solved again with a lens a little longer or
shorter says by the difference which one is right, and where the vehicle then is; lines and posts that are held against
the masks each alone say whether they belong to one state of the road. What single frames say is summed up.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from semloc_jax.alignment.class_profiles import GROUPS
from semloc_jax.cameras import BrownConradyCamera, Camera, PinholeCamera, Rig
from semloc_jax.cameras.other_lenses import FOCAL_SHARE, longer
from semloc_jax.evaluation.mixture_bounds import LEAST_LEVELS
from semloc_jax.localization.lens_sign import SignState
from semloc_jax.localization.stance_sums import StanceState, height_m
from semloc_jax.runtime.same_object import once_for_each

FOCAL, RADIAL, WIDTH = "focal", "radial", "width"
_TURNS = ("pitch", "yaw")
ASIDE = "yaw all"
"""All cameras look aside alike: those at the front and at the rear then do not agree how far to the side the vehicle
stands."""
_SIDES = GROUPS[2:]
"""Of the way. A road that was made wider is told by them; along the road each holds too little alone."""
CLASSES = tuple(
    f"{group}_{axis}" for group in GROUPS for axis in ("left", "ahead") if axis == "left" or group not in _SIDES
)
"""Suspicions that are no calibration: elements of one kind, or of one side of the way, fit better elsewhere."""


@dataclass(frozen=True)
class WatchConfig:
    """What is watched, and from when on it counts. All values are ours."""

    level: ClassVar[int] = 1
    """Of the cost maps, on which lines and posts are compared: a repainted line lies tens of pixels aside."""
    aside_m: ClassVar[tuple[float, float]] = (1.5, 0.1)
    """How far aside lines and posts are compared, and in what steps."""
    ahead_m: ClassVar[tuple[float, float]] = (4.5, 0.25)
    radial_share: ClassVar[float] = 0.05
    """By how much a lens of another distortion is wider or narrower at the side of the image: as much as the distortion
    of usual lenses there."""
    width_m: ClassVar[float] = 0.2
    """By how much another road is wider or narrower than in the map."""
    turn_rad: ClassVar[float] = 0.015
    step_m: float = 0.5
    """Way between two frames that are looked at: from one place the same errors are seen again."""
    eager_looks: int = 12
    """So many frames at the start of a drive are asked for all that may be wrong with lenses, width and the yaw of all
    cameras: what is wrong is wrong from the first frame on."""
    memory_frames: float = 40.0
    share: float = 0.3
    """Share of what a frame says that is new: successive frames see the same map."""
    least_levels: tuple[float, float, float] = LEAST_LEVELS
    """No level is smaller; that of the heading is so much in every pose, since no camera is mounted exactly, and joins
    what scatters."""
    mount_sigma_deg: float = 1.0
    """How far a camera may be rolled or pitched in its mount, before the drive says more."""
    least_gain_nats: float = 2.0
    """What a frame must gain at least: less is left by masks and maps that are not perfect, in every frame anew."""
    width_gain_nats: ClassVar[tuple[float, float]] = (4.0, 0.5)
    """The same of the width of the road, where the pose has the height of its mounts, and where it has another one as
    if for that width. The first is beyond what a real drive said (2.6); lines of one side 0.2 m aside say 3, 0.3 m 3.5
    to 8, and sound simulated drives lose 6 and more."""
    width_height_m: ClassVar[tuple[float, float]] = (0.01, 0.03)
    """From the first height to the second. On sound drives, a real one among them, it is less than 0.005 m on average,
    with lines of one side 0.2 or 0.3 m aside 0.03 to 0.07 m."""
    count_nats: float = 2.5
    """A calibration that so much speaks for joins the protection levels: less is what chance does among a dozen."""
    class_gain_nats: ClassVar[float] = 0.5
    """What elements of a group alone must fit better elsewhere in a frame at least: on sound drives they fit best where
    the pose is, to the frame."""
    class_count_nats: ClassVar[float] = 1.0
    """Elements of one kind that were moved join the levels from so much on."""
    doubt_memory_m: ClassVar[float] = 8.0
    """Way over which what was spoken for still widens the levels: so long errors of masks may stay the same. A frame
    within them which does not say it again has not said otherwise."""


STEPS = np.array([1.0, -1.0, 2.0, -2.0])
"""How far each alternative is changed, in its units. The far ones are asked only where near ones fit better so far:
beyond the reach of the masks costs end, and the near ones do not tell the size of a large fault."""


class Tried(NamedTuple):
    """A frame solved again with one alternative in its `STEPS`."""

    name: str
    gain_nats: Float[np.ndarray, "4"]
    """By how much it fits better; NaN where it was not asked."""
    moved: Float[np.ndarray, "4 3"]
    """How far the pose moves: forward [m], left [m], heading [rad]."""


class WatchState(NamedTuple):
    """Sums over frames; flat, as the number of calibrations is that of the cameras."""

    num: Float[np.ndarray, " a"] = np.zeros(0)
    """Frames that were solved again with each of the other calibrations."""
    gain: Float[np.ndarray, " a"] = np.zeros(0)
    """By how much they fitted better [nats]."""
    moved: Float[np.ndarray, " three_a"] = np.zeros(0)
    """How far their poses moved: forward [m], left [m], heading [rad]."""
    profiles: Float[np.ndarray, " groups_n"] = np.zeros(0)
    """Costs of every one of `GROUPS` over the moves [nats]."""
    aside_rad: Float[np.ndarray, ""] = np.float64(0.0)
    """How far aside the vehicle drove of late at the least; see `course`."""
    num_looks: Float[np.ndarray, ""] = np.float64(0.0)
    """Frames that the profiles were summed over."""
    num_frames: Int[np.ndarray, ""] = np.int64(0)
    way_m: Float[np.ndarray, ""] = np.float64(0.0)
    """Since the last frame that was looked at."""
    stance: StanceState = StanceState()
    """How the vehicle stood on the road."""
    sign: SignState = SignState()
    """What was said of lenses with the other sign of distortion."""


class Suspicion(NamedTuple):
    """A fault that the drive speaks for."""

    name: str
    size: float
    nats: float
    """By how much the drive is better explained with it."""
    moved: Float[np.ndarray, "3"]
    """How far the pose would be off: forward [m], left [m], heading [rad]."""


def alternatives(num_cameras: int) -> tuple[str, ...]:
    """What is changed in the other calibrations, each a little up and a little down; and the width of the road in the
    map, which height and lens make up for."""
    turns = [ASIDE, *(f"{turn} {k}" for k in range(num_cameras) for turn in _TURNS)] if num_cameras > 1 else []
    return (FOCAL, RADIAL, WIDTH, *turns)


def unit_of(name: str, config: WatchConfig) -> float:
    """By how much one of `alternatives` is changed: a share of the image, a width [m] or an angle [rad]."""
    units = {FOCAL: FOCAL_SHARE, RADIAL: config.radial_share, WIDTH: config.width_m}
    return units.get(name, config.turn_rad)


def asked_now(watch: WatchState, num_cameras: int, config: WatchConfig) -> tuple[str, ...]:
    """What the next frame is asked for: all but turns of single cameras at the start of a drive, later one alternative
    after another."""
    names = alternatives(num_cameras)
    if int(watch.num_frames) < config.eager_looks:
        return tuple(name for name in names if name in (FOCAL, RADIAL, WIDTH, ASIDE))
    return (names[int(watch.num_frames) % len(names)],)


def far_side(watch: WatchState, num_cameras: int, name: str) -> int | None:
    """The side (0 up, 1 down) on which an alternative fits better on average so far; None where there is none.

    There a far change is asked for, too. Not the frame itself decides: one that happens to like a near change likes a
    far one.
    """
    k = len(STEPS) * alternatives(num_cameras).index(name)
    if len(watch.num) <= k or (watch.num[k : k + 2] <= 0.0).any():
        return None
    mean = watch.gain[k : k + 2] / watch.num[k : k + 2]
    side = int(np.argmax(mean))
    return side if mean[side] > 0.0 else None


@once_for_each
def changed_rigs(rig: Rig, name: str, config: WatchConfig) -> tuple[Rig, ...]:
    """The calibrations that a frame is solved with again: one alternative in its `STEPS`."""
    return tuple(_changed(rig, name, step * unit_of(name, config)) for step in STEPS)


def widths(name: str, config: WatchConfig) -> tuple[float, ...]:
    """By how much the road is wider with each of `changed_rigs` [m]."""
    return tuple((STEPS * (config.width_m if name == WIDTH else 0.0)).tolist())


def _changed(rig: Rig, name: str, by: float) -> Rig:
    if name == WIDTH:
        return rig
    if name == FOCAL:
        return longer(rig, by)
    if name == RADIAL:
        return Rig(tuple(_bent(camera, by) for camera in rig.cameras), rig.T_base_cam, rig.names)
    turn, which = name.split()
    cameras = slice(None) if name == ASIDE else int(which)
    T_base_cam = np.array(rig.T_base_cam, dtype=np.float64)
    T_base_cam[cameras, :3, :3] = _about(turn, by) @ T_base_cam[cameras, :3, :3]
    return Rig(rig.cameras, T_base_cam, rig.names)


def _bent(camera: Camera, share: float) -> Camera:
    """A lens whose radial term makes the side of the image larger by a share."""
    if isinstance(camera, PinholeCamera):
        camera = BrownConradyCamera(camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
    if not hasattr(camera, "k1"):
        return camera
    side = 0.5 * float(camera.width) / float(camera.fx)
    return eqx.tree_at(lambda c: c.k1, camera, camera.k1 + share / side**2)


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
    tried: Sequence[Tried],
    profiles: Float[np.ndarray, "group n"],
    config: WatchConfig,
) -> WatchState:
    """The sums after one more frame.

    Args:
        watch: Before.
        num_cameras: Of the rig.
        aside_rad: Direction of travel to be remembered.
        tried: The frame with `changed_rigs` of every one of `asked_now`.
        profiles: Costs of every one of `GROUPS` at `moves`.
        config: Memory.
    """
    names = alternatives(num_cameras)
    size = len(STEPS) * len(names)
    if watch.num.shape != (size,):
        zeros = (np.zeros(size), np.zeros(size), np.zeros(3 * size), np.zeros(profiles.size))
        watch = WatchState(*zeros, num_frames=watch.num_frames, stance=watch.stance, sign=watch.sign)
    keep = np.exp(-1.0 / config.memory_frames)
    new, gain, moved = np.zeros(size), np.zeros(size), np.zeros((size, 3))
    for one in tried:
        asked = np.isfinite(one.gain_nats) & np.isfinite(one.moved).all(axis=1)
        rows = len(STEPS) * names.index(one.name) + np.flatnonzero(asked)
        new[rows], gain[rows], moved[rows] = 1.0, one.gain_nats[asked], one.moved[asked]
    usable = np.isfinite(profiles).all()
    return WatchState(
        keep * watch.num + new,
        keep * watch.gain + gain,
        keep * watch.moved + moved.ravel(),
        keep * watch.profiles + (np.asarray(profiles, np.float64).ravel() if usable else 0.0),
        np.float64(aside_rad),
        np.float64(keep * watch.num_looks + usable),
        np.int64(watch.num_frames + 1),
        np.float64(0.0),
        watch.stance,
        watch.sign,
    )


def suspicions(watch: WatchState, num_cameras: int, config: WatchConfig) -> list[Suspicion]:
    """Every fault that the drive speaks for, the clearest first."""
    if not len(watch.num):
        return []
    found = [*_calibrations(watch, num_cameras, config), *_classes_apart(watch, config)]
    return sorted(found, key=lambda s: -s.nats)


class Moved(NamedTuple):
    """Elements of one kind that, taken alone, fit elsewhere."""

    kind: str
    """One of `GROUPS`; empty where none are."""
    ahead_m: float
    left_m: float
    nats: float


NOTHING_MOVED = Moved("", 0.0, 0.0, 0.0)


def moved_elements(watch: WatchState, config: WatchConfig) -> Moved:
    """What the drive speaks for most."""
    if not len(watch.num):
        return NOTHING_MOVED
    most = max(_classes_apart(watch, config), key=lambda s: s.nats)
    if most.nats < config.class_count_nats:
        return NOTHING_MOVED
    return Moved(most.name.split("_")[0], float(most.moved[0]), float(most.moved[1]), most.nats)


def _calibrations(watch: WatchState, num_cameras: int, config: WatchConfig) -> list[Suspicion]:
    """Where a parabola through the costs of the calibration and of those beside it has its minimum."""
    found = []
    for k, name in enumerate(alternatives(num_cameras)):
        num, gain, moved = means_of(watch, k)
        if (num[:2] < 0.5).any():
            continue
        side = int(np.argmax(gain[:2]))
        if num[side + 2] >= 0.5 and gain[side] > 0.0:
            at, better, step = _on_one_side(gain[side], gain[side + 2], moved[side], moved[side + 2])
            at *= STEPS[side]
        else:
            at, better = _between(gain[0], gain[1])
            step = at * 0.5 * (moved[0] - moved[1])
        # Both neighbours say it, as often as they were asked.
        least_nats = _least_of_width(watch, at, config) if name == WIDTH else config.least_gain_nats
        nats = config.share * float(num[:2].sum()) * max(better - least_nats, 0.0)
        found.append(Suspicion(name, at * unit_of(name, config), nats, step))
    return found


def means_of(
    watch: WatchState, k: int
) -> tuple[Float[np.ndarray, "4"], Float[np.ndarray, "4"], Float[np.ndarray, "4 3"]]:
    """Of each of the `STEPS` of one of `alternatives`: how many frames were asked, by how much one fits better [nats],
    and how far its pose moves: forward [m], left [m], heading [rad]."""
    rows = slice(len(STEPS) * k, len(STEPS) * (k + 1))
    num = watch.num[rows]
    asked = np.maximum(num, 1e-9)
    return num, watch.gain[rows] / asked, watch.moved.reshape(-1, 3)[rows] / asked[:, None]


def _least_of_width(watch: WatchState, at: float, config: WatchConfig) -> float:
    """What a frame must gain at least by a road that is wider (`at` above 0) or narrower.

    A map that has the road wider than it is makes the vehicle stand higher: both sides then fit, and what lies ahead
    fits from somewhere else along the road.
    """
    return float(np.interp(-np.sign(at) * height_m(watch.stance), config.width_height_m, config.width_gain_nats))


def _between(gain_up: float, gain_down: float) -> tuple[float, float]:
    """Where a parabola through costs at 0, 1 and -1 is least, not beyond these, and what is gained there."""
    slope, bend = 0.5 * (gain_down - gain_up), -0.5 * (gain_up + gain_down)
    at = float(np.clip(-0.5 * slope / bend, -1.0, 1.0)) if bend > 0.0 else -float(np.sign(slope))
    return at, float(-(slope * at + bend * at**2))


def _on_one_side(
    near: float, far: float, moved_near: np.ndarray, moved_far: np.ndarray
) -> tuple[float, float, np.ndarray]:
    """Where a parabola through gains at 0, 1 and 2 is largest, not beyond these, what is gained there, and how far the
    pose moves."""
    bend = 0.5 * (far - 2.0 * near)
    slope = near - bend
    at = float(np.clip(-0.5 * slope / bend, 0.0, 2.0)) if bend < 0.0 else 2.0
    moved = at * moved_near if at <= 1.0 else moved_near + (at - 1.0) * (moved_far - moved_near)
    return at, float(slope * at + bend * at**2), moved


def _classes_apart(watch: WatchState, config: WatchConfig) -> list[Suspicion]:
    """Whether lines or posts, or what lies on one side, each alone, fit better beside the pose: they then do not
    belong to one map."""
    found = []
    for name in CLASSES:
        places, cost = profile_of(watch, name, config)
        is_here = near(places)
        best = int(np.argmin(np.where(is_here, np.inf, cost)))
        moved = np.zeros(3)
        moved[int(name.endswith("left"))] = places[best]
        better = float(np.min(cost[is_here]) - cost[best]) - config.class_gain_nats * float(watch.num_looks)
        found.append(Suspicion(name, float(places[best]), config.share * max(better, 0.0), moved))
    return found


def profile_of(
    watch: WatchState, name: str, config: WatchConfig
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Places ahead or to the left [m] where one of `CLASSES` was looked at, and what all frames cost there [nats]."""
    group, axis = name.split("_")
    num_aside = len(_places(config.aside_m))
    of_axis = slice(num_aside) if axis == "left" else slice(num_aside, None)
    costs = watch.profiles.reshape(len(GROUPS), -1)[GROUPS.index(group)]
    return moves(config)[of_axis, int(axis == "left")], costs[of_axis]


def near(places_m: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Which places are the pose itself, for what masks tell."""
    return np.abs(places_m) <= 1.5 * (places_m[1] - places_m[0])
