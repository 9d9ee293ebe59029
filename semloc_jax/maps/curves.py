"""Exact arc-length work on polylines (room: maps; host).

In: `float64[k 3]` vertices. Out: equidistant samples, parallel lines in the road plane, parts inside a circle.
"""

import numpy as np

from semloc_jax.errors import SemlocError

_SAME_POINT_M = 1e-6
_SIMPLIFY_BLOCK = 512
_MITRE_LIMIT = 4.0
"""A corner sharper than about 29 degrees is bevelled, as in most plotters."""

MOST_SAMPLES = 4_000_000
"""Of one call; a query of 65 m holds some thousand."""


class TooManySamples(SemlocError):
    """Lines that are too long for their spacing, known before memory is taken.

    Attributes:
        line: place of the longest line in the list.
    """

    def __init__(self, line: int, length_m: float) -> None:
        super().__init__(f"line {line} is {length_m / 1e3:.4g} km long; expected lines around a vehicle")
        self.line = line


def without_repeats(points: np.ndarray, closed: bool = False) -> np.ndarray:
    """Returns the vertices without consecutive repeats, `[k 3]`; a closed outline loses its repeated last point."""
    if len(points) < 2:
        return points
    step = points[1:] - points[:-1]
    moves = np.einsum("ij,ij->i", step, step) > _SAME_POINT_M**2
    if not moves.all():
        points = points[np.concatenate([[True], moves])]
    if closed and len(points) > 1 and np.linalg.norm(points[0] - points[-1]) <= _SAME_POINT_M:
        points = points[:-1]
    return points


def as_ring(points: np.ndarray) -> np.ndarray:
    """Returns the outline with its first point repeated at the end, `[k+1 3]`."""
    return np.vstack([points, points[:1]])


