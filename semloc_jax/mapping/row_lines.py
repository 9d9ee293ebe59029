"""Which lines belong to a row of parking slots, and as what (room: mapping; host).

In: the frame of a row: entrance, dividers; slot lines. Out: bars along the entrance, pieces of dividers, the back.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d

from semloc_jax.maps import MapElement

PaintAt = Callable[[Float[np.ndarray, "n 2"]], tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]]
"""Places [m] -> weight of all looks at them, and of those that show a slot line."""

_ROUNDS = 8
_SIGMA_M = 0.03
"""Of a divider that was drawn from above; ours."""
_PARALLEL_DEG = 0.1
"""By which rows of one lot are askew, with the turn of the way between them; ours."""
_BESIDE_M = 0.4
"""From a divider on nothing of its own smear shows; ours."""
_AROUND_M = 0.3
"""Behind and before a line along the back in which it shows; ours."""
_PROFILE_M, _SMOOTHED_M = 0.01, 0.05
"""Step of that profile, finer than the cells of the looks, and how far it is smoothed; ours."""
_CLEAR, _LEAST_SHARE = 4.0, 0.04
"""By how much more often than the bare road, and how often at all, looks must show the line; ours."""
_BEFORE_END_M, _LEAST_DROP = 0.6, 0.1
"""So far to either side of its end dividers show paint, or none, and by how much more at least; ours."""
_SAME_M = 0.15
"""Pieces of the line along the back are no farther off each other; ours."""
_EVEN_M = 0.06
"""Dividers that scatter more about even steps are not painted in such; ours."""


@runtime_checkable
class RowFrame(Protocol):
    """What is known of a row before its places are."""

    @property
    def origin(self) -> Float[np.ndarray, " 2"]:
        """On the outer rim of the entrance [m]."""

    @property
    def along(self) -> Float[np.ndarray, " 2"]:
        """Along the entrance."""

    @property
    def inward(self) -> Float[np.ndarray, " 2"]:
        """Along the dividers."""

    @property
    def width_m(self) -> float:
        """Of its lines."""

    @property
    def depth_m(self) -> float | None:
        """Along a divider to the back."""

    def inside(self, xy: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """How far along the entrance and behind it [m]."""


@runtime_checkable
class RowLimits(Protocol):
    """What belongs to a row; see `slot_rows.RowConfig`."""

    @property
    def askew_deg(self) -> float: ...
    @property
    def off_m(self) -> float: ...
    @property
    def piece_m(self) -> float: ...
    @property
    def beside_m(self) -> float: ...
    @property
    def hidden_m(self) -> float: ...
    @property
    def snap_m(self) -> float: ...


class DividerPiece(NamedTuple):
    """A piece of a divider."""

    id: str
    s_m: float
    """Its middle along the entrance."""
    near_m: float
    far_m: float
    """Its ends behind the entrance."""
    far_is_end: bool

    @property
    def length_m(self) -> float:
        """Along the divider."""
        return self.far_m - self.near_m


def line_through(
    points: Float[np.ndarray, "n 2"], beside: Float[np.ndarray, " 2"] | None = None
) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]]:
    """A place on and the unit direction of the line that is nearest to most of the points.

    Args:
        points: on it, but for a few.
        beside: direction of a row that it runs along with, as rows of one lot do; None for none.
    """
    weight = np.ones(len(points))
    for _ in range(_ROUNDS):
        centre = np.average(points, axis=0, weights=weight)
        near = points - centre
        if beside is None:
            along = np.linalg.eigh((weight[:, None] * near).T @ near)[1][:, 1]
        else:
            s_m, t_m = near @ beside, near @ np.array([-beside[1], beside[0]])
            slope = float(weight @ (s_m * t_m) / (weight @ s_m**2 + (_SIGMA_M / np.radians(_PARALLEL_DEG)) ** 2))
            along = beside + slope * np.array([-beside[1], beside[0]])
            along = along / np.linalg.norm(along)
        off_m = near @ np.array([-along[1], along[0]])
        weight = 1.0 / (1.0 + (off_m / _SIGMA_M) ** 2)
    return centre, along


def _askew(line: MapElement, direction: np.ndarray) -> float:
    """Sine of the angle between a line and a direction."""
    step = line.points[-1, :2] - line.points[0, :2]
    return abs(float(step[0] * direction[1] - step[1] * direction[0])) / max(float(np.linalg.norm(step)), 1e-9)


def bars_along(
    row: RowFrame,
    span: tuple[float, float],
    lines: Sequence[MapElement],
    bar_m: tuple[float, float],
    off_m: float,
    askew_deg: float,
) -> list[MapElement]:
    """Short lines along the entrance of a row between two places."""
    normal = np.array([-row.along[1], row.along[0]])
    found = []
    for line in lines:
        xy = line.points[[0, -1], :2]
        s_m = (xy - row.origin) @ row.along
        behind_m = (xy - row.origin) @ normal - 0.5 * row.width_m
        is_bar = bar_m[0] <= float(np.ptp(s_m)) <= bar_m[1] and _askew(line, row.along) <= np.sin(np.deg2rad(askew_deg))
        if is_bar and np.abs(behind_m).max() <= off_m and s_m.max() > span[0] and s_m.min() < span[1]:
            found.append(line)
    return found


def back_of(
    row: RowFrame,
    span: tuple[float, float],
    lines: Sequence[MapElement],
    limits: Sequence[tuple[float, float]],
    askew_deg: float,
) -> tuple[float, float]:
    """How far behind the entrance most paint runs along it, and how much of it [m]; depths within any of the limits."""
    found = []
    for line in lines:
        s_m, t_m = row.inside(line.points[[0, -1], :2])
        length_m = min(float(s_m.max()), span[1]) - max(float(s_m.min()), span[0])
        depth_m = float(t_m.mean())
        is_flat = _askew(line, row.along) <= np.sin(np.deg2rad(askew_deg))
        if is_flat and length_m > 0.5 and any(low <= depth_m <= high for low, high in limits):
            found.append((depth_m, length_m))
    if not found:
        return 0.0, 0.0
    depth_m, paint_m = np.array(found).T
    near = np.abs(depth_m[:, None] - depth_m) < _SAME_M
    best = near[int((near @ paint_m).argmax())]
    return float(np.average(depth_m[best], weights=paint_m[best])), float(paint_m[best].sum())


def back_in_paint(
    row: RowFrame, s_m: Float[np.ndarray, " n"], depths_m: tuple[float, float], paint_at: PaintAt
) -> float | None:
    """How far behind the entrance a line runs along it, from the looks at the road between the dividers together.

    Far from the vehicle no look alone shows where a thin line is.

    Args:
        row: the row.
        s_m: where its dividers stand.
        depths_m: between which the line is.
        paint_at: looks at places.
    """
    beside = np.concatenate([np.arange(a + _BESIDE_M, b - _BESIDE_M, 0.1) for a, b in pairwise(s_m)] or [np.zeros(0)])
    if len(beside) < 10:
        return None
    depth_m, share, weight = _share_behind(row, beside, depths_m, _AROUND_M, paint_at)
    looked = weight.any(axis=0)
    inner = (depth_m >= depths_m[0]) & (depth_m <= depths_m[1])
    peak = int(np.where(inner, share, 0.0).argmax())
    ground = float(np.median(share[looked])) if looked.any() else 1.0
    if share[peak] < max(_CLEAR * ground, _LEAST_SHARE):
        return None
    near = np.abs(depth_m - depth_m[peak]) <= _AROUND_M
    above = np.where(near, np.maximum(share - 0.5 * (share[peak] + ground), 0.0), 0.0)
    return float((above * depth_m).sum() / above.sum())


def ends_in_paint(
    row: RowFrame, s_m: Float[np.ndarray, " n"], depths_m: tuple[float, float], paint_at: PaintAt
) -> float | None:
    """How far behind the entrance dividers without a line along their back end, from the looks at all of them.

    Paint that is smeared alike to both sides falls to half where it ends: there the looks before it show the most more
    than those behind it. Arguments as for `back_in_paint`.
    """
    half = 0.25 * row.width_m
    on = (s_m[:, None] + np.array([-half, 0.0, half])).ravel()
    depth_m, share, weight = _share_behind(row, on, depths_m, _BEFORE_END_M, paint_at)
    num = round(_BEFORE_END_M / _PROFILE_M)

    def before_and_behind(profile: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        mean = np.apply_along_axis(np.convolve, -1, profile, np.full(num, 1.0 / num), "valid")
        return mean[..., :-num], mean[..., num:]

    before, behind = before_and_behind(share)
    # Behind a vehicle nothing ends: most dividers must be in view there.
    in_view = np.minimum(*before_and_behind((weight > 0.0).astype(float)))
    drop = np.where((in_view.mean(axis=0) > 0.5) & (before > _CLEAR * behind), before - behind, 0.0)
    end = int(drop.argmax())
    return float(depth_m[end + num]) if drop[end] >= _LEAST_DROP else None


def _share_behind(
    row: RowFrame,
    s_m: Float[np.ndarray, " n"],
    depths_m: tuple[float, float],
    around_m: float,
    paint_at: PaintAt,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Steps behind the entrance [m], share of the looks there that show a line, and weight of those at every place."""
    depth_m = np.arange(depths_m[0] - around_m, depths_m[1] + around_m, _PROFILE_M)
    places = row.origin + s_m[:, None, None] * row.along + depth_m[None, :, None] * row.inward
    weight, hits = (part.reshape(places.shape[:2]) for part in paint_at(places.reshape(-1, 2)))
    looked, shown = weight.sum(axis=0), hits.sum(axis=0)
    share = np.divide(shown, looked, out=np.zeros_like(shown), where=looked > 0.0)
    return depth_m, gaussian_filter1d(share, _SMOOTHED_M / _PROFILE_M), weight


