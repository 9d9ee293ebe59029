"""One track through one frame: held against the masks, corrected, weighed (room: localization; host).

In: Track, FrameInMap. Out: the next Track and the result of the frame for it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from semloc_jax.alignment.pose_prior import RoadSigmas
from semloc_jax.fusion.measurements import Fusion, Innovation
from semloc_jax.fusion.noise_scale import BELIEFS, NoiseScale, of_a_series, of_one_pose
from semloc_jax.geometry import rigid
from semloc_jax.localization.frame_alignment import Alignment
from semloc_jax.localization.frame_in_map import FrameInMap
from semloc_jax.localization.track_state import Track

_OUTSIDE = "outside of the map"


@dataclass(frozen=True)
class FollowConfig:
    """How tracks are weighed and measurements enter. All values are ours."""

    penalty_share: float = 0.3
    """Share of the cost of a frame that is new: successive frames see the same map."""
    penalty_memory: float = 0.9
    refused_nats: float = 5.0
    """Cost of a frame that contradicts the track."""
    regained: float = 0.25
    """Contradictions that one agreeing frame cancels: after many of them a track needs several frames to recover."""
    stance_gain: float = 0.1
    """Weight of a new frame in the mean stance of the vehicle on the road."""
    grain_gain: float = 0.1
    """Weight of a new frame in the mean grain of the masks."""
    max_height_m: float = 0.15
    max_tilt_deg: float = 2.0


class FrameReport(NamedTuple):
    """The result of one frame for one track."""

    found: Alignment | None
    is_occluded: bool
    is_off_map: bool
    reasons: tuple[str, ...]
    innovation: Innovation | None = None
    difference: np.ndarray | None = None
    """Measured pose as seen from the predicted one (right tangent), where it was taken."""
    covariance: np.ndarray | None = None
    """Of the difference."""

    @property
    def is_accepted(self) -> bool:
        """Whether the measured pose was taken."""
        return self.innovation is not None and self.innovation.accepted


def stance_after(
    stance: np.ndarray, measured: np.ndarray, covariance: np.ndarray, road: RoadSigmas, config: FollowConfig
) -> np.ndarray:
    """How the vehicle stands on the road, after one more frame: a slow mean, which a weak view hardly moves.

    A loaded boot or a camera that is off by a degree stays for minutes, a pothole does not.
    """
    tilt = np.deg2rad(road.roll_pitch_deg)
    spread = np.array([road.height_m, tilt, tilt]) ** 2
    gain = config.stance_gain * spread / (spread + np.diagonal(covariance)[2:5])
    limit = np.array([config.max_height_m, *np.deg2rad([config.max_tilt_deg] * 2)])
    return np.clip(stance + gain * (measured - stance), -limit, limit)


def seen(track: Track, fusion: Fusion, frame: FrameInMap) -> FrameReport:
    """What the masks of a frame say about a predicted track.

    A vehicle that stands where the map holds nothing may look at a part of it that begins farther ahead.
    """
    pose = fusion.pose(track.fusion)
    window, outside = frame.window(pose.T_map_base[:3, 3]), FrameReport(None, False, True, (_OUTSIDE,))
    if not window.local_map.elements:
        return outside
    answer = frame.align(pose.T_map_base, pose.covariance, float(track.along_sigma_m))
    if answer is None:
        return outside._replace(reasons=(f"{_OUTSIDE}: no road there",))
    is_far = window.nearest_m(pose.T_map_base[:2, 3]) > frame.limits.off_map_m
    if is_far and answer.found.in_view_px < frame.limits.min_in_view_px:
        return outside
    return FrameReport(answer.found, answer.is_occluded, False, answer.reasons)


def corrected(
    track: Track, view: FrameReport, fusion: Fusion, way_m: float, noise: NoiseScale, config: FollowConfig
) -> tuple[Track, FrameReport]:
    """The track with what the frame measured `way_m` after the one before, unless something speaks against it."""
    if view.found is None or view.is_occluded:
        return track, view
    sigma_along = np.float64(np.sqrt(view.found.measurement.covariance[0, 0]))
    refused = track._replace(num_refused=track.num_refused + 1.0, along_sigma_m=sigma_along)
    if view.reasons:
        return refused, view
    measured = view.found.measurement
    predicted, alone = fusion.pose(track.fusion), of_one_pose(measured.covariance, noise, BELIEFS)
    measured = measured._replace(covariance=of_a_series(alone, way_m, noise, BELIEFS))
    state, innovation = fusion.correct(track.fusion, measured)
    difference = rigid.log(rigid.inverse(predicted.T_map_base) @ measured.T_map_base)
    covariance = predicted.covariance + measured.covariance
    view = view._replace(innovation=innovation, difference=difference, covariance=covariance)
    if not innovation.accepted:
        text = f"the measured pose does not fit the prediction (chi2 {innovation.chi2:.0f})"
        return refused, view._replace(reasons=(text,))
    return track._replace(
        fusion=state,
        num_accepted=track.num_accepted + 1,
        num_refused=np.maximum(track.num_refused - config.regained, 0.0),
        along_sigma_m=sigma_along,
    ), view


def weighed(tracks: Sequence[Track], views: Sequence[FrameReport], config: FollowConfig) -> list[Track]:
    """The tracks with the cost of this frame in their penalties; the best one has none."""
    if len(tracks) < 2:
        return list(tracks)
    costs = np.array([np.nan if view.found is None or view.is_occluded else view.found.score for view in views])
    costs = np.where(np.isfinite(costs), costs - np.min(costs, initial=np.inf, where=np.isfinite(costs)), np.nan)
    refused = np.array([not view.is_accepted and not view.is_occluded for view in views])
    added = np.nan_to_num(config.penalty_share * costs, nan=0.0) + config.refused_nats * refused
    penalty = np.array([float(track.penalty) for track in tracks]) * config.penalty_memory + added
    penalty -= penalty.min()
    return [track._replace(penalty=np.float64(value)) for track, value in zip(tracks, penalty, strict=True)]


def grain_after(grain: np.ndarray, measured: float, num_frames: float, config: FollowConfig) -> np.ndarray:
    """The grain of the masks after one more frame: a mean of the first frames, later a slow one."""
    gain = max(config.grain_gain, 1.0 / (1.0 + num_frames))
    return np.asarray(grain + gain * (measured - grain), np.float32)
