"""Where to look for the vehicle when nothing is known, or hardly anything (room: localization; host).

In: satellite fixes and the driven path between them, or an area of the map. Out: PosePrior, or tiles of an area.
Two valid fixes give position and heading (arXiv 2107.02557); which pose it is, is then decided by the masks.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.datasets.gnss import gnss_prior
from semloc_jax.datasets.sensors import GnssTrack, WheelOdometry
from semloc_jax.fusion.measurements import GnssMeasurement
from semloc_jax.fusion.prediction import Calibration, MotionLog
from semloc_jax.localization.track_state import Fixes

NUM_FIXES = 64
_PATH_STEP_S = 0.1


@dataclass(frozen=True)
class InitializationConfig:
    """When satellite fixes may start a search. All values are ours."""

    min_fixes: int = 2
    min_travel_m: float = 1.0
    """Fixes nearer to each other along the path say nothing of the heading."""
    max_sigma_m: float = 10.0
    """Fixes that state more than this are not valid."""
    window_s: float = 20.0
    """Older fixes are not used."""
    drift_share: float = 0.03
    """What dead reckoning since the newest fix adds to the sigma, as a share of the way."""
    sigma_inflation: float = 1.5
    """Neighbouring fixes share errors that their stated sigma does not hold."""
    min_sigma_m: float = 1.0
    max_sigma_heading_deg: float = 60.0
    """While the fixes say less of the heading than this, more of them are waited for."""
    sector_sigma_deg: float = 10.0
    """A search covers a heading of this sigma; where the fixes say less, several sectors are searched."""
    reach_sigmas: float = 2.0
    min_sigma_heading_deg: float = 2.0


def no_fixes() -> Fixes:
    """An empty buffer."""
    return Fixes(np.full(NUM_FIXES, -np.inf), np.zeros((NUM_FIXES, 3)), np.zeros((NUM_FIXES, 3)))


def with_fix(fixes: Fixes, fix: GnssMeasurement) -> Fixes:
    """The buffer with one more fix in its place in time; the oldest one goes."""
    rows = [
        np.concatenate([column, np.asarray(value, np.float64)[None]])
        for column, value in zip(fixes, (fix.time_s, fix.p_map, fix.sigma_m), strict=True)
    ]
    order = np.argsort(rows[0], kind="stable")[1:]
    return Fixes(*(column[order] for column in rows))


def newest(fixes: Fixes, num: int) -> Fixes:
    """The buffer without all but the newest fixes: the older ones belong to a place where the vehicle no longer is."""
    time_s = fixes.time_s.copy()
    time_s[: max(len(time_s) - num, 0)] = -np.inf
    return fixes._replace(time_s=time_s)


def prior_from_fixes(
    fixes: Fixes, motion: MotionLog, time_s: float, calibration: Calibration | None, config: InitializationConfig
) -> PosePrior | None:
    """Position and heading from the fixes up to a time; None while they say too little.

    Args:
        fixes: Buffer of fixes.
        motion: How the vehicle moved between them.
        time_s: Time of the wanted pose [s].
        calibration: Of the motion sensors, where it is known.
        config: Limits.
    """
    valid = (fixes.time_s >= time_s - config.window_s) & (fixes.time_s <= time_s + 1e-6)
    valid &= np.max(fixes.sigma_m[:, :2], axis=1) <= config.max_sigma_m
    if valid.sum() < config.min_fixes:
        return None
    track = GnssTrack(fixes.time_s[valid], fixes.p_map[valid], fixes.sigma_m[valid])
    path = _driven_path(motion, float(track.time_s[0]), time_s, calibration)
    if path is None or path.distance_m(np.array([time_s]))[0] < config.min_travel_m:
        return None
    found = gnss_prior(track, time_s, path, causal=True)
    if np.degrees(found.sigma_heading_rad) > config.max_sigma_heading_deg:
        return None
    since_m = path.distance_m(np.array([time_s]))[0] - path.distance_m(track.time_s[-1:])[0]
    sigma_m = max(config.sigma_inflation * float(np.max(found.sigma_m[:2])), config.min_sigma_m)
    sigma_m += config.drift_share * float(since_m)
    heading = max(found.sigma_heading_rad, np.deg2rad(config.min_sigma_heading_deg))
    return PosePrior(float(found.p_enu[0]), float(found.p_enu[1]), found.heading_rad, sigma_m, float(heading))


def _driven_path(
    motion: MotionLog, from_s: float, to_s: float, calibration: Calibration | None
) -> WheelOdometry | None:
    """The motion between two times as speeds and yaw rates at an even pace; None where they are too near."""
    num = int(np.ceil((to_s - from_s) / _PATH_STEP_S))
    if num < 1:
        return None
    times = np.linspace(from_s, to_s, num + 1)
    steps = [motion.increment(a, b, calibration).T_from_to for a, b in pairwise(times)]
    step_s = times[1] - times[0]
    speed = np.array([T[0, 3] for T in steps]) / step_s
    rate = np.array([np.arctan2(T[1, 0], T[0, 0]) for T in steps]) / step_s
    # Rates hold between samples, and the path is integrated by their mean: the samples lie in the middle of the steps.
    middle = 0.5 * (times[1:] + times[:-1])
    knots = np.concatenate([times[:1], middle, times[-1:]])
    pad = (np.concatenate([values[:1], values, values[-1:]]) for values in (speed, rate))
    return WheelOdometry(knots, *pad)


def sectors(prior: PosePrior, config: InitializationConfig) -> list[PosePrior]:
    """The prior as one or several that a search can cover, which differ in heading; the most probable first."""
    width = np.deg2rad(config.sector_sigma_deg)
    if prior.sigma_heading_rad <= 1.5 * width:
        return [prior]
    num = int(np.ceil(min(config.reach_sigmas * prior.sigma_heading_rad, np.pi) / (2.0 * width)))
    turns = 2.0 * width * np.array([0.0, *(sign * k for k in range(1, num + 1) for sign in (1.0, -1.0))])
    return [replace(prior, heading_rad=prior.heading_rad + float(t), sigma_heading_rad=float(width)) for t in turns]


def tile_priors(
    center_xy: Float[np.ndarray, "2"], radius_m: float, step_m: float, heading_step_deg: float
) -> list[PosePrior]:
    """Priors that cover a disc with every heading: overlapping tiles, each searched like a fix of its size.

    Args:
        center_xy: Middle of the area in the map frame [m].
        radius_m: Radius of the area [m].
        step_m: Distance of the tiles [m].
        heading_step_deg: Distance of the headings [deg].
    """
    num = int(np.ceil(radius_m / step_m))
    offsets = step_m * np.arange(-num, num + 1)
    east, north = (grid.ravel() for grid in np.meshgrid(offsets, offsets))
    inside = np.hypot(east, north) <= radius_m + 0.5 * step_m
    headings = np.deg2rad(np.arange(-180.0, 180.0, heading_step_deg))
    return [
        PosePrior(center_xy[0] + x, center_xy[1] + y, float(heading), 0.5 * step_m, np.deg2rad(0.5 * heading_step_deg))
        for x, y in zip(east[inside], north[inside], strict=True)
        for heading in headings
    ]
