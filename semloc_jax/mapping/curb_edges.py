"""Curbs laid at their edge towards the road (room: mapping; host).

In: curbs as they were followed through the picture from above, the way of the vehicle, looks. Out: their edges.
A curb stands a hand high. Seen from above its face and its top are smeared over what is behind it, half a metre from
the lane beside it and a metre from the next, and often past what a camera looks at: the middle of that is no place of
the curb. Its foot lies in the road and is where it is from every lane; maps mean this edge, too.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import uniform_filter1d
from scipy.signal import savgol_filter
from scipy.spatial import cKDTree

from semloc_jax.geometry import polyline
from semloc_jax.maps import MapElement

LooksAt = Callable[
    [Float[np.ndarray, "n 2"]], tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]
]
"""Weight of all looks at places [m], of those that show a curb, and whether enough frames looked there."""

FOOT_M = 0.1
"""A curb is seen at most so far behind its edge, whatever its height; ours."""
_STEP_M, _ACROSS_M = 0.25, 0.0125
"""From place to place along a curb, and across it."""
_TOWARDS_M, _BACK_M, _BARE_M = 0.8, 0.3, 0.05
"""Its edge is looked for so far from where it was drawn, towards the road and back; so much bare road before it must
have been looked at; ours."""
_AVERAGED = 5
"""Places along a curb whose looks count together: over a metre; ours."""
_SHOWS = 0.5
"""A place shows a curb where this share of its looks do: at its edge."""
_GAP_M, _LEAST_M = 3.0, 1.2
"""Where the edge is not seen for longer the curb is two; a shorter one is noise; ours."""
_END_M = 1.0
"""An edge that is seen up to so far from the end of its curb goes on to it; ours."""
_SMOOTHED_M, _KNOT_M, _OFF_M = 4.0, 1.0, 0.1
"""The edge is a parabola over so much way, a point every so much; what is farther off its neighbours is none; ours."""


def edges_of(curbs: Sequence[MapElement], xy_way: Float[np.ndarray, "n 2"], looks_at: LooksAt) -> list[MapElement]:
    """The edge of each curb towards the way, in one piece or several; nothing of a curb whose edge was not seen.

    Args:
        curbs: polylines along their middle.
        xy_way: places of the vehicle [m].
        looks_at: the looks at curbs.
    """
    way, found = cKDTree(xy_way), []
    for curb in curbs:
        xy, along_m = curb.points[:, :2], polyline.arc_length(curb.points[:, :2])
        s_m, edge = _edge(xy, way, looks_at)
        cuts = np.flatnonzero(np.diff(s_m) > _GAP_M) + 1
        for s, piece in zip(np.split(s_m, cuts), np.split(edge, cuts), strict=True):
            line = _smooth(s, piece)
            if line is not None:
                s, line = _to_ends(*line, float(along_m[-1]))
                line = np.column_stack([line, np.interp(s, along_m, curb.points[:, 2])])
                found.append(replace(curb, points=line, width_m=0.0))
    return [replace(curb, id=f"curb_{k}") for k, curb in enumerate(found)]


def _edge(xy: np.ndarray, way: cKDTree, looks_at: LooksAt) -> tuple[np.ndarray, np.ndarray]:
    """Where along a curb its edge is seen [m], and places of the edge."""
    length_m = float(polyline.arc_length(xy)[-1])
    s_m = np.linspace(0.0, length_m, max(round(length_m / _STEP_M), 1) + 1)
    middle, along = polyline.interpolate(xy, s_m), polyline.tangent(xy, s_m)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    aside = ((way.data[way.query(middle)[1]] - middle) * normal).sum(axis=1)
    normal = normal * (np.sign(np.sum(np.sign(aside))) or 1.0)  # towards the road, the same all along
    off_m = np.arange(-_BACK_M, _TOWARDS_M + _BARE_M, _ACROSS_M)
    all_looks, shows, seen = (
        part.reshape(len(s_m), len(off_m))
        for part in looks_at((middle[:, None] + off_m[:, None] * normal[:, None]).reshape(-1, 2))
    )
    # Masks wobble from place to place.
    all_looks, shows = (uniform_filter1d(part, _AVERAGED, axis=0) for part in (all_looks, shows))
    is_curb = seen & (shows > _SHOWS * all_looks)
    last = len(off_m) - 1 - is_curb[:, ::-1].argmax(axis=1)  # the last that shows it on the way to the road
    bare = round(_BARE_M / _ACROSS_M)
    behind = np.minimum(last[:, None] + 1 + np.arange(bare), len(off_m) - 1)
    is_seen = is_curb.any(axis=1) & np.take_along_axis(seen, behind, axis=1).all(axis=1) & (off_m[last] < _TOWARDS_M)
    edge_m = off_m[last] + 0.5 * _ACROSS_M
    return s_m[is_seen], (middle + edge_m[:, None] * normal)[is_seen]


def _smooth(s_m: np.ndarray, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """A point every metre of a smooth edge: its places along the curb [m], and itself; None for one that is short."""
    for _ in range(2):
        if len(s_m) < 4 or s_m[-1] - s_m[0] < _LEAST_M:
            return None
        even = np.arange(s_m[0], s_m[-1] + 1e-6, _STEP_M)
        filled = np.stack([np.interp(even, s_m, axis) for axis in xy.T], axis=1)
        window = min(2 * round(0.5 * _SMOOTHED_M / _STEP_M) + 1, 2 * ((len(even) - 1) // 2) + 1)
        smooth = savgol_filter(filled, window, 2, axis=0) if window > 3 else filled
        own = np.stack([np.interp(s_m, even, axis) for axis in smooth.T], axis=1)
        near = np.linalg.norm(xy - own, axis=1) <= _OFF_M
        s_m, xy = s_m[near], xy[near]
    step = round(_KNOT_M / _STEP_M)
    rows = np.append(np.arange(0, len(even) - step // 2, step), len(even) - 1)
    return even[rows], smooth[rows]


def _to_ends(s_m: np.ndarray, xy: np.ndarray, length_m: float) -> tuple[np.ndarray, np.ndarray]:
    """An edge that goes straight on to the ends of its curb where these are near: there a curb is followed askew."""
    for end, at_m in ((0, 0.0), (-1, length_m)):
        if abs(at_m - s_m[end]) <= _END_M:
            back = 1 if end == 0 else -2
            slope = (xy[end] - xy[back]) / (s_m[end] - s_m[back])
            xy[end], s_m[end] = xy[end] + slope * (at_m - s_m[end]), at_m
    return s_m, xy