def pieces_of(
    row: RowFrame, span: tuple[float, float], lines: Sequence[MapElement], limits: RowLimits
) -> list[list[DividerPiece]]:
    """Pieces of the dividers of a row, those of one divider together."""
    found = []
    reach_m = (row.depth_m or 5.5) + limits.snap_m
    for line in lines:
        s_m, t_m = row.inside(line.points[[0, -1], :2])
        order = np.argsort(t_m)
        (near_m, far_m), middle_m = t_m[order], float(s_m.mean())
        if _askew(line, row.inward) > np.sin(np.deg2rad(limits.askew_deg)) or far_m - near_m < limits.piece_m:
            continue
        if near_m >= -limits.off_m and far_m <= reach_m and span[0] <= middle_m <= span[1]:
            found.append(DividerPiece(line.id, middle_m, float(near_m), float(far_m), line.true_ends[int(order[1])]))
    groups: list[list[DividerPiece]] = []
    for piece in sorted(found, key=lambda piece: -piece.length_m):
        own = next((g for g in groups if abs(g[0].s_m - piece.s_m) < limits.beside_m), None)
        if own is None:
            groups.append([piece])
        else:
            own.append(piece)
    groups = [g for g in groups if min(p.near_m for p in g) <= limits.hidden_m]
    sure = [g[0].length_m >= 2.0 * limits.piece_m for g in groups]
    known = np.sort([g[0].s_m for g, is_sure in zip(groups, sure, strict=True) if is_sure])
    # A short piece shows a divider where one is due.
    return [g for g, is_sure in zip(groups, sure, strict=True) if is_sure or _is_due(g[0].s_m, known, limits.off_m)]


