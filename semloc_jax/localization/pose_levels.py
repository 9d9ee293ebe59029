"""Protection levels of a pose under every fault that is suspected (room: localization; host).

In: TrackerState, the fused pose, cameras. Out: PoseLevels; the pose that goes out may be moved for them.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.frame_levels import AS_LEVELS
from semloc_jax.cameras import Rig
from semloc_jax.evaluation.metrics import ErrorLimit
from semloc_jax.evaluation.mixture_bounds import Causes, beyond
from semloc_jax.fusion import noise_scale
from semloc_jax.fusion.measurements import FusedPose
from semloc_jax.localization import course, innovations, separation, told_faults, weighed_faults
from semloc_jax.localization.integrity import (
    LEVEL_UNITS,
    ProtectionLevels,
    beyond_alert,
    map_sigmas,
    misleading,
    protection_levels,
)
from semloc_jax.localization.other_calibrations import alternatives
from semloc_jax.localization.separation import STAY, Separation
from semloc_jax.localization.track_config import TrackConfig
from semloc_jax.localization.track_state import TrackerState
from semloc_jax.localization.weighed_height import with_height
from semloc_jax.localization.weighed_motion import with_motion

_OF_LEVELS = [1, 0, 5]
"""Lateral, longitudinal, heading in a tangent."""
_LEAST_VARIANCE = 1e-12
"""Of a pose [m^2, rad^2]: none is surer."""
_UNTOLD_DEG = float(np.degrees(0.5 / 600.0))
"""What no frame tells of the heading of sound cameras: masks that lie half a pixel aside, at 600 px a radian."""
_ALONE = (
    "all that was in view is of one kind or on one side, and no drive tells whether it was moved as a whole: state how "
    "far the map may be off (--map-sigma-m)"
)
_NOT_EXCLUDED = (
    "another lens, elements of the map that were moved or an error of wheels and clocks are not excluded yet: more way "
    "tells"
)


class PoseLevels(NamedTuple):
    """Protection levels of a pose under every suspected fault.

    Attributes:
        protection: The levels.
        causes: A sentence for each fault that takes one beyond its alert limit, or that the pose is moved for.
        misleading: Probability that an error is beyond its alert limit.
        move: How far the pose is moved for them: left [m], ahead [m], heading [deg], positive to the left.
        left_open: Variance that they add to that of the pose, in the same order and units.
    """

    protection: ProtectionLevels
    causes: tuple[str, ...]
    misleading: float
    move: Float[np.ndarray, "3"] = STAY
    left_open: Float[np.ndarray, "3"] = STAY


class Known(NamedTuple):
    """What levels are made of.

    Attributes:
        errors: Covariance of the pose, degrees of freedom and what the map leaves open, as `protection_levels`.
        faults: Every fault that a level has to hold under.
        spoken: Those among them that the last frames speak for, or did of late.
        doubted: Where they leave the right pose, as remembered; see `TrackerState`.
        standing: How far the right pose may be under those that are considered whatever the last frames say: left [m],
            ahead [m], heading [deg].
        way: Course of the pose, and what is remembered of it [rad]; None where there is no track.
        aside: Probability that the cameras look aside.
        weighed: Faults that the drive has neither told nor excluded; None where there is no track.
        still: Where they leave the right pose at the stated risk, least and most, as `standing`.
        untold: What is told where that is beyond a limit.
        sound: Variance by what calibrations that are as they should be are off all the same, as levels.
        rig: Cameras.
        config: Limits.
    """

    errors: tuple[np.ndarray, np.ndarray, np.ndarray]
    faults: list[Separation]
    spoken: list[Separation]
    doubted: Float[np.ndarray, "2 3"]
    standing: Float[np.ndarray, "3"]
    way: tuple[course.Course, float] | None
    aside: float
    weighed: Causes | None
    still: Float[np.ndarray, "2 3"]
    untold: str
    sound: Float[np.ndarray, "3"]
    rig: Rig
    config: TrackConfig

    @property
    def limit(self) -> ErrorLimit:
        """The alert limits."""
        return self.config.health.integrity.limit

    @property
    def share(self) -> float:
        """Risk that the level of the heading may have on either side where the cameras look aside."""
        return self.config.health.integrity.risk / 6.0 / self.aside

    def weighed_about(self, move: Float[np.ndarray, "3"]) -> Causes:
        """The weighed faults about a pose that was moved."""
        return self.weighed._replace(mean=self.weighed.mean - move)


def _spoken_for(state: TrackerState, rig: Rig, config: TrackConfig) -> list[Separation]:
    """What the last frames say against calibration, map and motion."""
    doubts = (Separation(*doubt) for doubt in innovations.doubts(state.innovations))
    return [*doubts, *told_faults.spoken_for(state.watch, rig, config.watch)]


def known_of(
    state: TrackerState, fused: FusedPose, rig: Rig, way_m: float, map_sigma: tuple[float, float], config: TrackConfig
) -> Known:
    """What is known of a pose.

    Args:
        state: After the frame.
        fused: The pose in the map.
        rig: Cameras.
        way_m: Way since the frame before [m].
        map_sigma: What the map leaves open around the pose: place [m], direction [rad].
        config: Limits.
    """
    freedom = noise_scale.freedom(state.noise, noise_scale.BELIEFS)[AS_LEVELS]
    errors = fused.covariance, freedom, map_sigmas(*map_sigma)
    if not state.tracks:
        return Known(
            errors=errors,
            faults=[],
            spoken=[],
            doubted=state.doubted,
            standing=STAY,
            way=None,
            aside=0.0,
            weighed=None,
            still=np.zeros((2, 3)),
            untold=_NOT_EXCLUDED,
            sound=STAY,
            rig=rig,
            config=config,
        )
    spoken = _spoken_for(state, rig, config)
    doubted = separation.remembered(state.doubted, spoken, way_m, config.watch)
    lasting = separation.lasting(doubted, spoken)
    standing = told_faults.separations(state.watch, rig, config.watch)
    spoken = [*spoken, *lasting]
    faults = [*spoken, *standing]
    reached = separation.farthest(separation.reach(standing), STAY)
    way, aside_rad = course.course_of(fused), float(state.watch.aside_rad)
    names = alternatives(len(rig.names))
    by_masks = weighed_faults.aside(state.watch, names, config.watch)
    probable = course.probability(aside_rad, way, told_faults.is_ahead(rig), by_masks)
    by_cameras = weighed_faults.heading_if_aside(state.watch, names, config.watch)
    if by_cameras is not None and not told_faults.is_ahead(rig):
        way = course.joined(way, *by_cameras)
    sigma = np.sqrt(np.maximum(np.diagonal(fused.covariance), _LEAST_VARIANCE))[_OF_LEVELS] * LEVEL_UNITS
    is_small = rig.finer > 1
    is_stated = map_sigma[0] > 0.0
    weighed = weighed_faults.weighed(state.watch, names, sigma, freedom, config.watch, is_small, is_stated)
    if is_small:
        camera_m = float(np.asarray(rig.T_base_cam, np.float64)[:, 2, 3].mean())
        weighed = with_height(weighed, state.watch, camera_m, sigma, freedom)
    weighed = with_motion(weighed, state.innovations, sigma, freedom)
    still = weighed_faults.reach(weighed, config.health.integrity.risk / 6.0)
    sound = weighed_faults.of_sound_ones(state.watch, names, config.watch, is_small)
    remembered = (way, aside_rad)
    return Known(
        errors=errors,
        faults=faults,
        spoken=spoken,
        doubted=doubted,
        standing=reached,
        way=remembered,
        aside=probable,
        weighed=weighed,
        still=still,
        untold=_NOT_EXCLUDED if is_stated or not weighed_faults.is_alone(state.watch, config.watch) else _ALONE,
        sound=sound,
        rig=rig,
        config=config,
    )


def levels_of(known: Known, move: Float[np.ndarray, "3"] = STAY) -> PoseLevels:
    """The levels of a pose that is moved, see `PoseLevels`."""
    limit, config = known.limit, known.config
    far = separation.farthest(separation.reach(known.faults), move)
    own = _own(known, far)
    misled = misleading(*known.errors, far, limit)
    if known.way is None:
        return PoseLevels(separation.at_least(own, config.watch), (), misled)
    seen = np.maximum(np.abs(move), known.standing)
    protection = separation.at_least(separation.with_faults(own, far), config.watch, seen)
    # Cameras that look aside: the pose with the heading of its course may be the right one instead.
    way, aside_rad = known.way
    turned_rad, free = float(np.deg2rad(move[2])), float(known.errors[1][2])
    left = *course.turned(aside_rad, way, turned_rad), free
    aside_deg = course.heading_level_deg(*left, known.share)
    causes = separation.causes(own, known.faults, limit)
    if turned_rad or protection.heading_deg <= limit.heading_deg < aside_deg:
        causes = (*causes, told_faults.aside_cause(way, aside_rad, aside_deg, known.rig))
    misled += known.aside * course.misleading(*left, limit.heading_deg)
    most = np.maximum(separation.farthest(known.still, move), 0.0)
    if beyond_alert(ProtectionLevels(*most.tolist()), limit):
        is_told = known.aside > 0.5 and not told_faults.is_ahead(known.rig)
        causes = (*causes, told_faults.ALL_ASIDE if is_told else known.untold)
    protection = ProtectionLevels(*np.maximum(protection, most).tolist())
    room = np.array([limit.lateral_m, limit.longitudinal_m, limit.heading_deg])
    misled += float(beyond(known.weighed_about(move), room).sum())
    aside_m = abs(way.off_rad) * told_faults.cameras_ahead_m(known.rig)
    protection = protection._replace(
        lateral_m=max(protection.lateral_m, own.lateral_m + aside_m),
        heading_deg=max(protection.heading_deg, aside_deg),
    )
    return PoseLevels(protection, causes, min(misled, 1.0), move, left_open(known, move))


def left_open(known: Known, move: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Variance about a pose that was moved which faults leave open beside its own: left [m], ahead [m], heading [deg].

    A pose that stands between two explanations is off by the way to one of them.
    """
    causes = known.weighed_about(move)
    sound = max(1.0 - float(causes.probability.sum()), 0.0)
    weighed = causes.probability @ (causes.mean**2 + causes.sigma**2) + sound * np.square(move)
    spoken = [separation.second_moment(fault, move) for fault in known.spoken]
    way, _ = known.way
    aside = known.aside * (way.off_rad**2 + way.sigma_rad**2)
    turned = np.array([0.0, 0.0, _UNTOLD_DEG**2 + np.degrees(np.degrees(aside))])
    anywhere = np.square(known.standing) / 3.0  # within its reach the right pose is anywhere: a uniform variance
    return np.max([weighed, *spoken], axis=0) + known.sound + anywhere + turned


