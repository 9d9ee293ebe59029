"""Rows of parking slots: lines by slots drawn as what they are together (room: mapping; host).

In: slot lines as they were followed, the way of the vehicle. Out: rows, and the lines drawn anew: dividers from the
entrance to the back, bars along the entrance from divider to divider, one line along the back.
A pillar or a vehicle hides the mouth of a divider, a worn mask cuts it in pieces; what is seen of its neighbours says
where the entrance and the back of the row run, and the bars at the entrance where a divider stands.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.mapping.row_lines import (
    DividerPiece,
    PaintAt,
    back_in_paint,
    back_of,
    bars_along,
    crossings,
    ends_in_paint,
    evened,
    line_through,
    pieces_of,
)
from semloc_jax.mapping.slots import Divider, SlotConfig, divider_groups, find_dividers, split_double
from semloc_jax.maps import MapElement


@dataclass(frozen=True)
class RowConfig:
    """What belongs to a row of slots. All values are ours.

    Args:
        bar_m: shortest and longest bar along the entrance.
        off_m: bars and mouths are no farther from the entrance, pieces of the line at the back from the back.
        askew_deg: lines of a row are turned no more against it.
        piece_m: shortest piece of a divider.
        beside_m: pieces of one divider lie no farther beside each other.
        hidden_m: longest part of a divider at its mouth that something may hide.
        snap_m: ends nearer than this to the back of the row end there.
        parallel_deg: rows whose mouths say that they are turned no more against each other are parallel.
        square_deg: dividers nearer to a right angle with the entrance stand at one.
        even_m: how far dividers are off even steps where they are painted in such.
        back_m: length of paint that shows where the back of a row is.
    """

    bar_m: tuple[float, float] = (0.35, 2.8)
    off_m: float = 0.25
    askew_deg: float = 8.0
    piece_m: float = 0.5
    beside_m: float = 0.25
    hidden_m: float = 2.0
    snap_m: float = 0.6
    parallel_deg: float = 4.0
    square_deg: float = 3.0
    even_m: float = 0.02
    back_m: float = 2.0


class RowPlace(NamedTuple):
    """Where a divider of a row stands."""

    s_m: float
    """Along the entrance."""
    ids: tuple[str, ...]
    """Lines that show it; the divider first where it was seen."""
    z_m: float


@dataclass(frozen=True)
class MappedRow:
    """A row of slots.

    Attributes:
        origin: `float64[2]` on the outer rim of the entrance [m].
        along: unit `float64[2]` along the entrance, the slots to its left.
        inward: unit `float64[2]` along the dividers.
        width_m: of its lines.
        depth_m: along a divider to the middle of the line at the back; None where nothing shows it.
        places: of its dividers, in order.
    """

    origin: Float[np.ndarray, " 2"]
    along: Float[np.ndarray, " 2"]
    inward: Float[np.ndarray, " 2"]
    width_m: float
    depth_m: float | None = None
    places: tuple[RowPlace, ...] = ()

    def at(self, s_m: float, t_m: float = 0.0) -> Float[np.ndarray, " 2"]:
        """The place so far along the entrance, and so far behind it along a divider."""
        return self.origin + s_m * self.along + t_m * self.inward

    def inside(self, xy: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """How far along the entrance and behind it points are [m]; the inverse of `at`."""
        s_m, t_m = np.linalg.solve(np.stack([self.along, self.inward], axis=1), (np.asarray(xy) - self.origin).T)
        return s_m, t_m

    def dividers(self, kept: set[str]) -> list[Divider]:
        """The places that lines which stayed show, as dividers of the depth of the row."""
        found = []
        for place in self.places:
            ids = [name for name in place.ids if name in kept]
            if ids:
                known, depth_m = self.depth_m is not None, self.depth_m or 0.0
                found.append(Divider(ids[0], self.at(place.s_m), self.inward, depth_m, known, place.z_m))
        return found


class Drawn(NamedTuple):
    """Lines by slots after their rows were found."""

    lines: list[MapElement]
    rows: list[MappedRow]


def draw_rows(
    lines: Sequence[MapElement],
    way: Float[np.ndarray, "n 2"],
    paint_at: PaintAt | None = None,
    slots: SlotConfig | None = None,
    config: RowConfig | None = None,
) -> Drawn:
    """The rows among slot lines, and all lines, those of rows drawn anew; ids stay unique.

    Args:
        lines: slot lines.
        way: where the vehicle drove [m]: slots open to it.
        paint_at: looks at slot lines; None where there are none but the lines.
        slots: what makes a slot.
        config: None for the defaults.
    """
    slots, config = slots or SlotConfig(), config or RowConfig()
    whole = split_double(lines, find_dividers(lines, way, slots), slots)
    left = {line.id: line for line in whole}
    drawn: list[MapElement] = []
    rows: list[MappedRow] = []
    for group in divider_groups(find_dividers(whole, way, slots), slots):
        members = [divider for divider in group if divider.id in left]
        if len(members) < 2:
            continue
        row = _entrance(members, left, rows, config)
        s_m = _grown(row, members, left, config)
        row = _with_depth(row, s_m, members, left, paint_at, slots, config)
        made, used, row = _drawn_anew(row, _beyond(s_m), left, config)
        if len(row.places) >= 2:
            left = {name: line for name, line in left.items() if name not in used}
            drawn += made
            rows.append(row)
    return Drawn([*left.values(), *drawn], rows)


def _entrance(
    members: list[Divider], lines: dict[str, MapElement], rows: list[MappedRow], config: RowConfig
) -> MappedRow:
    """The line through the mouths of the dividers and the outer rims of the bars between them.

    A row of which little was seen runs as the longest of those before that it may be parallel to.
    """
    mouths = np.array([divider.mouth for divider in members])
    inward = np.median([divider.inward for divider in members], axis=0)
    inward = inward / np.linalg.norm(inward)
    width_m = float(np.median([lines[divider.id].width_m for divider in members]))
    points, beside = mouths, _parallel(line_through(mouths)[1], rows, config)
    for _ in range(3):
        origin, along = line_through(points, beside)
        if along[0] * inward[1] - along[1] * inward[0] < 0.0:
            along = -along
        row = MappedRow(origin, along, inward, width_m)
        outward = np.array([along[1], -along[0]])
        bars = bars_along(
            row, _beyond(row.inside(mouths)[0]), list(lines.values()), config.bar_m, config.off_m, config.askew_deg
        )
        # A short bar seen from afar is drawn askew about its middle.
        rims = [bar.points[[0, -1], :2].mean(axis=0) + 0.5 * width_m * outward for bar in bars]
        points = np.vstack([mouths, *rims])
    if abs(np.degrees(np.arcsin(np.clip(inward @ along, -1.0, 1.0)))) < config.square_deg:
        row = replace(row, inward=np.array([-along[1], along[0]]))
    return row


def _parallel(along: np.ndarray, rows: list[MappedRow], config: RowConfig) -> np.ndarray | None:
    """Direction of the longest row that one of about this direction may be parallel to; None where there is none."""
    near = [row for row in rows if abs(row.along @ along) > np.cos(np.deg2rad(config.parallel_deg))]
    if not near:
        return None
    found = max(near, key=lambda row: len(row.places)).along
    return found if found @ along > 0.0 else -found


def _beyond(s_m: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """From one slot before the first divider to one behind the last."""
    s_m = np.sort(s_m)
    step_m = float(np.median(np.diff(s_m)))
    return float(s_m[0]) - 1.2 * step_m, float(s_m[-1]) + 1.2 * step_m


def _grown(
    row: MappedRow, members: list[Divider], lines: dict[str, MapElement], config: RowConfig
) -> Float[np.ndarray, " n"]:
    """Where dividers stand: from where mouths were seen on, divider by divider."""
    s_m = row.inside(np.array([divider.mouth for divider in members]))[0]
    while True:
        span = _beyond(s_m)
        found = [_mean_s(group) for group in pieces_of(row, span, list(lines.values()), config)]
        bars = bars_along(row, span, list(lines.values()), config.bar_m, config.off_m, config.askew_deg)
        found += crossings([np.sort(row.inside(bar.points[[0, -1], :2])[0]) for bar in bars], s_m, row.width_m)
        num = len(s_m)
        for s in found:
            if np.abs(s_m - s).min() > config.beside_m:
                s_m = np.append(s_m, s)
        if len(s_m) == num:
            return np.sort(s_m)


def _with_depth(
    row: MappedRow,
    s_m: Float[np.ndarray, " n"],
    members: list[Divider],
    lines: dict[str, MapElement],
    paint_at: PaintAt | None,
    slots: SlotConfig,
    config: RowConfig,
) -> MappedRow:
    """The row with its depth: of the line along its back, else where its dividers end."""
    is_parallel = float(np.median(np.diff(s_m))) > slots.entrance_m[1]
    around = slots.parallel_divider_m if is_parallel else slots.depth_m
    for told in (back_in_paint, ends_in_paint) if paint_at is not None else ():
        depth_m = told(row, s_m, around, paint_at)
        if depth_m is not None:
            return replace(row, depth_m=depth_m)
    whole = [d.length_m for d in members if d.is_whole and around[0] <= d.length_m <= around[1]]
    ends_m = float(np.median(whole)) if whole else None
    depth_m, paint_m = back_of(row, _beyond(s_m), list(lines.values()), [around], config.askew_deg)
    if paint_m >= config.back_m and (ends_m is None or abs(depth_m - ends_m) < config.snap_m):
        return replace(row, depth_m=depth_m)
    agreeing = [length for length in whole if abs(length - ends_m) < 0.5 * config.off_m]
    # Where as many go on, paint that is out of sight or worn ended the others.
    longer = sum(d.length_m > ends_m + 0.5 * config.off_m for d in members) if whole else 0
    is_end = 2 * len(agreeing) > len(whole) and len(agreeing) > longer
    return replace(row, depth_m=float(np.mean(agreeing)) if is_end else None)


def _drawn_anew(
    row: MappedRow, span: tuple[float, float], lines: dict[str, MapElement], config: RowConfig
) -> tuple[list[MapElement], set[str], MappedRow]:
    """The lines of a row drawn anew, ids of those that they replace, and the row with its places."""
    groups = pieces_of(row, span, list(lines.values()), config)
    taken = {piece.id for group in groups for piece in group}
    free = [line for line in lines.values() if line.id not in taken]
    bars = bars_along(row, span, free, config.bar_m, config.off_m, config.askew_deg)
    ends = {bar.id: np.sort(row.inside(bar.points[[0, -1], :2])[0]) for bar in bars}
    at_m, weight = [_mean_s(group) for group in groups], [sum(p.length_m for p in group) for group in groups]
    for s_m in crossings(list(ends.values()), at_m, row.width_m):
        at_m, weight, groups = [*at_m, s_m], [*weight, config.piece_m], [*groups, []]
    order = np.argsort(at_m, kind="stable")
    groups = [groups[k] for k in order]
    s_m = evened(np.array(at_m)[order], np.array(weight)[order], config.even_m)
    made: list[MapElement] = []
    shown: list[list[str]] = [[] for _ in groups]
    for k, group in enumerate(groups):
        if group:
            made.append(_divider(row, float(s_m[k]), group, lines, config))
            shown[k].append(made[-1].id)
    for bar in bars:
        for part in _cut(row, bar, ends[bar.id], s_m):
            made.append(part)
            touched = np.abs(row.inside(part.points[:, :2])[0][:, None] - s_m).min(axis=0) < row.width_m
            for k in np.flatnonzero(touched):
                shown[k].append(part.id)
    z_m = [
        float(np.mean([lines[p.id].points[0, 2] for p in g])) if g else _height(s, bars, ends)
        for s, g in zip(s_m, groups, strict=True)
    ]
    places = [RowPlace(float(s), tuple(ids), z) for s, ids, z in zip(s_m, shown, z_m, strict=True) if ids]
    back = _back(row, s_m, [line for line in free if line.id not in ends], config)
    used = taken | set(ends) | back.used
    return [*made, *back.lines], used, replace(row, places=tuple(places))


def _height(s_m: float, bars: list[MapElement], ends: dict[str, np.ndarray]) -> float:
    nearest = min(bars, key=lambda bar: abs(float(ends[bar.id].mean()) - s_m))
    return float(nearest.points[:, 2].mean())


def _mean_s(group: list[DividerPiece]) -> float:
    return float(np.average([piece.s_m for piece in group], weights=[piece.length_m for piece in group]))


def _divider(
    row: MappedRow, s_m: float, group: list[DividerPiece], lines: dict[str, MapElement], config: RowConfig
) -> MapElement:
    """A divider from the entrance to the back; an end that nobody saw is none of paint."""
    last = max(group, key=lambda piece: piece.far_m)
    far_m, is_end = last.far_m, False
    if row.depth_m is not None:
        far_m, is_end = row.depth_m, last.far_is_end and far_m > row.depth_m - config.snap_m
    first = max(group, key=lambda piece: piece.length_m)
    points = np.concatenate([lines[piece.id].points for piece in group])
    t_m = row.inside(points[:, :2])[1]
    slope = np.polynomial.Polynomial.fit(t_m, points[:, 2], 1) if np.ptp(t_m) > 0.3 else lambda _: points[0, 2]
    ends = np.array([[*row.at(s_m, t), float(slope(t))] for t in (0.0, far_m)])
    return replace(lines[first.id], points=ends, width_m=row.width_m, true_ends=(True, bool(is_end)))


def _cut(row: MappedRow, bar: MapElement, span: np.ndarray, s_m: np.ndarray) -> list[MapElement]:
    """A bar along the entrance, cut where dividers pass through it."""
    half = 0.5 * row.width_m
    low, high = span
    near = [s for s in s_m if low - 3.0 * half < s < high + 3.0 * half]
    edges = [low, *(edge for s in near for edge in (s - half, s + half)), high]
    ordered = np.diff(bar.points[[0, -1], :2] @ row.along)[0] > 0.0
    is_end = bar.true_ends if ordered else bar.true_ends[::-1]
    parts = []
    for k in range(0, len(edges), 2):
        start, end = edges[k], edges[k + 1]
        if end - start < 3.0 * half:
            continue
        z_m = float(bar.points[:, 2].mean())
        normal = np.array([-row.along[1], row.along[0]])
        places = np.array([[*(row.at(s) + half * normal), z_m] for s in (start, end)])
        told = (k > 0 or is_end[0], k + 2 < len(edges) or is_end[1])
        name = bar.id if not parts else f"{bar.id}_{len(parts)}"
        parts.append(replace(bar, id=name, points=places, width_m=row.width_m, true_ends=told))
    return parts


class _Back(NamedTuple):
    lines: list[MapElement]
    used: set[str]


def _back(row: MappedRow, s_m: np.ndarray, lines: list[MapElement], config: RowConfig) -> _Back:
    """The line along the back of a row as one, from the first to the last piece of it that was seen."""
    if row.depth_m is None or not len(s_m):  # what made the row may lie beside it once its line is drawn anew
        return _Back([], set())
    found = []
    limit = np.sin(np.deg2rad(config.askew_deg))
    normal = np.array([-row.along[1], row.along[0]])
    for line in lines:
        step = line.points[-1, :2] - line.points[0, :2]
        s, t = row.inside(line.points[[0, -1], :2])
        beside = s.max() > s_m[0] - config.snap_m and s.min() < s_m[-1] + config.snap_m
        flat = abs(float(step @ normal)) <= limit * float(np.linalg.norm(step))
        if flat and beside and np.abs(t - row.depth_m).max() < config.off_m:
            found.append((line, float(s.min()), float(s.max())))
    if sum(high - low for _, low, high in found) < config.back_m:
        return _Back([], set())
    low, high = min(low for _, low, _ in found), max(high for _, _, high in found)
    half = 0.5 * row.width_m
    is_end = bool(low < s_m[0] + config.snap_m), bool(high > s_m[-1] - config.snap_m)
    low, high = s_m[0] - half if is_end[0] else low, s_m[-1] + half if is_end[1] else high
    points = np.concatenate([line.points for line, _, _ in found])
    at = row.inside(points[:, :2])[0]
    slope = np.polynomial.Polynomial.fit(at, points[:, 2], 1)
    ends = np.array([[*row.at(s, row.depth_m), float(slope(s))] for s in (low, high)])
    longest = max(found, key=lambda item: item[2] - item[1])[0]
    line = replace(longest, points=ends, width_m=row.width_m, true_ends=is_end)
    return _Back([line], {line.id for line, _, _ in found})
