"""Where the upright things stand that a drive saw: crossings of bearings (room: mapping; host).

In: Sightings of one class. Out: Standing list: place, covariance, heights, the sightings of each.
Every sighting votes for the places along its bearing; where most frames agree a thing is solved for, its sightings are
taken away, and so on. A crossing of bearings to different things is told by its heights, which do not agree.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from semloc_jax.mapping.sightings import column
from semloc_jax.structs import ElementClass

HeightOf = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]]
"""Height of the road at places [m]."""

_CELL_M = 0.5
_STEP_M = 0.125
_ROUNDS = 8
_MOST_THINGS = 2000
_MOST_AT_ONCE = 64
"""Places tried together. Where things end, hundreds of crossings of bearings to different things follow each other."""
_LEAST_TOLD = 3
_MAY_BE_CUT = (float(ElementClass.POLE), float(ElementClass.PILLAR))
_ENDS = (("low", "is_foot", 0.1), ("high", "is_top", 0.9))
"""Columns of the ends of a sighting, and the quantile of what is seen where no end is."""

_Meeting = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Rows of the sightings that meet, their place [m], and its information [1/m^2]."""


@dataclass(frozen=True)
class TriangulationConfig:
    """When bearings meet. All values are ours.

    Args:
        range_m: nearest and farthest place that a sighting tells.
        min_frames: frames that must agree.
        min_parallax_deg: spread of the bearings.
        gate_sigmas: a sighting farther off is one of another thing.
        place_m: standard deviation of the way that the frames share.
        most_sigma_m: standard deviation of a place beyond which it helps nobody.
        most_height_m: spread of the heights that sightings of one end tell.
    """

    range_m: tuple[float, float] = (2.0, 45.0)
    min_frames: int = 5
    min_parallax_deg: float = 6.0
    gate_sigmas: float = 3.5
    place_m: float = 0.05
    most_sigma_m: float = 0.3
    most_height_m: float = 0.4


@dataclass(frozen=True)
class Standing:
    """One thing.

    Attributes:
        xy: its place [m].
        covariance: of the place [m^2].
        foot_m: height of its low end, as the sightings show it.
        top_m: height of its high end.
        width_m: its width.
        knows_foot: whether its low end was seen.
        rows: its sightings.
    """

    xy: Float[np.ndarray, " 2"]
    covariance: Float[np.ndarray, "2 2"]
    foot_m: float
    top_m: float
    width_m: float
    knows_foot: bool
    rows: Int[np.ndarray, " k"]


def stand(sightings: Float[np.ndarray, "n 13"], config: TriangulationConfig | None = None) -> list[Standing]:
    """Every thing of one class that enough frames agree on, the one with most frames first.

    Args:
        sightings: rows, see `sightings.COLUMNS`.
        config: None for the defaults.
    """
    config = config or TriangulationConfig()
    if not len(sightings):
        return []
    owner, cell, places = _votes(sightings, config)
    if not len(places):  # no bearing crosses enough others
        return []
    free, is_open = np.ones(len(sightings), bool), np.ones(len(places), bool)
    found: list[Standing] = []
    at_once = 1
    while len(found) < _MOST_THINGS:
        count = np.bincount(cell, free[owner], minlength=len(places)) * is_open
        best = np.argsort(-count, kind="stable")[:at_once]
        best = best[count[best] >= config.min_frames]
        if not len(best):
            break
        at_once = min(2 * at_once, _MOST_AT_ONCE)
        for place, meeting in zip(best, _meetings(sightings, np.flatnonzero(free), places[best], config), strict=True):
            thing = None if meeting is None else _checked(sightings, *meeting, config)
            if thing is not None:  # the others were solved with its sightings
                free[thing.rows] = False
                found.append(thing)
                at_once = 1
                break
            is_open[place] = False
    return found


