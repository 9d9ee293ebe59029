"""What each frame says of calibration and map: it is solved again with one thing changed (room: localization; host).

In: WatchState, a frame whose pose was taken. Out: WatchState with one more frame. `told_faults` says what follows.
"""

from collections.abc import Callable, Sequence
from functools import cache, partial

import numpy as np
from jaxtyping import Float

from semloc_jax.cameras import Rig
from semloc_jax.fusion.measurements import FusedPose
from semloc_jax.geometry import rigid
from semloc_jax.localization import lens_sign, lens_way, stance_sums
from semloc_jax.localization.course import course_of, remembered_rad
from semloc_jax.localization.following import FrameReport
from semloc_jax.localization.frame_alignment import AlignmentConfig
from semloc_jax.localization.frame_in_map import FrameInMap
from semloc_jax.localization.lens_way import LensWay
from semloc_jax.localization.moved_elements import moves
from semloc_jax.localization.other_calibrations import FOCAL, OTHER_SIGN, STEPS, alternatives, changed_rigs, widths
from semloc_jax.localization.watch_config import WatchConfig
from semloc_jax.localization.watch_sums import Tried, WatchState, asked_now, far_sides, learned
from semloc_jax.runtime.memory import once_for_each

_Again = Callable[[tuple[Rig, ...], Sequence[float], Sequence[int], int], tuple[np.ndarray, np.ndarray]]
"""Solves a frame again with other calibrations, other widths of the road [m], those that are asked for, and how many of
them are steps of one alternative."""
_LOOSE_HEADING_RAD = 0.005
_LOOSE = np.diag([0.3, 0.1, 0.1, 0.01, 0.01, _LOOSE_HEADING_RAD]) ** 2
"""How far a pose may move with another calibration."""
HEADING_HELD_RAD = AlignmentConfig().prior_inflation * _LOOSE_HEADING_RAD
"""By which such a solve holds the heading itself, one standard deviation: that is no word of the masks."""
_PLANE = [0, 1, 5]
"""Forward, left and heading in a tangent."""
_ALONE = once_for_each(lambda rig: (rig,))


def looked(
    watch: WatchState,
    view: FrameReport,
    fused: FusedPose,
    frame: FrameInMap,
    way_m: float,
    config: WatchConfig,
) -> WatchState:
    """The sums with what a frame whose pose was taken says of calibration and map.

    Args:
        watch: Before.
        view: What the frame measured.
        fused: The pose after it.
        frame: The frame.
        way_m: Way since the frame before [m].
        config: When a frame is looked at.
    """
    aside = remembered_rad(float(watch.aside_rad), course_of(fused), way_m)
    way_m += float(watch.way_m)
    if int(watch.num_frames) > 0 and way_m < config.step_m:
        return watch._replace(way_m=np.float64(way_m), aside_rad=np.float64(aside))
    T = view.found.measurement.T_map_base
    profiles = frame.costs_of_classes(T, moves(config), config.level)
    if profiles is None:  # the pose was measured where the map has no road: such a frame says nothing of it
        return watch._replace(way_m=np.float64(way_m), aside_rad=np.float64(aside))
    rig = frame.frame.rig
    solved = partial(frame.align_again, T_map_base=T, covariance=_LOOSE)
    own = cache(lambda: float(solved(_ALONE(rig), [0.0], [0])[0][0]))
    again = partial(_again, solved=solved, own=own, T=T, score=view.found.score, config=config)
    every = alternatives(len(rig.names))
    is_small = rig.finer > 1
    names = asked_now(watch, every, config, is_small)
    sides = [far_sides(watch, every, name, is_small) for name in names]
    tried = [_tried(*one, rig, again, config) for one in zip(names, sides, strict=True)]
    for _, other in tried:
        if other is not None:
            watch = watch._replace(sign=lens_sign.learned(watch.sign, *other))
    for steps, _ in tried if is_small else ():
        if steps.name == FOCAL:
            watch = watch._replace(lens=_by_way(watch.lens, steps, view, fused))
    watch = _leaned(watch, fused.T_map_base, T, frame, way_m)
    return learned(watch, every, aside, [steps for steps, _ in tried], profiles, config)


def _tried(
    name: str, sides: tuple[int, ...], rig: Rig, again: _Again, config: WatchConfig
) -> tuple[Tried, tuple[float, np.ndarray] | None]:
    """The frame solved `again` with one thing of calibration or map changed, farther on the sides that are given; and
    what it says of the other sign of distortion, where that is asked, too."""
    rigs, asked = changed_rigs(rig, name, config), [0, 1, *(side + 2 for side in sides)]
    with_other = len(rigs) > OTHER_SIGN
    found = again(rigs, widths(name, config), [*asked, OTHER_SIGN] if with_other else asked, len(asked))
    gain, moved = np.full(len(STEPS), np.nan), np.zeros((len(STEPS), 3))
    gain[asked], moved[asked] = (values[: len(asked)] for values in found)
    return Tried(name, gain, moved), tuple(values[-1] for values in found) if with_other else None


def _again(
    rigs: tuple[Rig, ...],
    wider_m: Sequence[float],
    asked: Sequence[int],
    num_steps: int,
    solved: Callable[..., tuple[np.ndarray, np.ndarray] | None],
    own: Callable[[], float],
    T: Float[np.ndarray, "4 4"],
    score: float,
    config: WatchConfig,
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]]:
    """By how much a frame fits better with each calibration that is asked for [nats], NaN where there is no road, and
    how far its pose moves then: forward [m], left [m], heading [rad].

    Args:
        num_steps: How many of them are steps of one alternative; what follows is another one.
        own: The score of the frame solved again with its own calibration.
    """
    found = solved(rigs, wider_m, asked)
    if found is None:
        return np.full(len(asked), np.nan), np.zeros((len(asked), 3))
    scores, Ts = found
    gain = score - scores
    for part in (slice(num_steps), slice(num_steps, None)):
        if gain[part].max(initial=-np.inf) > config.least_gain_nats:
            # A frame that has not found its own best place yet gains by any second solve.
            gain[part] -= max(score - own(), 0.0)
    return gain, np.array([rigid.log(rigid.inverse(T) @ other)[_PLANE] for other in Ts])


def _by_way(way: LensWay, steps: Tried, view: FrameReport, fused: FusedPose) -> LensWay:
    """What the way says of the focal lengths after a look."""
    variance = float(view.covariance[0, 0])
    ahead_m = np.where(np.isfinite(steps.gain_nats), steps.moved[:, 0], np.nan)
    gain = float(fused.covariance[0, 0]) / variance
    return lens_way.learned(way, ahead_m, float(view.difference[0]), float(np.sqrt(variance)), gain)


def _leaned(
    watch: WatchState, T_map_base: np.ndarray, T_measured: np.ndarray, frame: FrameInMap, way_m: float
) -> WatchState:
    """The sums with how the vehicle stands on the road, whose plane is known where the frame was measured already."""
    road = frame.road_under(T_measured)
    if road is None:
        return watch
    T_road, spread = road
    stance = rigid.log(rigid.inverse(T_road) @ T_map_base)[2:5]
    return watch._replace(stance=stance_sums.learned(watch.stance, stance, np.array(spread), way_m))