def resample(
    lines: list[np.ndarray], spacing_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Returns the midpoints of equal pieces of each polyline, as near to `spacing_m` long as divides its length.

    The pieces are measured along the line, so the result does not depend on where the vertices are.

    Args:
        lines: polylines, each `[k 3]` in any metric frame; those without length give no samples.
        spacing_m: wished distance between samples.

    Returns:
        positions `[n 3]`, unit tangents `[n 3]`, the length each sample stands for `[n]`, its line `[n]`, and its place
        along that line from 0 to 1 `[n]`.

    Raises:
        TooManySamples: more than four million.
    """
    if not lines:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros(0)
    points = np.concatenate(lines)
    first = np.concatenate([[0], np.cumsum([len(line) for line in lines])])
    steps = np.diff(points, axis=0)
    lengths = np.sqrt(np.einsum("ij,ij->i", steps, steps))
    lengths[first[1:-1] - 1] = 0.0
    knots = np.concatenate([[0.0], np.cumsum(lengths)])
    start, total = knots[first[:-1]], knots[first[1:] - 1] - knots[first[:-1]]
    wished = np.where(total > _SAME_POINT_M, np.maximum(np.rint(total / spacing_m), 1.0), 0.0)
    if not wished.sum() <= MOST_SAMPLES:
        raise TooManySamples(int(np.argmax(wished)), float(total.max()))
    count = wished.astype(np.int64)
    line = np.repeat(np.arange(len(lines)), count)
    rank = np.arange(len(line)) - np.repeat(np.cumsum(count) - count, count)
    share = (rank + 0.5) / count[line]
    at = start[line] + share * total[line]
    segment = np.clip(np.searchsorted(knots, at, side="right") - 1, first[line], first[line + 1] - 2)
    inside = (at - knots[segment]) / lengths[segment]
    tangents = steps[segment] / lengths[segment, None]
    return points[segment] + inside[:, None] * steps[segment], tangents, total[line] / count[line], line, share


def parallel(points: np.ndarray, offset_m: float, is_loop: bool = False) -> np.ndarray:
    """Returns the line `offset_m` to the left (right where negative) in the road plane, mitred, `[k 3]`.

    Left is z-up cross tangent, so the line keeps the height of its centre line.

    Args:
        points: vertices, `[k 3]`, k >= 2, without repeats.
        offset_m: signed distance, positive to the left of the direction of travel.
        is_loop: the last vertex is the first one; its corner is mitred too.
    """
    return _shifted(points, offset_m * _mitres(points, is_loop))


def both_sides(points: np.ndarray, half_m: float, is_loop: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Returns the lines `half_m` to the left and to the right; see `parallel`."""
    aside = half_m * _mitres(points, is_loop)
    return _shifted(points, aside), _shifted(points, -aside)


def _shifted(points: np.ndarray, aside: np.ndarray) -> np.ndarray:
    shifted = points.copy()
    shifted[:, :2] += aside
    return shifted


def _mitres(points: np.ndarray, is_loop: bool) -> np.ndarray:
    """Returns how far each vertex goes for a line one metre to the left, `[k 2]`."""
    steps = np.diff(points[:, :2], axis=0)
    lengths = np.sqrt(np.einsum("ij,ij->i", steps, steps))[:, None]
    left = np.stack([-steps[:, 1], steps[:, 0]], axis=1) / np.maximum(lengths, 1e-12)
    before = np.concatenate([left[-1:] if is_loop else left[:1], left])
    after = np.concatenate([left, left[:1] if is_loop else left[-1:]])
    bisector = before + after
    size = np.sqrt(np.einsum("ij,ij->i", bisector, bisector))[:, None]
    bisector = np.where(size > 1e-9, bisector / np.maximum(size, 1e-12), after)
    along = np.einsum("ij,ij->i", bisector, after)[:, None]
    return bisector / np.maximum(along, 1.0 / _MITRE_LIMIT)


def simplify(points: np.ndarray, tolerance_m: float) -> np.ndarray:
    """Returns few vertices of a polyline that keep it within a tolerance in space (Douglas-Peucker), `[m 3]`.

    Every 512th vertex stays, which bounds the time by the number of vertices.

    Args:
        points: vertices, `[k 3]`; the first and the last one stay.
        tolerance_m: largest distance of a vertex from the new line.
    """
    keep = np.zeros(len(points), dtype=bool)
    keep[::_SIMPLIFY_BLOCK] = True
    keep[-1] = True
    kept = np.flatnonzero(keep)
    open_spans = list(zip(kept[:-1].tolist(), kept[1:].tolist(), strict=True))
    while open_spans:
        first, last = open_spans.pop()
        if last - first < 2:
            continue
        chord = points[last] - points[first]
        relative = points[first + 1 : last] - points[first]
        share = np.clip(relative @ chord / max(float(chord @ chord), 1e-18), 0.0, 1.0)
        gap = relative - share[:, None] * chord
        away = np.einsum("ij,ij->i", gap, gap)
        worst = int(np.argmax(away))
        if away[worst] > tolerance_m**2:
            middle = first + 1 + worst
            keep[middle] = True
            open_spans += [(first, middle), (middle, last)]
    return points[keep]


def clip_to_circle(points: np.ndarray, center: np.ndarray, radius_m: float) -> list[tuple[np.ndarray, bool, bool]]:
    """Returns the parts of a polyline inside a circle, each with whether it keeps the true start and the true end.

    Args:
        points: vertices, `[k 3]`, without repeats.
        center: circle centre, `[2]`.
        radius_m: circle radius; height plays no role.
    """
    relative = points[:, :2] - center
    if np.all(np.einsum("ij,ij->i", relative, relative) <= radius_m**2):
        return [(points, True, True)]
    enter, leave = _inside_span(relative, radius_m)
    inside = np.flatnonzero(leave > enter)
    if len(inside) == 0:
        return []
    step = np.diff(points, axis=0)
    is_break = (np.diff(inside) > 1) | (leave[inside[:-1]] < 1.0) | (enter[inside[1:]] > 0.0)
    parts = []
    for run in np.split(inside, np.flatnonzero(is_break) + 1):
        first, last = run[0], run[-1]
        start = points[first] + enter[first] * step[first]
        end = points[last] + leave[last] * step[last]
        part = without_repeats(np.vstack([start, points[first + 1 : last + 1], end]))
        parts.append((part, bool(first == 0 and enter[0] == 0.0), bool(last == len(step) - 1 and leave[last] == 1.0)))
    return parts


def _inside_span(relative: np.ndarray, radius_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns where each segment of `relative` `[k 2]` enters and leaves a circle at zero, as shares of it `[k-1]`.

    A segment that does not meet the circle leaves before it enters.
    """
    start, step = relative[:-1], np.diff(relative, axis=0)
    squared = np.maximum(np.einsum("ij,ij->i", step, step), 1e-18)
    middle = -np.einsum("ij,ij->i", start, step) / squared
    excess = (np.einsum("ij,ij->i", start, start) - radius_m**2) / squared
    half = np.sqrt(np.maximum(middle**2 - excess, 0.0))
    return np.maximum(middle - half, 0.0), np.minimum(middle + half, 1.0)
