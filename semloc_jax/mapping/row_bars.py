"""Bars along the entrance of rows of slots that no stroke showed (room: mapping; host).

In: rows and their lines, looks at slot lines. Out: the same with the bars that the looks show where one is due.
A bar of 12 cm across the aisle is smeared to a quarter of the looks at each place, too few to follow a stroke; all
looks along a bar together show it clearly, once those that were seen tell where it begins and how long it is.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.mapping.row_lines import PaintAt
from semloc_jax.mapping.slot_rows import Drawn, MappedRow, RowPlace
from semloc_jax.maps import MapElement

_STEP_M = 0.05
_FROM_DIVIDER_M = 0.08
"""From a divider on its own smear is left out; ours."""
_AROUND_M, _OFF_M = 0.35, 0.1
"""So far before and behind a bar is bare road, and so far its paint may lie off the entrance; ours."""
_LEAST_SHARE, _CLEAR = 0.12, 3.0
"""How often the looks along a bar must show it, and how much more often than the bare road beside it; ours."""
_LEAST_KNOWN, _ALIKE_M = 3, 0.08
"""So many bars that agree so well tell how long bars are; ours."""
_BEYOND = 0.6
"""Behind its end the road shows at most this share of what the bar does; ours."""


class _Side(NamedTuple):
    """Where a bar is due: one side of a divider."""

    place: int
    s_m: float
    """Of the divider along the entrance."""
    sign: int
    room_m: float
    """Up to the next divider; infinite beside the last one."""


def with_bars(drawn: Drawn, paint_at: PaintAt | None) -> Drawn:
    """Rows and lines with the bars that are due beside their dividers and that the looks show.

    Args:
        drawn: rows, and all lines.
        paint_at: looks at slot lines; None where there are none, which leaves all as it is.
    """
    if paint_at is None:
        return drawn
    reaches = [_reaches(row, drawn.lines) for row in drawn.rows]
    every = [reach for own in reaches for reach in own.values() if reach is not None]
    lines, rows = list(drawn.lines), []
    for row, own in zip(drawn.rows, reaches, strict=True):
        reach_m = _usual([reach for reach in own.values() if reach is not None]) or _usual(every)
        made: dict[_Side, MapElement] = {}
        for side, reach in own.items() if reach_m is not None else ():
            if reach is None and _shows(row, side, reach_m, paint_at):
                made[side] = _bar(row, side, reach_m, lines)
        lines += made.values()
        rows.append(_told_by(row, made))
    return Drawn(lines, rows)


def _reaches(row: MappedRow, lines: Sequence[MapElement]) -> dict[_Side, float | None]:
    """How far from the middle of each divider the bar on either side reaches [m]; None where there is no bar, and no
    entry where the end of one was not seen."""
    half = 0.5 * row.width_m
    bars = []
    for line in lines:
        s_m, t_m = row.inside(line.points[[0, -1], :2])
        if np.abs(t_m - half).max() < _OFF_M:
            order = np.argsort(s_m)
            bars.append((*s_m[order], *np.array(line.true_ends)[order]))
    s_m = [place.s_m for place in row.places]
    found: dict[_Side, float | None] = {}
    for k, s in enumerate(s_m):
        for sign in (-1, 1):
            beside = k + sign
            room_m = abs(s_m[beside] - s) if 0 <= beside < len(s_m) else np.inf
            near = [bar for bar in bars if _begins(bar, s, sign) <= 3.0 * half < _ends(bar, s, sign)]
            if not near:
                found[_Side(k, s, sign, room_m)] = None
            elif near[0][3 if sign > 0 else 2]:
                found[_Side(k, s, sign, room_m)] = _ends(near[0], s, sign)
    return found


def _begins(bar: tuple, s_m: float, sign: int) -> float:
    return (bar[0] - s_m) if sign > 0 else (s_m - bar[1])


def _ends(bar: tuple, s_m: float, sign: int) -> float:
    return float(bar[1] - s_m) if sign > 0 else float(s_m - bar[0])


def _usual(reaches_m: Sequence[float]) -> float | None:
    """How far most bars reach; None where too few agree."""
    if len(reaches_m) < _LEAST_KNOWN:
        return None
    reach_m = float(np.median(reaches_m))
    alike = np.abs(np.array(reaches_m) - reach_m) < _ALIKE_M
    return reach_m if alike.sum() >= max(_LEAST_KNOWN, 0.5 * len(alike)) else None


def _shows(row: MappedRow, side: _Side, reach_m: float, paint_at: PaintAt) -> bool:
    """Whether the looks at a bar that is due show one that ends where it should."""
    if reach_m > side.room_m - row.width_m:
        return False
    first_m = 0.5 * row.width_m + _FROM_DIVIDER_M
    on = np.arange(first_m, reach_m - _STEP_M, _STEP_M)
    behind = np.arange(reach_m + 2.0 * _STEP_M, min(2.0 * reach_m, side.room_m - reach_m), _STEP_M)
    if len(on) < 4:
        return False
    inner, outer = np.array_split(on, 2)
    t_m, share = _profile(row, side, on, paint_at)
    off_m = np.abs(t_m - 0.5 * row.width_m)
    peak = int(np.where(off_m <= _OFF_M, share, 0.0).argmax())
    bare = float(share[off_m >= _AROUND_M - 2.0 * _STEP_M].mean())
    if share[peak] < max(_LEAST_SHARE, _CLEAR * bare):
        return False
    halves = [_profile(row, side, part, paint_at)[1][peak] for part in (inner, outer)]
    beyond = _profile(row, side, behind, paint_at)[1][peak] if len(behind) >= 4 else 0.0
    return bool(min(halves) >= 0.5 * share[peak] and beyond <= _BEYOND * share[peak])


def _profile(
    row: MappedRow, side: _Side, from_divider_m: np.ndarray, paint_at: PaintAt
) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, " t"]]:
    """Steps across the entrance [m], and the share of the looks there that show a line."""
    t_m = 0.5 * row.width_m + np.arange(-_AROUND_M, _AROUND_M + 0.5 * _STEP_M, _STEP_M)
    normal = np.array([-row.along[1], row.along[0]])
    s_m = side.s_m + side.sign * from_divider_m
    places = row.origin + s_m[:, None, None] * row.along + t_m[None, :, None] * normal
    weight, hits = (part.reshape(places.shape[:2]).sum(axis=0) for part in paint_at(places.reshape(-1, 2)))
    return t_m, np.divide(hits, weight, out=np.zeros(len(t_m)), where=weight > 0.0)


def _bar(row: MappedRow, side: _Side, reach_m: float, lines: Sequence[MapElement]) -> MapElement:
    place = row.places[side.place]
    divider = next(line for line in lines if line.id == place.ids[0])
    half, normal = 0.5 * row.width_m, np.array([-row.along[1], row.along[0]])
    s_m = side.s_m + side.sign * np.array([half, reach_m])
    xy = row.origin + s_m[:, None] * row.along + half * normal
    points = np.column_stack([xy, np.full(2, place.z_m)])
    # One bar may show two places where no divider was seen.
    name = f"{divider.id}_bar_{side.place}_{'left' if side.sign > 0 else 'right'}"
    return replace(divider, id=name, points=points, width_m=row.width_m, true_ends=(True, True))


def _told_by(row: MappedRow, made: dict[_Side, MapElement]) -> MappedRow:
    """The row whose places are shown by the bars, too."""
    more: dict[int, tuple[str, ...]] = {}
    for side, bar in made.items():
        more[side.place] = (*more.get(side.place, ()), bar.id)
    places = tuple(RowPlace(p.s_m, (*p.ids, *more.get(k, ())), p.z_m) for k, p in enumerate(row.places))
    return replace(row, places=places)
