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
_HELP = "give --prior FILE.tum, or --area X,Y,RADIUS to search every heading there"


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
    drift_share_without_path: float = 0.5
    """The same where no wheel and no gyroscope says how the vehicle moved since."""
    sigma_inflation: float = 1.5
    """Neighbouring fixes share errors that their stated sigma does not hold."""
    min_sigma_m: float = 1.0
    max_sigma_heading_deg: float = 60.0
    """While the fixes say less of the heading than this, more of them are waited for."""
    wide_sigma_heading_deg: float = 30.0
    soon_s: float = 0.5
    soon_m: float = 3.0
    """Where the fixes say less than that, but the vehicle has driven so far in so short a time and they keep coming,
    the next ones are waited for: a frame that is held against every heading finds a wrong place along the road."""
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
    """Position and heading from the fixes up to a time; None while they say too little (see `why_no_prior`).

    With wheels or a gyroscope the driven path is laid onto the fixes. Without any, the fixes alone give the direction
    of travel, which is taken for the heading.

    Args:
        fixes: Buffer of fixes.
        motion: How the vehicle moved between them.
        time_s: Time of the wanted pose [s].
        calibration: Of the motion sensors, where it is known.
        config: Limits.
    """
    found = _from_fixes(fixes, motion, time_s, calibration, config)
    return found if isinstance(found, PosePrior) else None


def why_no_prior(
    fixes: Fixes, motion: MotionLog, time_s: float, calibration: Calibration | None, config: InitializationConfig
) -> str:
    """What the fixes lack, and what would help, in one sentence; empty where they give a prior."""
    found = _from_fixes(fixes, motion, time_s, calibration, config)
    return found if isinstance(found, str) else ""


def _from_fixes(
    fixes: Fixes, motion: MotionLog, time_s: float, calibration: Calibration | None, config: InitializationConfig
) -> PosePrior | str:
    """The prior, or why there is none."""
    recent = (fixes.time_s >= time_s - config.window_s) & (fixes.time_s <= time_s + 1e-6)
    valid = recent & (np.max(fixes.sigma_m[:, :2], axis=1) <= config.max_sigma_m)
    if not recent.any():
        return f"no satellite fix in the last {config.window_s:.0f} s; {_HELP}"
    if not valid.any():
        best_m = float(np.min(np.max(fixes.sigma_m[recent, :2], axis=1)))
        return f"satellite fixes state a sigma of {best_m:.0f} m or more, not {config.max_sigma_m:.0f} m; {_HELP}"
    if valid.sum() < config.min_fixes:
        return f"{valid.sum()} valid satellite fix so far; {config.min_fixes} are needed"
    track = GnssTrack(fixes.time_s[valid], fixes.p_map[valid], fixes.sigma_m[valid])
    path = (
        None if motion.is_silent(float(track.time_s[0]), time_s) else _driven_path(motion, track, time_s, calibration)
    )
    way_m = _way_of_fixes(track) if path is None else float(path.distance_m(np.array([time_s]))[0])
    if way_m < config.min_travel_m:
        return (
            f"the vehicle has moved {way_m:.1f} m: satellite fixes do not give the heading of one that stands; {_HELP}"
        )
    found = gnss_prior(track, time_s, path, causal=True)
    if np.degrees(found.sigma_heading_rad) > config.max_sigma_heading_deg:
        return (
            f"satellite fixes give the heading to {np.degrees(found.sigma_heading_rad):.0f} deg so far, not to "
            f"{config.max_sigma_heading_deg:.0f} deg; it needs more way, wheel odometry (wheel_odom.csv) or --prior"
        )
    driven_m = 0.0 if path is None else motion.way_m(time_s - config.soon_s, time_s)
    is_soon_known = time_s - float(track.time_s[-1]) < config.soon_s and driven_m > config.soon_m
    if is_soon_known and np.degrees(found.sigma_heading_rad) > config.wide_sigma_heading_deg:
        return f"satellite fixes give the heading to {np.degrees(found.sigma_heading_rad):.0f} deg; more come at once"
    since_m = _since_m(track, path, time_s, way_m)
    sigma_m = max(config.sigma_inflation * float(np.max(found.sigma_m[:2])), config.min_sigma_m)
    sigma_m += (config.drift_share if path is not None else config.drift_share_without_path) * since_m
    heading = max(found.sigma_heading_rad, np.deg2rad(config.min_sigma_heading_deg))
    return PosePrior(float(found.p_enu[0]), float(found.p_enu[1]), found.heading_rad, sigma_m, float(heading))


def _way_of_fixes(track: GnssTrack) -> float:
    """Distance of the farthest fix to the first, less what their errors may make of a vehicle that stands [m]."""
    apart_m = np.linalg.norm(track.p_enu[:, :2] - track.p_enu[0, :2], axis=1)
    return max(float(apart_m.max() - 2.0 * np.median(track.sigma_m[:, :2])), 0.0)


def _since_m(track: GnssTrack, path: WheelOdometry | None, time_s: float, way_m: float) -> float:
    """Way since the newest fix [m]; at the mean speed of the fixes where nothing measures it."""
    if path is not None:
        return float(path.distance_m(np.array([time_s]))[0] - path.distance_m(track.time_s[-1:])[0])
    driven_s = max(float(track.time_s[-1] - track.time_s[0]), 1e-3)
    return way_m / driven_s * (time_s - float(track.time_s[-1]))


def _driven_path(
    motion: MotionLog, track: GnssTrack, to_s: float, calibration: Calibration | None
) -> WheelOdometry | None:
    """The motion from the first fix to a time as speeds and yaw rates at an even pace; None where they are too near."""
    from_s = float(track.time_s[0])
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