def within(known: Known, levels: PoseLevels) -> PoseLevels:
    """The levels of a pose that is moved as little as brings all of them within their alert limits; those it has where
    nothing does.

    The pose with a fault and the one without it may be right, so the pose between the two is off by no more than half
    of what they differ.

    Args:
        known: Of the pose.
        levels: Its levels where it is.
    """
    way, aside_rad = known.way
    reached, room = separation.reach(known.faults), separation.room_in(known.limit, known.config.watch)
    alone, (least, most) = np.array(_own(known, STAY)), known.still
    reached = np.array([np.minimum(reached[0], least + alone), np.maximum(reached[1], most - alone)])
    half = 0.5 * (reached[1] - reached[0])
    own = _own(known, np.array([*half[:2], np.abs(reached[:, 2]).max()]))
    move = separation.least_move(own, reached, room)
    if told_faults.is_ahead(known.rig):
        free = float(known.errors[1][2])
        turn_rad = course.turn_rad(aside_rad, way, free, known.share, known.limit.heading_deg)
        move[2] = float(np.degrees(turn_rad))
    moved = levels_of(known, move)
    return levels if beyond_alert(moved.protection, known.limit) else moved


def _own(known: Known, far: np.ndarray) -> ProtectionLevels:
    """The levels of a pose without faults, which leave what room they can to poses so far away."""
    room = np.array(separation.room_in(known.limit, known.config.watch)) - far
    return protection_levels(*known.errors, room, known.config.health.integrity)
