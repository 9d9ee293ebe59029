"""Mounts of all cameras from a drive alone: no targets, no map (room: calibration; host).

In: a Drive with wheels and masks, a calibration a degree and 10 cm off. Out: RoadCalibration: the corrected rig, and
what the drive leaves open. The road's own paint, seen by two cameras and at two times, has to lie at one place.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from semloc_jax.calibration.frames import choose_frames, motion_between
from semloc_jax.calibration.observability import Observability
from semloc_jax.calibration.road_fit import (
    RoadCalibrationConfig,
    RoadFit,
    fit_to_lines,
    observability,
    refitted,
    start_fit,
)
from semloc_jax.calibration.road_lines import laid
from semloc_jax.calibration.road_spots import SpotFinder
from semloc_jax.calibration.road_streaks import Streak, find_streaks
from semloc_jax.cameras import Rig
from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_source import MaskSource


@dataclass(frozen=True)
class SeenLines:
    """Places of all matched lines in odom [m], float64[n 2], as cameras see them before and after; camera of each."""

    before: Float[np.ndarray, "n 2"]
    after: Float[np.ndarray, "n 2"]
    camera: Int[np.ndarray, " n"]


@dataclass(frozen=True)
class RoadCalibration:
    """What the road says about the mounts of cameras.

    Attributes:
        rig_before: the calibration to start from.
        rig: the corrected one.
        odometer_scale: true speed over measured speed.
        gyro_bias_radps: [rad/s].
        observability: sigmas and verdicts of mounts and odometer.
        frames: those used.
        T_odom_base: their poses, float64[n 4 4]; the road is z = 0.
        before_m: how far sights of one line lie from it, root mean square, with the calibration to start from.
        after_m: with the corrected one.
        num_lines: lines that several images show.
        num_across: of them such as several cameras show.
        num_spots: spots that two pictures show; 0 without images.
        seen: the lines as they lie, for a picture.
        converged: whether the last solve ended by itself.
    """

    rig_before: Rig
    rig: Rig
    odometer_scale: float
    gyro_bias_radps: float
    observability: Observability
    frames: tuple[Frame, ...]
    T_odom_base: Float[np.ndarray, "n 4 4"]
    before_m: float
    after_m: float
    num_lines: int
    num_across: int
    num_spots: int
    seen: SeenLines
    converged: bool


def calibrate_on_road(drive: Drive, masks: MaskSource, config: RoadCalibrationConfig | None = None) -> RoadCalibration:
    """Mounts under which the paint of the road lies at one place, whichever camera sees it and when.

    Args:
        drive: Frames, wheels and the calibration to start from, up to a degree and 10 cm off.
        masks: Masks of its cameras.
        config: None for the defaults.

    Raises:
        SemlocError: no wheels, too few frames, too few lines, or lenses are asked for.
    """
    config = config or RoadCalibrationConfig()
    settings = config.calibration
    if settings.intrinsics != "none":
        raise SemlocError(
            f"calibration by the road: intrinsics '{settings.intrinsics}'; expected none: the road tells mounts only; "
            "lenses come from boards (--targets) or a map (--map)"
        )
    frames = choose_frames(drive, settings.num_frames, settings.min_spacing_m)
    motion = motion_between(drive, frames, settings)
    if motion is None:
        raise SemlocError(
            f"drive {drive.name}: no wheel odometry over its frames, which says how far apart they are; give one, or "
            "calibrate against a map (--map)"
        )
    rig = drive.rig.select(masks.cameras)
    streaks, start = find_streaks(drive, frames, masks), start_fit(rig, motion)
    fit = fit_to_lines(start, rig, motion, streaks, config)
    finder, spots = SpotFinder(frames, masks, rig), None
    for _ in range(config.num_polishes):
        spots = finder.found(fit.T_base_cam, fit.T_odom_base)
        if spots is None:
            break
        fit = refitted(fit, start, rig, motion, streaks, config.gates_m[-1], settings, spots)
    return RoadCalibration(
        rig_before=rig,
        rig=Rig(rig.cameras, fit.T_base_cam, rig.names),
        odometer_scale=float(fit.odometer[0]),
        gyro_bias_radps=float(fit.odometer[1]),
        observability=observability(rig, fit, settings),
        frames=frames,
        T_odom_base=fit.T_odom_base,
        before_m=_spread_m(start, streaks, fit.members),
        after_m=_spread_m(fit, streaks, fit.members),
        num_lines=len(fit.members),
        num_across=sum(len({streaks[k].camera for k in line}) > 1 for line in fit.members),
        num_spots=0 if spots is None else len(spots.camera),
        seen=_seen(start, fit, streaks),
        converged=fit.converged,
    )


def _spread_m(fit: RoadFit, streaks: Sequence[Streak], members: Sequence[np.ndarray]) -> float:
    """Root mean square distance of all places from the straight line through those of their line [m]."""
    off = []
    for line in members:
        xy = np.concatenate([laid(streaks[k], fit.T_odom_cam[streaks[k].frame, streaks[k].camera]).xy for k in line])
        xy = xy - xy.mean(axis=0)
        off.append(xy @ np.linalg.svd(xy, full_matrices=False)[2][1])
    return float(np.sqrt(np.mean(np.concatenate(off) ** 2)))


def _seen(start: RoadFit, fit: RoadFit, streaks: Sequence[Streak]) -> SeenLines:
    used = [streaks[k] for line in fit.members for k in line]
    before, after = (np.concatenate([laid(s, f.T_odom_cam[s.frame, s.camera]).xy for s in used]) for f in (start, fit))
    return SeenLines(before, after, np.concatenate([np.full(len(s.rays_cam), s.camera) for s in used]))
