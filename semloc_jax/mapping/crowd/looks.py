"""Who would have seen each thing, and who did (room: mapping; host).

In: Fused. Out: Looks at things and at the stations of lines, one column for each drive that can be trusted.
"""

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from semloc_jax.evaluation.map_shapes import POST_NAMES, kind_of
from semloc_jax.geometry import polyline
from semloc_jax.mapping.crowd.correction import Correction
from semloc_jax.mapping.crowd.facing import passes_its_face
from semloc_jax.mapping.crowd.fusion import Fused
from semloc_jax.mapping.crowd.ground import Ground
from semloc_jax.mapping.crowd.looks_chain import Looks, PresenceConfig
from semloc_jax.mapping.crowd.sights import CROWD
from semloc_jax.maps import Belief

_BANDS_M = (3.0, 6.0, 10.0)
"""How far beside the way: the chance that a drive shows a thing falls with it."""
_DAY_S = 86400.0
_LEAST_STEP, _MOST_STEP = 0.1, 50.0
_STRANDS_M = 0.6
"""Lines no farther apart are painted as one: not every drive tells them apart; with half the step of places."""
_INSIDE = 0.8
"""Share of the half length at which the ends of a thing must lie in the area that was looked at."""
_HIGH_M = 4.5
"""What hangs higher above the ground lets every vehicle pass below."""


def looks_of(fused: Fused, config: PresenceConfig) -> tuple[Looks, Looks, list[int]]:
    """Looks at things, at stations of all lines in their order, and the places of the drives that the columns are.

    Args:
        fused: drives in the order of time.
        config: how things come and go.
    """
    rows = [k for k, d in enumerate(fused.drives) if not d.sights.is_base and k not in fused.distrusted]
    steps = _steps([fused.drives[k].sights.when_s for k in rows], config.days)
    return _things(fused, rows, steps, config), _stations(fused, rows, steps, config), rows


def _things(fused: Fused, rows: list[int], steps: np.ndarray, config: PresenceConfig) -> Looks:
    world = fused.world
    n = len(world.kind)
    _, kind = np.unique(world.kind.astype(str), return_inverse=True) if n else (np.zeros(0), np.zeros(0, int))
    tip = _INSIDE * world.half_m[:, :1] * world.along
    places = np.stack([world.centre, world.centre - tip, world.centre + tip], axis=1)
    visible, seen, band = (np.zeros((n, len(rows)), dtype=t) for t in (bool, bool, int))
    is_post = np.isin(world.kind.astype(str), sorted(POST_NAMES))
    elements = [fused.drives[place].sights.things.elements[row] for place, row in world.source.tolist()]
    faces = np.array([np.zeros(2) if e.normal is None else e.normal[:2] for e in elements]).reshape(-1, 2)
    for column, k in enumerate(rows):
        drive = fused.drives[k]
        back = drive.back(places.reshape(-1, 2))
        inside = _within(drive.sights.area, back).reshape(n, 3).all(axis=1)
        visible[:, column] = np.where(is_post, _within(drive.sights.upright_area, back).reshape(n, 3)[:, 0], inside)
        visible[:, column] &= passes_its_face(drive.moved(drive.sights.way), world.centre, faces)
        seen[fused.seen[k].pairs[:, 1], column] = True
        band[:, column] = _band(drive, back.reshape(n, 3, 2)[:, 0])
    beliefs = [fused.drives[place].sights.things.beliefs[row] for place, row in world.source.tolist()]
    based = _based(fused, world.source[:, 0], beliefs, config)
    group = kind[:, None] * (len(_BANDS_M) + 1) + band
    low = np.array([[*e.points[:, :2].mean(axis=0), e.points[:, 2].min()] for e in elements]).reshape(-1, 3)
    hangs = low[:, 2] - Ground.of(fused).height_m(low[:, :2]) > _HIGH_M
    hidden = np.where(based[0] & hangs, config.hidden, 0.0)
    return Looks(visible, seen, group.reshape(n, len(rows)), kind, based[0], steps, *based[1:], hidden, world.centre)


