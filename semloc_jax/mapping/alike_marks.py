"""Worn marks on the road become whole by others that are painted alike (room: mapping; host).

In: outlines of marks as they were drawn. Out: the same, a mark that lacks a part with the outline that others have.
Arrows, letters and symbols come from a few stencils. Three outlines that fit each other show a stencil: its outline is
that of the larger ones among them, since paint is lost and none is added. The others have it, too, and so has a mark
that fits none of them, but lies within one and shares most of its border with it: it is what wear has left of it.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Float

from semloc_jax.maps import MapElement

_ALIKE_M = 0.06
"""Borders nearer than this are the same; maps of one drive have them 2 cm off."""
_LIKE = 0.95
"""Share of both borders that is the same in two marks of one stencil."""
_NUM_ALIKE = 3
"""Marks that fit each other show a stencil."""
_LEFT = 0.6
"""Share of its stencil's area that a worn mark still has."""
_LEFT_ONE_SIDED = 0.8
"""The same of a stencil that is not its own mirror image: an arrow of another kind, which lacks the branch to one side,
lies within it just as well and has three quarters of its area."""
_WHOLE = 0.9
"""Share of the marks of a stencil that are smaller than it: ends of arrows are worn off, and their tips are narrower
than masks show. Among many the very largest may have what does not belong to it."""
_AREA_OFF = 0.25
"""Share of their area by which two marks of one stencil differ at most."""
_OUTSIDE_M2 = 1e-3
"""Paint outside of a stencil that counts as none."""
_BORDER_LEFT = 0.65
"""Share of the border of a worn mark that is that of its stencil; the rest is where paint is worn off."""
_CLEARLY = 0.1
"""By so much more of the border one stencil fits better than another one."""
_STEP_M = 0.05
"""Between places on a border."""
_LEAST_EDGE_M = 0.15
"""Shorter edges do not say how a mark is turned."""
_FITS = 5
"""Places of a stencil that are made exact."""
_ROUNDS = 10


class _Fit(NamedTuple):
    """A stencil laid on a mark."""

    xy: Float[np.ndarray, "k 2"]
    """Its corners [m]."""
    share: float
    """Share of the border of the mark that is its own."""


def painted_alike(marks: Sequence[MapElement]) -> list[MapElement]:
    """The marks, worn ones with the outline of the stencil that they were painted by.

    Args:
        marks: closed outlines; others are returned as they are.
    """
    outlines = {k: mark.points[:, :2] for k, mark in enumerate(marks) if mark.closed and len(mark.points) >= 3}
    kinds = _kinds(outlines)
    size_m = {k: _size_m(xy) for k, xy in outlines.items()}
    stencil_of = {}
    for kind in kinds:  # the largest first
        if len(kind) >= _NUM_ALIKE:
            own = _most_whole(kind, size_m)
            # Marks that lack the same fit each other, too: they are no other kind.
            if _whole(outlines[own], [outlines[k] for k in stencil_of.values()]) is None:
                stencil_of[kind[0]] = own
    stencils = [outlines[k] for k in stencil_of.values()]
    found = list(marks)
    for kind in kinds:
        own = stencil_of.get(kind[0])
        for k in kind:
            if own is None:
                whole = _whole(outlines[k], stencils)
            else:
                whole = _laid(outlines[own], outlines[k]) if size_m[k] < size_m[own] else None
            if whole is not None:
                found[k] = _of_outline(marks[k], whole)
    return found


def _size_m(xy: Float[np.ndarray, "k 2"]) -> float:
    """Length and width of a mark together: a shaft that is drawn 1 cm wider has more area than an end that is lost."""
    return 0.5 * float(shapely.oriented_envelope(shapely.Polygon(xy)).length)


def _most_whole(kind: Sequence[int], size_m: dict[int, float]) -> int:
    """The mark of a kind that most of the others are smaller than."""
    return sorted(kind, key=lambda k: size_m[k])[int(np.ceil(_WHOLE * (len(kind) - 1)))]


def _laid(stencil: Float[np.ndarray, "k 2"], mark: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "k 2"] | None:
    """A stencil laid on a mark of its kind; None where the mark lacks nothing, or they share too little after all."""
    fit = _fit(stencil, mark)
    if fit is None or fit.share < _LIKE:
        return None
    off_m = shapely.distance(shapely.LinearRing(mark), shapely.points(_places(fit.xy)))
    return fit.xy if off_m.max() > _ALIKE_M else None


def _of_outline(mark: MapElement, xy: Float[np.ndarray, "k 2"]) -> MapElement:
    """A mark with another outline, on the plane of its corners."""
    middle = mark.points[:, :2].mean(axis=0)
    own, new = (np.column_stack([places - middle, np.ones(len(places))]) for places in (mark.points[:, :2], xy))
    plane = np.linalg.lstsq(own, mark.points[:, 2], rcond=None)[0]
    return mark.with_points(np.column_stack([xy, new @ plane]))


def _kinds(outlines: dict[int, Float[np.ndarray, "k 2"]]) -> list[list[int]]:
    """Marks that fit each other, the largest kinds first; the first of each is what the others are held against."""
    kinds: list[list[int]] = []
    for k, xy in outlines.items():
        own = next((kind for kind in kinds if _is_alike(outlines[kind[0]], xy)), None)
        if own is None:
            kinds.append([k])
        else:
            own.append(k)
    return sorted(kinds, key=len, reverse=True)


