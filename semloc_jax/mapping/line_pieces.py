"""Pieces of painted lines: cut where a block of a map ends, joined over blocks and gaps (room: mapping; host).

In: PaintTraces in cells of the whole map. Out: PaintTraces, each one line.
"""

import numpy as np
from jaxtyping import Real
from scipy.spatial import cKDTree

from semloc_jax.mapping.strokes import PaintTrace

_LONGEST_STEP = 4.0
"""Cells between neighbouring places of a piece."""


def cut_to(stroke: PaintTrace, low: Real[np.ndarray, " 2"], high: Real[np.ndarray, " 2"]) -> list[PaintTrace]:
    """The pieces of a stroke inside a box; an end where it was cut is no end of paint.

    Args:
        stroke: in cells.
        low: smallest x, y of the box, which belong to it.
        high: largest x, y, which do not.
    """
    middle = _even(stroke.middle)
    inside = ((middle >= low) & (middle < high)).all(axis=1)
    borders = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
    pieces = []
    for start, end in borders.reshape(-1, 2):
        # One place past the border on either side: the piece of the next block meets it there.
        first, last = max(start - 1, 0), min(end + 1, len(middle))
        if last - first >= 2:
            is_end = (bool(stroke.is_end[0] and start == 0), bool(stroke.is_end[1] and end == len(middle)))
            pieces.append(PaintTrace(middle[first:last], stroke.width, is_end))
    return pieces


def _even(middle: np.ndarray) -> np.ndarray:
    """The places of a stroke with others between those that lie far apart: where a gap was bridged."""
    steps = np.linalg.norm(np.diff(middle, axis=0), axis=1)
    parts = [
        start
        + np.linspace(0.0, 1.0, max(int(np.ceil(step / _LONGEST_STEP - 1e-9)), 1), endpoint=False)[:, None]
        * (end - start)
        for start, end, step in zip(middle[:-1], middle[1:], steps, strict=True)
    ]
    return np.vstack([*parts, middle[-1:]])


def joined(strokes: list[PaintTrace], cell_m: float, longest_gap_m: float, off_m: float) -> list[PaintTrace]:
    """Pieces of one line put together, shortest gaps first: each end of a piece is joined once at most.

    Args:
        strokes: the pieces, in cells.
        cell_m: side of a cell [m].
        longest_gap_m: pieces with a longer gap stay apart.
        off_m: pieces farther off each other's direction stay apart.
    """
    ends = [(k, end) for k in range(len(strokes)) for end in (0, 1)]
    joins: dict[tuple[int, int], tuple[int, int]] = {}
    group = list(range(len(strokes)))
    for _, one, other in sorted(_gaps(strokes, ends, cell_m, longest_gap_m, off_m)):
        if one in joins or other in joins or group[one[0]] == group[other[0]]:
            continue
        joins[one], joins[other] = other, one
        kept, gone = group[one[0]], group[other[0]]
        group = [kept if name == gone else name for name in group]
    found, used = [], set()
    # No group is a ring, so that each has an end where nothing joins it.
    for start in ends:
        if start not in joins and start[0] not in used:
            found.append(_chained(strokes, start, joins, used))
    return found


def _chained(
    strokes: list[PaintTrace],
    start: tuple[int, int],
    joins: dict[tuple[int, int], tuple[int, int]],
    used: set[int],
) -> PaintTrace:
    """The pieces that hang together, from a free end on."""
    pieces, lengths, widths = [], [], []
    entry: tuple[int, int] | None = start
    while entry is not None:
        index, end = entry
        used.add(index)
        stroke = strokes[index]
        pieces.append(stroke.middle[::-1] if end else stroke.middle)
        lengths.append(stroke.length)
        widths.append(stroke.width)
        last = (index, 1 - end)
        entry = joins.get(last)
    # The ends at a gap are where the masks are least sure of the middle.
    trimmed = [
        piece[k > 0 : len(piece) - (k < len(pieces) - 1)] if len(piece) > 3 else piece for k, piece in enumerate(pieces)
    ]
    middle = np.vstack(trimmed)
    middle = middle[np.append(True, np.linalg.norm(np.diff(middle, axis=0), axis=1) > 1e-3)]
    is_end = strokes[start[0]].is_end[start[1]], strokes[last[0]].is_end[last[1]]
    return PaintTrace(middle, float(np.average(widths, weights=lengths)), is_end)


def _gaps(
    strokes: list[PaintTrace], ends: list[tuple[int, int]], cell_m: float, longest_gap_m: float, off_m: float
) -> list[tuple[float, tuple[int, int], tuple[int, int]]]:
    """Pairs of ends that may belong to one line, with the gap between them [m]."""
    if not ends:
        return []
    ways = [_end_of(strokes[k], end) for k, end in ends]
    near = cKDTree(np.array([place for place, _ in ways])).query_pairs(longest_gap_m / cell_m)
    found = []
    for a, b in sorted(near):
        if ends[a][0] == ends[b][0]:
            continue
        gap_m = _gap_m(*ways[a], *ways[b], cell_m, off_m)
        if gap_m is not None and gap_m <= longest_gap_m:
            found.append((gap_m, ends[a], ends[b]))
    return found


def _end_of(stroke: PaintTrace, end: int) -> tuple[np.ndarray, np.ndarray]:
    """The place of an end and the direction in which the stroke leaves it."""
    line = stroke.middle if end else stroke.middle[::-1]
    back = line[-min(len(line), 20)]
    step = line[-1] - back
    return line[-1], step / max(float(np.linalg.norm(step)), 1e-9)


def _gap_m(
    place: np.ndarray, out: np.ndarray, other: np.ndarray, other_out: np.ndarray, cell_m: float, off_m: float
) -> float | None:
    step = other - place
    gap_m = float(np.linalg.norm(step)) * cell_m
    if out @ other_out > -0.97:
        return None
    off = max(abs(out[0] * step[1] - out[1] * step[0]), abs(other_out[0] * step[1] - other_out[1] * step[0]))
    ahead = min(float(out @ step), float(-other_out @ step)) * cell_m
    if ahead < -0.5 or off * cell_m > off_m + 0.03 * gap_m:
        return None
    return gap_m
