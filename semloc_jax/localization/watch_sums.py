"""Sums over the last frames of what each says for and against calibration and map, one fault at a time (room:
localization; host).

In: how much better a frame fits with another calibration or another width of the road, what lines and posts say alone.
Out: WatchState, and what the next frame is asked.
A fault of calibration or map hides in each single pose. A frame that is solved again with a lens a little longer or
shorter says by the difference which one is right, and where the vehicle then is; lines and posts that are held against
the masks each alone say whether they belong to one state of the road. What single frames say is summed up.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from semloc_jax.localization.lens_sign import SignState
from semloc_jax.localization.lens_way import LensWay
from semloc_jax.localization.other_calibrations import ASIDE, FOCAL, RADIAL, STEPS, WIDTH
from semloc_jax.localization.stance_sums import StanceState
from semloc_jax.localization.watch_config import WatchConfig


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
    lens: LensWay = LensWay()
    """What the way said of the focal lengths, where masks are small."""


class Suspicion(NamedTuple):
    """A fault that the drive speaks for."""

    name: str
    size: float
    nats: float
    """By how much the drive is better explained with it."""
    moved: Float[np.ndarray, "3"]
    """How far the pose would be off: forward [m], left [m], heading [rad]."""


def asked_now(
    watch: WatchState, names: tuple[str, ...], config: WatchConfig, is_small: bool = False
) -> tuple[str, ...]:
    """Which of the `alternatives` the next frame is asked for: all but turns of single cameras at the start of a drive,
    later one after another. Small masks are asked for the focal lengths every time: it takes a way to tell them."""
    if int(watch.num_frames) < config.eager_looks:
        return tuple(name for name in names if name in (FOCAL, RADIAL, WIDTH, ASIDE))
    turn = names[int(watch.num_frames) % len(names)]
    return (FOCAL, turn) if is_small and turn != FOCAL else (turn,)


def far_side(watch: WatchState, names: tuple[str, ...], name: str) -> int | None:
    """The side (0 up, 1 down) on which an alternative fits better on average so far; None where there is none.

    There a far change is asked for, too. Not the frame itself decides: one that happens to like a near change likes a
    far one.
    """
    k = len(STEPS) * names.index(name)
    if len(watch.num) <= k or (watch.num[k : k + 2] <= 0.0).any():
        return None
    mean = watch.gain[k : k + 2] / watch.num[k : k + 2]
    side = int(np.argmax(mean))
    return side if mean[side] > 0.0 else None


def far_sides(watch: WatchState, names: tuple[str, ...], name: str, is_small: bool) -> tuple[int, ...]:
    """The sides (0 up, 1 down) on which a frame is asked for a far change of an alternative, too.

    Small masks are asked for focal lengths on both: what a near one moves is less than what their pixels leave open.
    """
    if is_small and name == FOCAL:
        return (0, 1)
    side = far_side(watch, names, name)
    return () if side is None else (side,)


def learned(
    watch: WatchState,
    names: tuple[str, ...],
    aside_rad: float,
    tried: Sequence[Tried],
    profiles: Float[np.ndarray, "group n"],
    config: WatchConfig,
) -> WatchState:
    """The sums after one more frame.

    Args:
        watch: Before.
        names: The `alternatives` of the rig.
        aside_rad: Direction of travel to be remembered.
        tried: The frame with `changed_rigs` of every one of `asked_now`.
        profiles: Costs of every one of `GROUPS` at `moves`.
        config: Memory.
    """
    size, beside = len(STEPS) * len(names), {"stance": watch.stance, "sign": watch.sign, "lens": watch.lens}
    if watch.num.shape != (size,):
        zeros = (np.zeros(size), np.zeros(size), np.zeros(3 * size), np.zeros(profiles.size))
        watch = WatchState(*zeros, num_frames=watch.num_frames)._replace(**beside)
    keep = np.exp(-1.0 / config.memory_frames)
    kept = np.exp(-1.0 / max(config.memory_frames, config.memory_looks * len(names)))
    new, gain, moved = np.zeros(size), np.zeros(size), np.zeros((size, 3))
    for one in tried:
        asked = np.isfinite(one.gain_nats) & np.isfinite(one.moved).all(axis=1)
        rows = len(STEPS) * names.index(one.name) + np.flatnonzero(asked)
        new[rows], gain[rows], moved[rows] = 1.0, one.gain_nats[asked], one.moved[asked]
    usable = np.isfinite(profiles).all()
    return WatchState(
        num=kept * watch.num + new,
        gain=kept * watch.gain + gain,
        moved=kept * watch.moved + moved.ravel(),
        profiles=keep * watch.profiles + (np.asarray(profiles, np.float64).ravel() if usable else 0.0),
        aside_rad=np.float64(aside_rad),
        num_looks=np.float64(keep * watch.num_looks + usable),
        num_frames=np.int64(watch.num_frames + 1),
        way_m=np.float64(0.0),
        **beside,
    )


def means_of(
    watch: WatchState, k: int
) -> tuple[Float[np.ndarray, "4"], Float[np.ndarray, "4"], Float[np.ndarray, "4 3"]]:
    """Of each of the `STEPS` of one of `alternatives`: how many frames were asked, by how much one fits better [nats],
    and how far its pose moves: forward [m], left [m], heading [rad]."""
    rows = slice(len(STEPS) * k, len(STEPS) * (k + 1))
    num = watch.num[rows]
    asked = np.maximum(num, 1e-9)
    return num, watch.gain[rows] / asked, watch.moved.reshape(-1, 3)[rows] / asked[:, None]