def _stations(fused: Fused, rows: list[int], steps: np.ndarray, config: PresenceConfig) -> Looks:
    lines = fused.world.lines
    names = sorted({line.kind for line in lines})
    first = np.cumsum([0, *(len(line.reference) for line in lines)])
    xy = np.concatenate([np.zeros((0, 2)), *(line.xy for line in lines)])
    kind = np.concatenate([np.zeros(0, int), *(np.full(len(line.xy), names.index(line.kind)) for line in lines)])
    source = np.concatenate([np.zeros(0, int), *(np.full(len(line.xy), line.source[0]) for line in lines)])
    visible, seen, band = (np.zeros((len(xy), len(rows)), dtype=t) for t in (bool, bool, int))
    for column, k in enumerate(rows):
        drive, own = fused.drives[k], fused.seen[k]
        back = drive.back(xy)
        seen[first[own.line] + own.station, column] = True
        visible[:, column] = _within(drive.sights.area, back) & ~(_is_beside(drive, names, kind, xy) & ~seen[:, column])
        band[:, column] = _band(drive, back)
    held = [{e.id: b for e, b in drive.sights.lines} for drive in fused.drives]
    beliefs = [held[line.source[0]][line.source[1].id] for line in lines for _ in line.reference]
    based = _based(fused, source, beliefs, config)
    group = kind[:, None] * (len(_BANDS_M) + 1) + band
    hidden = np.zeros(len(xy))
    return Looks(visible, seen, group.reshape(len(xy), len(rows)), kind, based[0], steps, *based[1:], hidden)


def _is_beside(
    drive: Correction, names: list[str], kind: Int[np.ndarray, " n"], xy: Float[np.ndarray, "n 2"]
) -> Bool[np.ndarray, " n"]:
    """Whether a drive shows a line of its kind close beside a place: of two strands it may tell one."""
    beside = np.zeros(len(xy), dtype=bool)
    for row, name in enumerate(names):
        shown = [drive.moved_line(line) for line in drive.placed_lines if kind_of(line.element) == name]
        own = np.flatnonzero(kind == row)
        if shown and len(own):
            beside[own] = cKDTree(np.concatenate(shown)).query(xy[own], distance_upper_bound=_STRANDS_M)[0] < _STRANDS_M
    return beside


def _within(area: shapely.Geometry, xy: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
    shapely.prepare(area)
    return shapely.contains_xy(area, xy[:, 0], xy[:, 1])


def _band(drive: Correction, xy: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, " n"]:
    if not len(xy):
        return np.zeros(0, dtype=np.int64)
    return np.searchsorted(_BANDS_M, polyline.nearest(drive.sights.way, xy).distance_m)


def _based(
    fused: Fused, places: np.ndarray, beliefs: list[Belief], config: PresenceConfig
) -> tuple[Bool[np.ndarray, " n"], Float[np.ndarray, " n"], Int[np.ndarray, "n 2"]]:
    """What is of the base map, how likely all was there before, how many drives had seen and missed it."""
    is_based = (places == 0) & (bool(fused.drives) and fused.drives[0].sights.is_base)
    before = np.full(len(places), config.unmapped if fused.is_surveyed else config.born)
    counted = np.zeros((len(places), 2), dtype=np.int64)
    for k in np.flatnonzero(is_based).tolist():
        belief, before[k] = beliefs[k], config.based
        if belief.provenance == CROWD:
            before[k], counted[k] = min(belief.existence, config.based), (belief.num_seen, belief.num_missed)
    return is_based, before, counted


def _steps(when_s: list[float | None], days: float) -> np.ndarray:
    """Time before each drive in steps; 1 where either has no date."""
    steps = np.ones(len(when_s))
    for k in range(1, len(when_s)):
        before, after = when_s[k - 1], when_s[k]
        if before is not None and after is not None:
            steps[k] = np.clip((after - before) / (_DAY_S * days), _LEAST_STEP, _MOST_STEP)
    return steps
