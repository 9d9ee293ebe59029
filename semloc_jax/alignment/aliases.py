"""Where else the map looks as it does here: its own periods along and across the road (room: alignment; host).

In: map samples around a pose. Out: shifts of the pose (forward, left [m]) at which the map repeats itself.
Dashes, posts and slots come back after their period, lanes after their width: a pose that is right up to a period
explains the masks nearly as well, and a search that never looked there cannot know that it has chosen.
"""

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2


@dataclass(frozen=True)
class AliasConfig:
    """How far and how finely the map is compared with itself. All values are ours."""

    cell_m: float = 0.25
    along_m: float = 40.0
    """Largest shift along the road."""
    least_reach_m: float = 20.0
    """Shifts up to this are looked at, however sure the prior is: a period of freeway dashes."""
    across_m: float = 8.0
    """Largest shift across it."""
    least_along_m: float = 1.5
    least_across_m: float = 1.5
    """A smaller shift is the same place, which a solve finds by itself."""
    num_along: int = 8
    num_across: int = 4
    least_share: float = 0.15
    """Peaks lower than this share of the agreement at no shift are none."""
    lanes_m: tuple[float, ...] = (3.0, 3.5)
    """Shifts to both sides that are tried on every road."""


def alias_shifts(
    points_xy: np.ndarray,
    tangents_xy: np.ndarray,
    channel: np.ndarray,
    length_m: np.ndarray,
    T_local_base: np.ndarray,
    config: AliasConfig,
) -> np.ndarray:
    """Shifts (forward, left [m]) in the vehicle frame at which the map repeats itself, strongest first, float[k 2].

    Args:
        points_xy: float[n 2], samples of the map in view [m].
        tangents_xy: float[n 2], directions of their contours; their common one is the direction of the road.
        channel: int[n], classes that masks tell apart.
        length_m: float[n], length of contour that each sample stands for.
        T_local_base: float[4 4], the pose.
        config: Reach and resolution.
    """
    if len(points_xy) == 0:
        return np.zeros((0, 2))
    road = road_direction(tangents_xy, length_m, T_local_base[:2, 0])
    frame = np.array([[road[0], road[1]], [-road[1], road[0]]])
    overlap = _overlap(*_drawn(points_xy @ frame.T, tangents_xy @ frame.T, channel, length_m, config.cell_m), config)
    num = round(config.along_m / config.cell_m), round(config.across_m / config.cell_m)
    # A band of half a metre: lines are not quite straight.
    band = round(0.5 / config.cell_m)
    along = overlap[:, num[1] - band : num[1] + band + 1].max(axis=1)
    across = overlap[num[0] - band : num[0] + band + 1].max(axis=0)
    whole = max(float(overlap[num[0], num[1]]), 1e-9)
    own, beside = along / whole, across / whole
    shifts = [(s, 0.0) for s in _peaks(own, config, config.least_along_m, config.num_along)]
    shifts += [(0.0, s) for s in _peaks(beside, config, config.least_across_m, config.num_across)]
    known = [(s, 0.0) for s in _shortest(own, config, config.least_along_m)]
    known += [(0.0, s) for s in _shortest(beside, config, config.least_across_m)]
    shifts += [one for one in known if all(np.hypot(*np.subtract(one, s)) > 2.0 * config.cell_m for s in shifts)]
    shifts += [(0.0, side * lane) for lane in config.lanes_m for side in (-1.0, 1.0)]
    vehicle = T_local_base[:2, :2].T @ frame.T
    return np.asarray(shifts) @ vehicle.T


def road_direction(tangents_xy: np.ndarray, length_m: np.ndarray, ahead_xy: np.ndarray) -> np.ndarray:
    """Common direction of contours, float[2] of unit length, to the side that `ahead_xy` looks to."""
    scatter = (tangents_xy * length_m[:, None]).T @ tangents_xy
    values, vectors = np.linalg.eigh(scatter)
    road = vectors[:, -1] if values[-1] > 1.2 * values[0] else ahead_xy / max(np.linalg.norm(ahead_xy), 1e-9)
    return road if road @ ahead_xy >= 0 else -road


def _drawn(
    points: np.ndarray, tangents: np.ndarray, channel: np.ndarray, length_m: np.ndarray, cell_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, channels and lengths of samples drawn as the contour that each stands for: a solid line whose samples are
    farther apart than cells would repeat itself after their distance."""
    num = max(int(np.ceil(length_m.max() / cell_m)), 1)
    steps = (np.arange(num) + 0.5) / num - 0.5
    drawn = points[:, None] + (steps[:, None] * length_m[:, None, None]) * tangents[:, None]
    return drawn.reshape(-1, 2), np.repeat(channel, num), np.repeat(length_m / num, num)


def _overlap(points: np.ndarray, channel: np.ndarray, length_m: np.ndarray, config: AliasConfig) -> np.ndarray:
    """How much contour falls on contour of its class at each shift, float[2a+1 2b+1], by FFT of the plan view."""
    cell = np.floor((points - points.min(axis=0)) / config.cell_m).astype(int)
    reach = round(config.along_m / config.cell_m), round(config.across_m / config.cell_m)
    size = tuple(next_fast_len(int(cell[:, axis].max()) + 1 + reach[axis], True) for axis in (0, 1))
    power: np.ndarray | float = 0.0
    for own in np.unique(channel):
        rows = channel == own
        where = cell[rows, 0] * size[1] + cell[rows, 1]
        plan = np.bincount(where, length_m[rows], size[0] * size[1]).reshape(size)
        spectrum = rfft2(plan.astype(np.float32))
        power = power + spectrum.real**2 + spectrum.imag**2
    return irfft2(power, s=size)[np.ix_(*(np.arange(-most, most + 1) for most in reach))]


def _peaks(profile: np.ndarray, config: AliasConfig, least_m: float, most: int) -> list[float]:
    """Shifts [m] of the local maxima that stand out most, those near no shift left out: long lines overlap the more the
    smaller a shift is, which is no period."""
    middle = len(profile) // 2
    inner = profile[1:-1]
    at = np.flatnonzero((inner >= profile[:-2]) & (inner > profile[2:]) & (inner > config.least_share)) + 1
    at = at[np.abs(at - middle) * config.cell_m >= least_m]
    prominence = np.array([_prominence(profile, k) for k in at.tolist()])
    return [float(k - middle) * config.cell_m for k in at[np.argsort(-prominence, kind="stable")][:most]]


def _shortest(profile: np.ndarray, config: AliasConfig, least_m: float) -> list[float]:
    """The shortest period to both sides [m], one slot aside, which longer ones may hide: of lines thinner than a cell
    that come back between two cells each holds a part, so cells are taken with their neighbours."""
    whole = np.convolve(profile, (0.5, 1.0, 0.5), mode="same")
    found = np.array(_peaks(whole / whole.max(), config, least_m, len(profile)))
    sides = (found[found > 0.0], -found[found < 0.0])
    return [sign * float(side.min()) for sign, side in zip((1.0, -1.0), sides, strict=True) if len(side)]


def _prominence(profile: np.ndarray, at: int) -> float:
    """How far one has to go down from a maximum before a higher place is reached, on the side where it is less."""
    lowest = []
    for side in (profile[at::-1], profile[at:]):
        higher = np.flatnonzero(side > profile[at])
        lowest.append(side[: higher[0] if len(higher) else len(side)].min())
    return float(profile[at] - max(lowest))