def _votes(sightings: np.ndarray, config: TriangulationConfig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sighting and cell of every vote, and the middle of each cell [m]."""
    s = np.arange(*config.range_m, _STEP_M)
    bearing = column(sightings, "bearing")[:, None]
    xy = sightings[:, 2:4][:, None] + s[None, :, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    flat = np.floor(xy / _CELL_M).astype(np.int64).reshape(-1, 2)
    owner = np.repeat(np.arange(len(sightings)), len(s))
    low = flat.min(axis=0)
    columns = int(np.ptp(flat[:, 0])) + 1
    key = (flat[:, 1] - low[1]) * columns + flat[:, 0] - low[0]
    # A sighting votes once for a cell.
    pairs = np.unique(owner * (key.max() + 1) + key)
    owner, key = pairs // (key.max() + 1), pairs % (key.max() + 1)
    keys, cell, count = np.unique(key, return_inverse=True, return_counts=True)
    kept = count[cell] >= config.min_frames
    used, cell = np.unique(cell[kept], return_inverse=True)
    places = (np.stack([keys[used] % columns, keys[used] // columns], axis=1) + low + 0.5) * _CELL_M
    return owner[kept], cell, places


def _meetings(
    sightings: np.ndarray, free: np.ndarray, starts: np.ndarray, config: TriangulationConfig
) -> list[_Meeting | None]:
    """Where bearings meet near each of some places: None where they do not.

    Bearings miss the place by `off_m`, across them along `normal`; `range_m` is the way along them.
    """
    near, is_there = _near(sightings, free, starts, config.range_m[1])
    bearing, sigma_rad = (column(sightings, name)[near] for name in ("bearing", "sigma"))
    along = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    normal = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    xy, information, member = starts, np.zeros((len(starts), 2, 2)), is_there
    meets = np.ones(len(starts), bool)
    for k in range(_ROUNDS):
        offset = xy[:, None] - sightings[near, 2:4]
        off_m, range_m = (offset * normal).sum(axis=-1), (offset * along).sum(axis=-1)
        sigma_m = np.hypot(sigma_rad * np.abs(range_m), config.place_m)
        # The first rounds take in what votes for the cell.
        gate = config.gate_sigmas * sigma_m + (_CELL_M if k < 2 else 0.0)
        member = is_there & (np.abs(off_m) < gate) & (range_m > 0.5 * config.range_m[0])
        meets &= member.sum(axis=1) >= config.min_frames
        weight = member / sigma_m**2 / (1.0 + (off_m / sigma_m) ** 2)
        information = np.swapaxes(normal * weight[..., None], 1, 2) @ normal
        pull = np.swapaxes(normal, 1, 2) @ (weight * off_m)[..., None]
        xy = xy - np.linalg.solve(information + 1e-6 * np.eye(2), pull)[..., 0]
    meets &= np.linalg.norm(xy - starts, axis=1) <= 4.0 * _CELL_M
    return [(near[i][member[i]], xy[i], information[i]) if meets[i] else None for i in range(len(starts))]


def _near(sightings: np.ndarray, free: np.ndarray, places: np.ndarray, most_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Sightings from around each place [k m], and which of them are no filling [k m]."""
    is_near = np.linalg.norm(sightings[free, 2:4] - places[:, None], axis=-1) < most_m
    count = is_near.sum(axis=1)
    is_there = np.arange(count.max()) < count[:, None]
    near = np.full(is_there.shape, free[0])
    near[is_there] = free[np.nonzero(is_near)[1]]
    return near, is_there


def _checked(
    sightings: np.ndarray, rows: np.ndarray, xy: np.ndarray, information: np.ndarray, config: TriangulationConfig
) -> Standing | None:
    own = sightings[rows]
    bearing = column(own, "bearing")
    middle = np.angle(np.exp(1j * bearing).mean())
    turn = np.angle(np.exp(1j * (bearing - middle)))
    num_frames = len(np.unique(column(own, "frame")))
    if num_frames < config.min_frames or np.ptp(turn) < np.deg2rad(config.min_parallax_deg):
        return None
    range_m = np.linalg.norm(own[:, 2:4] - xy, axis=1)
    (foot_m, foot_off_m), (top_m, top_off_m) = (_end(own, range_m, *names) for names in _ENDS)
    # A pole or a pillar is cut by much that stands before it; a board is seen whole or not at all.
    if column(own, "label")[0] not in _MAY_BE_CUT and max(foot_off_m, top_off_m) > config.most_height_m:
        return None
    # Errors of the way are shared by neighbouring frames: a metre of way tells one thing once.
    way_m = float(np.linalg.norm(np.diff(_by_frame(own), axis=0), axis=1).sum())
    shared = max(len(own) / max(way_m, 1.0), 1.0)
    covariance = np.linalg.inv(information / shared)
    if np.linalg.eigvalsh(covariance)[-1] > config.most_sigma_m**2:
        return None
    return Standing(
        xy,
        covariance,
        foot_m,
        top_m,
        float(np.median((column(own, "width") * range_m)[range_m <= np.median(range_m)])),
        foot_off_m <= config.most_height_m,
        rows,
    )


def _by_frame(rows: np.ndarray) -> np.ndarray:
    """Places of the camera, in the order of the frames."""
    return rows[np.argsort(column(rows, "frame"), kind="stable")][:, 2:4]


def _end(rows: np.ndarray, range_m: np.ndarray, angle: str, is_end: str, quantile: float) -> tuple[float, float]:
    """Height of one end [m] as most sightings tell it, near ones more, and its spread; else where what is seen ends."""
    height_m = column(rows, "z_m") + range_m * np.tan(column(rows, angle))
    told = column(rows, is_end) > 0.5
    if told.sum() < _LEAST_TOLD:
        return float(np.quantile(height_m, quantile)), np.inf
    height_m, range_m = height_m[told], range_m[told]
    order = np.argsort(height_m)
    weight = np.cumsum(1.0 / np.maximum(range_m[order], 2.0) ** 2)
    middle_m = float(height_m[order][int(np.searchsorted(weight, 0.5 * weight[-1]))])
    return middle_m, float(1.5 * np.median(np.abs(height_m - middle_m)))
