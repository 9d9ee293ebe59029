"""How the frame of a map has moved between two solves of its drives (room: mapping; host).

In: elements as they were published, the same as more drives place them. Out: Datum, in whole steps.
Every solve lays all drives anew: satellite fixes shift the whole, wheels stretch it, turns bend it. All that is smooth
is the motion of the frame; what an element does against its neighbours is its own.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array, hstack, vstack
from scipy.sparse.linalg import splu

from semloc_jax.evaluation.map_shapes import POSTS, is_line, thing_of
from semloc_jax.geometry import polyline
from semloc_jax.mapping.crowd.merged import Known
from semloc_jax.maps import MapElement
from semloc_jax.maps.versions.datum import NODE_MM, Datum

_NODE_M, _STEP_MM = NODE_MM / 1000.0, 5
"""Grid of the shifts, and how finely they are told: less than anybody sees."""
_FREE_M, _SLOPE_M, _BEND_M = 30.0, 1.0, 0.04
"""What is known of shifts before, one standard deviation: of one node, two side by side, three in a row; ours."""
_UPWARDS = 5.0
"""Heights are so many times as free: satellites and odometry tell less of them."""
_LOSS_WIDTH, _ROUNDS = 2.0, 6
_STATION_M, _LINE_SIGMA_M, _HEIGHT_SIGMA_M = 5.0, 0.03, 0.1
"""Step of places on lines; what neighbouring ones are off alike; the same of heights."""
_PAST_M, _ASIDE_M = 0.5, 5.0
"""Where the nearest place of the other line lies farther along, that line has ended; farther aside, it is another."""
_SHARE = 0.4
"""A frame that has moved by a smaller share of what it may be off itself is told again by no number: the error of what
cars hold then is 1.08 times that of the estimate at most."""
_LEAST_PLACE_M, _LEAST_UP_M = 0.025, 0.1
"""What a map shares around a place is no surer, and heights not: less is nowhere seen; ours."""
_CORNERS = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])


class FrameSights(NamedTuple):
    """Measured motions: where a published place is now, less where it was published, in one direction."""

    at: Float[np.ndarray, "n 2"]
    axis: Float[np.ndarray, "n 2"]
    off_m: Float[np.ndarray, " n"]
    up_m: Float[np.ndarray, " n"]
    """The same upwards."""
    sigma_m: Float[np.ndarray, " n"]


def frame_motion(pairs: Sequence[tuple[Known, Known]], reach: Sequence[MapElement]) -> Datum:
    """The motion that brings published elements closest to where they lie now, robustly.

    Args:
        pairs: an element as it was published and as it lies now.
        reach: all that the motion must be known for.
    """
    found = [_of_line(a, b) if is_line(a[0]) else _of_thing(a, b) for a, b in pairs]
    told = FrameSights(*(np.concatenate(parts) for parts in zip(_NOTHING, *found, strict=True)))
    if not len(told.at):
        return Datum({})
    places = np.concatenate([told.at, *(e.points[:, :2] for e in reach)])
    low = np.unique(np.floor(places / _NODE_M).astype(np.int64), axis=0)
    nodes = np.unique((low[:, None] + _CORNERS).reshape(-1, 2), axis=0)
    near, held = _weights(told.at, nodes), _smooth(nodes)
    both = hstack([near.multiply(told.axis[:, :1]), near.multiply(told.axis[:, 1:])]).tocsr()
    none = csr_array(held.shape)
    xy = _solved(both, told.off_m / told.sigma_m, told.sigma_m, vstack([hstack([held, none]), hstack([none, held])]))
    high = np.full(len(told.at), _HEIGHT_SIGMA_M)
    z = _solved(near, told.up_m / high, high, held / _UPWARDS)
    shifts = np.column_stack([*np.split(xy, 2), z])
    cells = (_STEP_MM * np.rint(1000.0 * shifts / _STEP_MM)).astype(int).tolist()
    return Datum({(a, b): (x, y, up) for (a, b), (x, y, up) in zip(nodes.tolist(), cells, strict=True)})


def told_motion(held: Datum, found: Datum, known: Sequence[Known], sigma_m: float) -> Datum:
    """The motion that cars are told: the one they hold, as long as that is as good as the one that was found.

    As a whole the map may be off by what satellite fixes leave open, around each place by what its drives share.

    Args:
        held: how cars have it that the frame has moved.
        found: how it has moved.
        known: published elements, and how sure they are.
        sigma_m: how far all of the map may be off.
    """
    if not found.shifts_mm.keys() <= held.shifts_mm.keys():
        return found
    places = np.array([e.points.mean(axis=0) for e, _ in known])
    off = found.moved(places) - held.moved(places)
    arm = places[:, :2] - places[:, :2].mean(axis=0)
    arm = np.stack([-arm[:, 1], arm[:, 0]], axis=1)
    shift = off[:, :2].mean(axis=0)
    rigid = shift + (off[:, :2] * arm).sum() / max(np.square(arm).sum(), 1.0) * arm
    around_m = np.array([max(b.sigma_place_m, _LEAST_PLACE_M) for _, b in known])
    whole = np.sqrt(np.square(rigid).sum(axis=1).mean()) / sigma_m
    bent = np.sqrt((np.square(off[:, :2] - rigid).sum(axis=1) / around_m**2).mean())
    up = np.sqrt(np.square(off[:, 2]).mean()) / _LEAST_UP_M
    return held if max(whole, bent, up) < _SHARE else found


_NOTHING = FrameSights(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0))


def _of_thing(before: Known, now: Known) -> FrameSights:
    """Two directions of the middle of a thing."""
    old, new = thing_of(before[0]), thing_of(now[0])
    b, c = before[1], now[1]
    post = before[0].label in POSTS
    along_m = np.hypot(b.sigma_across_m, c.sigma_across_m) if post else np.hypot(b.sigma_along_m, c.sigma_along_m)
    axes = np.array([old.along, [-old.along[1], old.along[0]]])
    sigma_m = np.array([along_m, np.hypot(b.sigma_across_m, c.sigma_across_m)])
    up_m = np.full(2, now[0].points[:, 2].min() - before[0].points[:, 2].min())
    return FrameSights(np.tile(old.centre, (2, 1)), axes, axes @ (new.centre - old.centre), up_m, sigma_m)


def _of_line(before: Known, now: Known) -> FrameSights:
    """Across a line, every few metres, where both run."""
    old, new = before[0].points, now[0].points
    length_m = float(polyline.arc_length(old[:, :2])[-1])
    s_m = np.linspace(0.0, length_m, max(round(length_m / _STATION_M), 1) + 1)
    at, ahead = polyline.interpolate(old, s_m), polyline.tangent(old[:, :2], s_m)
    foot = polyline.nearest(new[:, :2], at[:, :2])
    near = polyline.interpolate(new, foot.s_m)
    axis = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    offset = near - at
    across_m = (offset[:, :2] * axis).sum(axis=1)
    beside = np.abs((offset[:, :2] * ahead).sum(axis=1)) < _PAST_M
    kept = beside & (np.abs(across_m) < _ASIDE_M)
    sigma_m = np.full(len(s_m), np.hypot(_LINE_SIGMA_M, np.hypot(before[1].sigma_across_m, now[1].sigma_across_m)))
    return FrameSights(at[kept, :2], axis[kept], across_m[kept], offset[kept, 2], sigma_m[kept])


def _weights(at: Float[np.ndarray, "n 2"], nodes: Int[np.ndarray, "k 2"]) -> csr_array:
    """What each node adds to the shift of each place."""
    row_of = {(a, b): k for k, (a, b) in enumerate(nodes.tolist())}
    low = np.floor(at / _NODE_M).astype(np.int64)
    share = at / _NODE_M - low
    values, columns = [], []
    for corner in _CORNERS:
        values.append(np.where(corner == 1, share, 1.0 - share).prod(axis=1))
        columns.append([row_of[a, b] for a, b in (low + corner).tolist()])
    rows = np.tile(np.arange(len(at)), len(_CORNERS))
    return csr_array(coo_array((np.concatenate(values), (rows, np.concatenate(columns))), (len(at), len(nodes))))


def _smooth(nodes: Int[np.ndarray, "k 2"]) -> csr_array:
    """Whitened rows of what is known of shifts before: small slopes, smaller bends, of two directions each."""
    row_of = {(a, b): k for k, (a, b) in enumerate(nodes.tolist())}
    found = [csr_array(coo_array((np.full(len(nodes), 1.0 / _FREE_M), (range(len(nodes)), range(len(nodes))))))]
    for x, y in ((1, 0), (0, 1)):
        for weights, sigma_m in (((-1.0, 1.0), _SLOPE_M), ((1.0, -2.0, 1.0), _BEND_M)):
            runs = [[row_of.get((a + k * x, b + k * y)) for k in range(len(weights))] for a, b in nodes.tolist()]
            whole = np.array([run for run in runs if None not in run], dtype=np.int64).reshape(-1, len(weights))
            rows = np.repeat(np.arange(len(whole)), len(weights))
            values = np.tile(weights, len(whole)) / sigma_m
            found.append(csr_array(coo_array((values, (rows, whole.ravel())), (len(whole), len(nodes)))))
    return csr_array(vstack(found))


def _solved(
    A: csr_array, target: Float[np.ndarray, " n"], sigma_m: Float[np.ndarray, " n"], held: csr_array
) -> Float[np.ndarray, " k"]:
    """Robust least squares; both sides in standard deviations."""
    white, weight = csr_array(A.multiply(1.0 / sigma_m[:, None])), np.ones(len(target))
    value = np.zeros(A.shape[1])
    for round_ in range(_ROUNDS):
        normal = (held.T @ held + white.T @ white.multiply(weight[:, None])).tocsc()
        value = splu(normal).solve(white.T @ (weight * target))
        # Cauchy first, which finds its way from far; then what has moved by itself is let go of (Geman and McClure).
        weight = (1.0 + ((target - white @ value) / _LOSS_WIDTH) ** 2) ** (-1.0 if round_ < _ROUNDS // 2 else -2.0)
    return value
