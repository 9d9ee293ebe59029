"""First guess of the vehicle pose from satellite fixes and wheel odometry (room: datasets; host).

In: GnssTrack, WheelOdometry, a time. Out: GnssPrior: position and heading with their standard deviations.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from semloc_jax.datasets.sensors import GnssTrack, WheelOdometry
from semloc_jax.errors import SemlocError

_JITTER_M = 1.0
"""Scale of the robust fit: fixes jitter by this much from one to the next; our choice."""
_OUTLIER_M = 3.0
_MIN_JITTER_M = 0.3
"""A few fixes may agree by chance; the heading is never stated more accurate than this."""
_MIN_SPREAD_M = 0.3
"""Below this spread of the fixes along the path their direction says nothing."""
_MIN_SIGMA_HEADING_RAD = np.deg2rad(0.5)
_CORRELATION_INFLATION = 3.0
"""Neighbouring fixes share most of their error: n fixes are worth about n / 9. Measured on a rendered drive."""


@dataclass(frozen=True)
class GnssPrior:
    """Where the vehicle is to satellite accuracy.

    Args:
        p_enu: position of the base origin in the map frame [m].
        sigma_m: standard deviations of east, north, up [m].
        heading_rad: heading of base x, counter-clockwise from east.
        sigma_heading_rad: its standard deviation; pi where the fixes do not tell (standing still).
    """

    p_enu: Float[np.ndarray, "3"]
    sigma_m: Float[np.ndarray, "3"]
    heading_rad: float
    sigma_heading_rad: float


def gnss_prior(
    gnss: GnssTrack,
    time_s: float,
    odometry: WheelOdometry | None = None,
    causal: bool = False,
    reach_m: float = 50.0,
    window_s: float = 20.0,
) -> GnssPrior:
    """Position and heading at a time, from the fixes around it.

    With odometry the driven path between the fixes is known, so that a rigid motion of that path onto the fixes gives
    the position and the heading at once; curves and drop-outs need no special care. Without it a parabola over
    +-1.5 s is fitted and its tangent is the heading. Both fits are robust against outlying fixes.

    Args:
        gnss: fixes.
        time_s: time of the wanted pose [s].
        odometry: speed and yaw rate; recommended.
        causal: use no fix after `time_s`, as a live vehicle must.
        reach_m: driven distance to the fixes used (with odometry); farther ones only where too few are near.
        window_s: time to the fixes used (with odometry), likewise.

    Raises:
        SemlocError: there is no fix to use.
    """
    usable = gnss.time_s <= time_s + 1e-6 if causal else np.ones(len(gnss.time_s), dtype=bool)
    if not usable.any():
        raise SemlocError(
            f"GNSS: no fix {'up to' if causal else 'for'} time {time_s:.3f} s; expected at least one; start later or "
            "give an initial pose"
        )
    fixes = replace(gnss, time_s=gnss.time_s[usable], p_enu=gnss.p_enu[usable], sigma_m=gnss.sigma_m[usable])
    if odometry is None:
        return _prior_from_parabola(fixes, time_s)
    return _prior_from_path(fixes, time_s, odometry, reach_m, window_s)


def _prior_from_path(
    fixes: GnssTrack, time_s: float, odometry: WheelOdometry, reach_m: float, window_s: float
) -> GnssPrior:
    """Fit of the driven path, in the vehicle frame at `time_s`, onto the fixes."""
    here = odometry.dead_reckon(np.array([time_s]))[0]
    driven_m = np.abs(odometry.distance_m(fixes.time_s) - odometry.distance_m(np.array([time_s]))[0])
    remoteness = np.maximum(driven_m / reach_m, np.abs(fixes.time_s - time_s) / window_s)
    nearest = np.argsort(remoteness, kind="stable")
    chosen = np.sort(nearest[: max(int(np.sum(remoteness <= 1.0)), 10)])
    driven = odometry.dead_reckon(fixes.time_s[chosen])
    # The path of the antenna: it swings around the base where the vehicle turns.
    lever = np.stack([_rotate(np.array(fixes.antenna_base[:2]), turn) for turn in driven[:, 2] - here[2]])
    path_base = _rotate(driven[:, :2] - here[:2], -here[2]) + lever
    weight = 1.0 / (1.0 + remoteness[chosen] ** 2)
    p_enu, sigma_m = fixes.p_enu[chosen], fixes.sigma_m[chosen]

    heading, position, weight = _fit_planar_motion(path_base, p_enu[:, :2], weight)
    height = _weighted_median(p_enu[:, 2], weight) - fixes.antenna_base[2]
    sigma_heading = _sigma_heading(path_base, p_enu[:, :2], heading, position, weight)
    return GnssPrior(np.append(position, height), np.median(sigma_m, axis=0), heading, sigma_heading)


def _fit_planar_motion(
    path_base: np.ndarray, p_enu: np.ndarray, weight: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Robust rotation and translation of `path_base` [n 2] onto `p_enu` [n 2], and the weights left to each fix."""
    heading, position = _best_pair(path_base, p_enu, weight)
    used = weight
    for _ in range(20):
        residual = np.linalg.norm(p_enu - position - _rotate(path_base, heading), axis=1)
        used = weight / (1.0 + (residual / _JITTER_M) ** 2)
        heading, position = _planar_motion(path_base, p_enu, used)
    return heading, position, used