def _is_alike(one: Float[np.ndarray, "k 2"], other: Float[np.ndarray, "m 2"]) -> bool:
    areas = [shapely.Polygon(xy).area for xy in (one, other)]
    if abs(areas[0] - areas[1]) > _AREA_OFF * max(areas):
        return False
    fit = _fit(one, other)
    if fit is None or fit.share < _LIKE:
        return False
    back_m = shapely.distance(shapely.LinearRing(other), shapely.points(_places(fit.xy)))
    return bool(np.mean(back_m < _ALIKE_M) >= _LIKE)


def _whole(worn: Float[np.ndarray, "m 2"], stencils: Sequence[np.ndarray]) -> Float[np.ndarray, "k 2"] | None:
    """The stencil that a worn mark was painted by, laid on it; None where there is none, or two are as likely."""
    mark = shapely.Polygon(worn).buffer(0.0)
    fits = []
    for stencil in stencils:
        fit = _fit(stencil, worn)
        if fit is None:
            continue
        whole = shapely.Polygon(fit.xy).buffer(0.0)
        is_within = mark.difference(whole.buffer(_ALIKE_M)).area < _OUTSIDE_M2
        left = _LEFT if _is_alike(stencil * [1.0, -1.0], stencil) else _LEFT_ONE_SIDED
        if is_within and fit.share >= _BORDER_LEFT and mark.area >= left * whole.area:
            fits.append(fit)
    fits.sort(key=lambda fit: -fit.share)
    if not fits or (len(fits) > 1 and fits[0].share - fits[1].share < _CLEARLY):
        return None
    return fits[0].xy


def _fit(stencil: Float[np.ndarray, "k 2"], mark: Float[np.ndarray, "m 2"]) -> _Fit | None:
    """A stencil laid on a mark so that they share as much of the mark's border as they can."""
    places = _places(mark)
    laid = list(_edge_on_edge(stencil, mark))
    if not laid:
        return None
    shares = [_share(xy, places) for xy in laid]
    best = sorted(range(len(laid)), key=lambda k: -shares[k])[:_FITS]
    exact = [_made_exact(laid[k], places) for k in best]
    return max(exact, key=lambda fit: fit.share)


def _edge_on_edge(stencil: np.ndarray, mark: np.ndarray) -> Iterator[np.ndarray]:
    """The stencil with each of its longer edges on each longer edge of the mark, beginning or ending with it."""
    for begin, along, length_m in _edges(mark):
        for own_begin, own_along, own_length_m in _edges(stencil):
            turned = _turned(stencil - own_begin, np.arctan2(*along[::-1]) - np.arctan2(*own_along[::-1])) + begin
            yield turned
            yield turned + (length_m - own_length_m) * along


def _edges(xy: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """Begin, unit direction and length [m] of the longer edges, counter-clockwise."""
    ring = xy if shapely.LinearRing(xy).is_ccw else xy[::-1]
    step = np.roll(ring, -1, axis=0) - ring
    length_m = np.linalg.norm(step, axis=1)
    for k in np.flatnonzero(length_m >= _LEAST_EDGE_M):
        yield ring[k], step[k] / length_m[k], float(length_m[k])


def _turned(xy: np.ndarray, angle_rad: float) -> np.ndarray:
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    return xy @ np.array([[cosine, sine], [-sine, cosine]])


def _places(xy: np.ndarray) -> Float[np.ndarray, "n 2"]:
    """Evenly along an outline."""
    ring = shapely.LinearRing(xy)
    at = np.arange(0.0, ring.length, _STEP_M)
    return shapely.get_coordinates(shapely.line_interpolate_point(ring, at))


def _share(xy: np.ndarray, places: np.ndarray) -> float:
    return float(np.mean(shapely.distance(shapely.LinearRing(xy), shapely.points(places)) < _ALIKE_M))


def _made_exact(xy: np.ndarray, places: np.ndarray) -> _Fit:
    """The stencil moved so that what both borders share lies together best, across its edges (Chen, Medioni 1991)."""
    for _ in range(_ROUNDS):
        off_m, normal = _off_edges(xy, places)
        near, middle = np.abs(off_m) < 2.0 * _ALIKE_M, xy.mean(axis=0)
        arm = places - middle
        J = np.column_stack([normal, arm[:, 0] * normal[:, 1] - arm[:, 1] * normal[:, 0]])[near]
        x_m, y_m, turn_rad = np.linalg.lstsq(J, off_m[near], rcond=1e-6)[0]
        xy = _turned(xy - middle, turn_rad) + middle + [x_m, y_m]
    return _Fit(xy, _share(xy, places))


def _off_edges(
    xy: Float[np.ndarray, "k 2"], places: Float[np.ndarray, "n 2"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
    """How far places lie off the nearest edge of an outline [m], along its unit normal."""
    step = np.roll(xy, -1, axis=0) - xy
    length_m = np.linalg.norm(step, axis=1)
    along = step / np.maximum(length_m, 1e-9)[:, None]
    off = places[:, None] - xy
    s_m = np.clip(np.einsum("nki,ki->nk", off, along), 0.0, length_m)
    nearest = np.linalg.norm(off - s_m[..., None] * along, axis=2).argmin(axis=1)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)[nearest]
    return np.einsum("ni,ni->n", off[np.arange(len(places)), nearest], normal), normal