def _is_due(s_m: float, known: Float[np.ndarray, " n"], off_m: float) -> bool:
    """Whether a place lies in step with others."""
    if len(known) < 2:
        return False
    step_m = _step(known)
    if step_m <= 0.0:  # two mouths of one divider
        return False
    steps = (s_m - known[int(np.abs(known - s_m).argmin())]) / step_m
    return bool(round(steps) != 0 and abs(steps - round(steps)) * step_m < off_m)


def crossings(
    ends: Sequence[np.ndarray], known_m: Sequence[float] | Float[np.ndarray, " k"], width_m: float
) -> list[float]:
    """Where bars along an entrance show dividers that were not seen: at the middle of a long bar or between two.

    Args:
        ends: first and last place of each bar.
        known_m: where dividers were seen; what bars show must lie in step with them.
        width_m: of a divider.
    """
    if len(known_m) < 2:
        return []
    known = np.sort(known_m)
    step_m = _step(known)
    spans = sorted((float(low), float(high)) for low, high in ends)
    middles = [0.5 * (low + high) for low, high in spans if high - low > 0.4 * step_m]
    middles += [0.5 * (a[1] + b[0]) for a, b in pairwise(spans) if 0.0 < b[0] - a[1] < 2.5 * width_m]
    found: list[float] = []
    for middle in middles:
        is_new = all(abs(middle - other) > 0.4 * step_m for other in (*known, *found))
        if is_new and _is_due(middle, known, 2.0 * width_m):
            found.append(middle)
    return found


def evened(s_m: Float[np.ndarray, " n"], weight: Float[np.ndarray, " n"], even_m: float) -> Float[np.ndarray, " n"]:
    """Places of dividers, in order, drawn to even steps where they are painted in such.

    Args:
        s_m: as they were seen.
        weight: how much of each was seen.
        even_m: how far one that is painted in even steps may be off.
    """
    if len(s_m) < 4:
        return s_m
    step_m = _step(s_m)
    count = np.rint((s_m - s_m[0]) / step_m)
    own = weight
    for _ in range(_ROUNDS):
        fit = np.polynomial.Polynomial.fit(count, s_m, 1, w=np.sqrt(own))
        off_m = s_m - fit(count)
        own = weight / (1.0 + (off_m / _SIGMA_M) ** 2)
    if np.median(np.abs(off_m)) > _EVEN_M or len(np.unique(count)) < len(count):
        return s_m
    share = even_m**2 / (even_m**2 + _SIGMA_M**2)
    return np.where(np.abs(off_m) < 4.0 * _EVEN_M, fit(count) + share * off_m, s_m)


def _step(s_m: Float[np.ndarray, " n"]) -> float:
    """The usual way from one divider to the next: gaps hold several."""
    steps = np.diff(s_m)
    return float(np.median(steps[steps < 1.5 * np.quantile(steps, 0.25) + 1e-9]))
