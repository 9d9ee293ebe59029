"""Tracks that begin: where a search finds the vehicle, and with what dead reckoning still knows (room: localization;
host).

In: TrackerState, FrameFeatures, Acquisition. Out: the state with a track for each answer.
"""

from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from semloc_jax.fusion import noise_scale
from semloc_jax.fusion.measurements import Fusion, GnssMeasurement, PoseMeasurement
from semloc_jax.fusion.prediction import MotionIncrement, MotionQuality
from semloc_jax.localization import health
from semloc_jax.localization.acquisition import Acquisition, Area
from semloc_jax.localization.track_config import TrackConfig
from semloc_jax.localization.track_state import FrameFeatures, Track, TrackerState

_INFLATION = 4.0
"""A frame that is searched may have ended in a local minimum: its variance is taken this many times larger. Ours."""
_LEAST_SIGMA = 0.05 * np.array([1.0, 1.0, 1.0, 0.02, 0.02, 0.02])
"""Of the pose that a track begins with [m, rad]. Ours."""


def cautious(covariance: Float[np.ndarray, "6 6"]) -> Float[np.ndarray, "6 6"]:
    """Covariance of a pose that a track begins with: one frame found it, and no prediction says that it is right."""
    return _INFLATION * covariance + np.diag(_LEAST_SIGMA) ** 2


def new_track(fusion: Fusion, measurement: PoseMeasurement, penalty: float) -> Track:
    """A track that begins at a measured pose."""
    return Track(
        fusion=fusion.start(measurement),
        penalty=np.float64(penalty),
        num_accepted=np.int64(0),
        num_refused=np.float64(0.0),
        along_sigma_m=np.float64(0.0),
    )


def regained(fusion: Fusion, coasting: Any, measurement: PoseMeasurement, penalty: float) -> Track:
    """A track that begins at a measured pose, with what dead reckoning still knows where the two fit each other: place,
    velocity and biases stay as sure as they were.

    Args:
        fusion: What tracks are made of.
        coasting: Its state by dead reckoning at the time of the pose.
        measurement: The pose.
        penalty: Of the track [nats].
    """
    state, innovation = fusion.correct(coasting, measurement)
    track = new_track(fusion, measurement, penalty)
    return track._replace(fusion=state) if innovation.accepted else track


def rehearse(fusion: Fusion, num_frames: int = 16) -> None:
    """Let a fusion run for some frames of an invented drive, so that what it compiles is compiled before a real one."""
    pose = PoseMeasurement(0.0, np.eye(4), 1e-3 * np.eye(6))
    state = fusion.start(pose)
    step = np.eye(4)
    step[0, 3] = 1.0
    for k in range(num_frames):
        increment = MotionIncrement(step, 1e-4 * np.eye(6), float(k), float(k + 1), np.zeros((6, 3)), MotionQuality.OK)
        state = fusion.predict(state, increment)
        pose = PoseMeasurement(float(k + 1), pose.T_map_base @ step, pose.covariance)
        state, _ = fusion.correct(state, pose)
        fix = GnssMeasurement(float(k + 1), pose.T_map_base[:3, 3], np.ones(3))
        state, _ = fusion.correct_gnss(state, fix)


def acquired(
    state: TrackerState,
    frame: FrameFeatures,
    acquisition: Acquisition,
    area: Area | None,
    fusion: Fusion,
    config: TrackConfig,
) -> TrackerState:
    """The state with a track for each answer of a search, where one is due and finds something.

    Args:
        state: Without tracks, at the time of the frame.
        frame: The frame.
        acquisition: Searches of the map.
        area: Where the vehicle is, where nothing else says it.
        fusion: What tracks are made of.
        config: When a search is due, and how tracks are weighed.
    """
    now_s = float(state.time_s)
    if now_s < state.searched_s + config.acquisition.every_s - 1e-6:
        return state
    coasting = fusion.pose(state.coasting[0]) if state.coasting else None
    if area is not None and coasting is None:
        places = acquisition.tiles(area)
    else:
        priors = acquisition.priors(state.fixes, coasting, now_s) or [frame.guess]
        if priors[0] is None:
            return state
        places = acquisition.in_sectors(priors)
    modes = acquisition.search(frame, places)
    state = state._replace(searched_s=np.float64(now_s))
    if not modes:
        return state
    begun = partial(new_track, fusion)
    # What satellites contradict is no dead reckoning to go on with.
    if state.coasting and state.counters.conflicts < config.health.max_conflicts:
        begun = partial(regained, fusion, state.coasting[0])
    share, best = config.follow.penalty_share, modes[0].score
    measured = [PoseMeasurement(now_s, mode.T_map_base, cautious(mode.covariance)) for mode in modes]
    tracks = tuple(begun(m, share * max(k.score - best, 0.0)) for m, k in zip(measured, modes, strict=True))
    forgotten = noise_scale.without_poses(state.noise)
    return state._replace(tracks=tracks, counters=health.no_counts(), noise=forgotten).at_another_place()
