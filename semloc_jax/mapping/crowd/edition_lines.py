"""Lines that are told again only where they run elsewhere (room: mapping; host).

In: lines as they were published, the same as more drives draw them. Out: which is which; a line that keeps the places
that it was published with wherever they still are on it.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import linear_sum_assignment

from semloc_jax.evaluation.map_shapes import kind_of
from semloc_jax.geometry import polyline
from semloc_jax.mapping.crowd.elements import stepped
from semloc_jax.maps import MapElement

_STATION_M = 2.0
_BESIDE_M = 0.28
"""A line farther aside is another one."""
_SHARE = 0.5
"""One is the other if so much of the longer one runs beside it."""
_HEIGHT_M = 0.1
_STEP = 0.7
"""Points move aside by such shares of what lies on the line: more drives then hardly ever move them again."""
_CLOSE_M = 0.5
"""A new place so near to one that stays says nothing more."""


def line_pairs(before: Sequence[MapElement], now: Sequence[MapElement]) -> list[tuple[int, int]]:
    """Which line is which: one to one, those that run beside each other over the most metres."""
    shared = np.zeros((len(before), len(now)))
    boxes = [
        np.array([[e.points[:, :2].min(axis=0), e.points[:, :2].max(axis=0)] for e in side]) for side in (before, now)
    ]
    for i, one in enumerate(before):
        for j, other in enumerate(now):
            apart = np.maximum(boxes[0][i, 0] - boxes[1][j, 1], boxes[1][j, 0] - boxes[0][i, 1]).max()
            if apart < _BESIDE_M and kind_of(one) == kind_of(other):
                shared[i, j] = _shared_m(one, other)
    lengths = [np.array([_length_m(e) for e in side]) for side in (before, now)]
    longer = np.maximum(lengths[0][:, None], lengths[1][None]) if len(before) and len(now) else shared
    rows, columns = linear_sum_assignment(-shared)
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if shared[i, j] > _SHARE * longer[i, j]]


def _length_m(line: MapElement) -> float:
    return float(polyline.arc_length(line.points[:, :2])[-1])


def _shared_m(one: MapElement, other: MapElement) -> float:
    """Over how many metres a line runs beside another one."""
    return _STATION_M * float((polyline.nearest(other.points[:, :2], _stations(one)).distance_m < _BESIDE_M).sum())


def _stations(line: MapElement) -> Float[np.ndarray, "k 2"]:
    length_m = _length_m(line)
    return polyline.interpolate(line.points[:, :2], np.arange(0.5 * _STATION_M, max(length_m, _STATION_M), _STATION_M))


def spliced(
    old: Float[np.ndarray, "k 3"], new: Float[np.ndarray, "m 3"], aside_m: float, beyond_m: float
) -> Float[np.ndarray, "n 3"]:
    """A new line with the points of the old one wherever these still lie on it.

    Args:
        old: as it was published.
        new: as it runs now.
        aside_m: what is nearer to the line lies on it.
        beyond_m: by how much an end may be elsewhere.
    """
    old = _stepped_aside(old, new, aside_m)
    along_m, stays = _lies_on(old, new, aside_m, beyond_m)
    added = ~_lies_on(new, old, aside_m, beyond_m)[1]
    own_m = polyline.arc_length(new[:, :2])
    for k in (0, len(new) - 1):  # a line that has become shorter ends anew
        chosen = np.concatenate([old[stays, :2], new[added, :2]])
        added[k] |= bool(np.linalg.norm(chosen - new[k, :2], axis=1).min(initial=np.inf) >= beyond_m)
    added &= np.abs(own_m[:, None] - along_m[None, stays]).min(axis=1, initial=np.inf) > _CLOSE_M
    order = np.argsort(np.concatenate([along_m[stays], own_m[added]]), kind="stable")
    points = np.concatenate([old[stays], new[added]])[order]
    return points if len(points) > 1 else new


def _stepped_aside(
    old: Float[np.ndarray, "k 3"], new: Float[np.ndarray, "m 3"], aside_m: float
) -> Float[np.ndarray, "k 3"]:
    """Points of the old line that lie off the new one, moved aside onto it by whole steps."""
    foot = polyline.nearest(new[:, :2], old[:, :2])
    ahead = polyline.tangent(new[:, :2], foot.s_m)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    off_m = ((polyline.interpolate(new[:, :2], foot.s_m) - old[:, :2]) * left).sum(axis=1)
    length_m = float(polyline.arc_length(new[:, :2])[-1])
    beside = (foot.s_m > 0.0) & (foot.s_m < length_m) & (np.abs(off_m) >= aside_m) & (np.abs(off_m) < _BESIDE_M)
    step_m = float(stepped(np.array([_STEP * aside_m]))[0])
    shift_m = np.where(beside, step_m * np.rint(off_m / step_m), 0.0)
    return np.column_stack([old[:, :2] + shift_m[:, None] * left, old[:, 2]])


def _lies_on(
    points: Float[np.ndarray, "k 3"], line: Float[np.ndarray, "m 3"], aside_m: float, beyond_m: float
) -> tuple[Float[np.ndarray, " k"], Bool[np.ndarray, " k"]]:
    """Arc length of the place of a line nearest to each point, and which points lie on it or hardly past its ends."""
    foot = polyline.nearest(line[:, :2], points[:, :2])
    length_m = float(polyline.arc_length(line[:, :2])[-1])
    past = (foot.s_m <= 0.0) | (foot.s_m >= length_m)
    high_m = np.abs(points[:, 2] - polyline.interpolate(line, foot.s_m)[:, 2])
    return foot.s_m, (foot.distance_m < np.where(past, beyond_m, aside_m)) & (high_m < _HEIGHT_M)