def _best_pair(path_base: np.ndarray, p_enu: np.ndarray, weight: np.ndarray) -> tuple[float, np.ndarray]:
    """The motion of the two-fix hypothesis that most fixes agree with."""
    first, second = np.triu_indices(len(path_base), k=1)
    baseline = np.linalg.norm(path_base[second] - path_base[first], axis=1)
    if len(baseline) == 0 or baseline.max() < _MIN_SPREAD_M:
        return 0.0, np.median(p_enu, axis=0)
    far = baseline >= 0.3 * baseline.max()
    first, second = first[far], second[far]
    step_base, step_enu = path_base[second] - path_base[first], p_enu[second] - p_enu[first]
    headings = np.arctan2(step_enu[:, 1], step_enu[:, 0]) - np.arctan2(step_base[:, 1], step_base[:, 0])
    cos, sin = np.cos(headings)[:, None], np.sin(headings)[:, None]
    turned_x = cos * path_base[:, 0] - sin * path_base[:, 1]
    turned_y = sin * path_base[:, 0] + cos * path_base[:, 1]
    pair = np.arange(len(first))
    shift_x = p_enu[first, 0] - turned_x[pair, first]
    shift_y = p_enu[first, 1] - turned_y[pair, first]
    miss = np.hypot(p_enu[:, 0] - turned_x - shift_x[:, None], p_enu[:, 1] - turned_y - shift_y[:, None])
    best = int(np.argmin(np.minimum(miss / _OUTLIER_M, 1.0) ** 2 @ weight))
    return float(headings[best]), np.array([shift_x[best], shift_y[best]])


def _planar_motion(path_base: np.ndarray, p_enu: np.ndarray, weight: np.ndarray) -> tuple[float, np.ndarray]:
    """Weighted least-squares rotation and translation in the plane."""
    mean_base = weight @ path_base / weight.sum()
    mean_enu = weight @ p_enu / weight.sum()
    a, b = path_base - mean_base, p_enu - mean_enu
    heading = float(np.arctan2(weight @ (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), weight @ np.sum(a * b, axis=1)))
    return heading, mean_enu - _rotate(mean_base, heading)


def _sigma_heading(
    path_base: np.ndarray, p_enu: np.ndarray, heading: float, position: np.ndarray, weight: np.ndarray
) -> float:
    spread = path_base - weight @ path_base / weight.sum()
    moment = float(weight @ np.sum(spread**2, axis=1))
    if np.sqrt(moment / weight.sum()) < _MIN_SPREAD_M:
        return float(np.pi)
    residual = p_enu - position - _rotate(path_base, heading)
    variance = float(weight @ np.sum(residual**2, axis=1)) / (2.0 * weight.sum())
    sigma = _CORRELATION_INFLATION * np.sqrt(max(variance, _MIN_JITTER_M**2) / moment)
    return float(np.clip(sigma, _MIN_SIGMA_HEADING_RAD, np.pi))


def _prior_from_parabola(fixes: GnssTrack, time_s: float) -> GnssPrior:
    """Robust parabola through the fixes of +-1.5 s; through the nearest six where those are fewer."""
    nearest = np.argsort(np.abs(fixes.time_s - time_s), kind="stable")
    inside = int(np.sum(np.abs(fixes.time_s - time_s) <= 1.5))
    chosen = nearest[: max(inside, 6)]
    tau = fixes.time_s[chosen] - time_s
    degree = 2 if len(chosen) >= 6 and tau.min() < 0.0 < tau.max() else min(1, len(chosen) - 1)
    design = np.stack([tau**power for power in range(degree + 1)], axis=1)
    p_enu = fixes.p_enu[chosen]
    weight = np.ones(len(chosen))
    for _ in range(20):
        scaled = design * weight[:, None]
        # The ridge is the prior that a car accelerates by some m/s^2 only.
        ridge = np.diag([0.0, 1e-4, 0.05][: degree + 1])
        coefficients = np.linalg.solve(scaled.T @ design + ridge, scaled.T @ p_enu)
        residual = np.linalg.norm((p_enu - design @ coefficients)[:, :2], axis=1)
        weight = 1.0 / (1.0 + (residual / _JITTER_M) ** 2)
    velocity = coefficients[1, :2] if degree else np.zeros(2)
    driven = np.outer(tau, velocity)
    heading = float(np.arctan2(velocity[1], velocity[0]))
    sigma = _sigma_heading(_rotate(driven, -heading), p_enu[:, :2], heading, coefficients[0, :2], weight)
    lever = np.append(_rotate(np.array(fixes.antenna_base[:2]), heading), fixes.antenna_base[2])
    return GnssPrior(coefficients[0] - lever, np.median(fixes.sigma_m[chosen], axis=0), heading, sigma)


def _rotate(xy: np.ndarray, angle_rad: float) -> np.ndarray:
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return xy @ np.array([[cos, sin], [-sin, cos]])


def _weighted_median(values: np.ndarray, weight: np.ndarray) -> float:
    order = np.argsort(values)
    cumulative = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(cumulative, 0.5 * cumulative[-1])])
