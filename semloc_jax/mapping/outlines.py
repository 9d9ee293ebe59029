"""Rectangles and outlines of patches of paint in a picture of the road from above (room: mapping; host).

In: share of looks that show paint, by cell. Out: corners, to a fraction of a cell.
"""

from collections.abc import Iterator

import cv2
import numpy as np
from jaxtyping import Bool, Float
from skimage.measure import find_contours

_MARGIN = 6
_FILLED = 0.6
"""A patch that fills less of its rectangle is none."""
_CORNER = 1.0
"""Points of an outline that are less off the line between their neighbours [cells] are left out."""
_KNOWN = 0.98
"""Share of a patch and its rim that must have been looked at."""
_INNER = 0.7
"""Share of a patch, from its middle, whose paint tells how much of it looks show."""
_RIM = 3
"""Cells around a patch whose soft rim belongs to it."""


def find_rectangles(
    share: Float[np.ndarray, "h w"], looked: Bool[np.ndarray, "h w"], smallest: float
) -> list[Float[np.ndarray, "4 2"]]:
    """Corners x, y [cells] of every rectangular patch.

    Args:
        share: paint by cell, 0 to 1.
        looked: cells that were seen often enough.
        smallest: area [cells] below which paint is noise.
    """
    found = []
    for origin, soft, own in _patches(share, looked, smallest):
        box = _rectangle(soft, own)
        if box is not None:
            found.append(box + origin)
    return found


def find_outlines(
    share: Float[np.ndarray, "h w"], looked: Bool[np.ndarray, "h w"], smallest: float
) -> list[Float[np.ndarray, "k 2"]]:
    """Outline x, y [cells] of every patch, without a repeated last point; arguments as for `find_rectangles`."""
    found = []
    for origin, soft, _ in _patches(share, looked, smallest):
        rims = find_contours(soft, 0.5)
        if not rims:
            continue
        rim = max(rims, key=len)[:, ::-1]
        corners = cv2.approxPolyDP(rim[:-1].astype(np.float32), _CORNER, True)[:, 0].astype(np.float64)
        if len(corners) >= 3:
            found.append(corners + origin)
    return found


def _patches(
    share: np.ndarray, looked: np.ndarray, smallest: float
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yields the origin of each patch, its soft picture without its neighbours, and its cells."""
    paint = ((share > 0.5) & looked).astype(np.uint8)
    # A patch that a stray line of missing pixels cuts in two is one.
    paint = cv2.morphologyEx(paint, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    num, labels, stats, _ = cv2.connectedComponentsWithStats(paint, connectivity=8)
    # Single cells between the places of a look are no gap.
    known = cv2.morphologyEx(looked.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)) > 0
    for index in range(1, num):
        x, y, width, height, area = (int(v) for v in stats[index])
        if area < smallest:
            continue
        top, left = max(y - _MARGIN, 0), max(x - _MARGIN, 0)
        box = slice(top, y + height + _MARGIN), slice(left, x + width + _MARGIN)
        own = labels[box] == index
        rim = cv2.dilate(own.astype(np.uint8), np.ones((2 * _RIM + 1, 2 * _RIM + 1), np.uint8)) > 0
        # A patch that goes on where nobody looked has no outline yet.
        if not known[box][rim].mean() > _KNOWN:
            continue
        other = (labels[box] > 0) & ~own
        yield np.array([left, top], float), np.where(rim & ~other, np.maximum(share[box], own * 0.51), 0.0), own


def _rectangle(soft: np.ndarray, own: np.ndarray) -> np.ndarray | None:
    """Corners of the rectangle whose sides hold the soft paint: direction from the cells, sides by its profiles."""
    rows, columns = np.nonzero(own)
    centre, size, angle = cv2.minAreaRect(np.stack([columns, rows], axis=1).astype(np.float32))
    if len(rows) < _FILLED * max(size[0] + 1, 1) * max(size[1] + 1, 1):
        return None
    turn = np.deg2rad(angle)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    yy, xx = np.mgrid[: soft.shape[0], : soft.shape[1]]
    middle = np.array(centre)
    for _ in range(3):
        at = (np.stack([xx.ravel(), yy.ravel()], axis=1) - middle) @ axes.T
        sides = []
        for k in (0, 1):
            # Away from the corners, where the other side is cut by them.
            inner = np.abs(at[:, 1 - k]) < max(0.35 * size[1 - k], 1.0)
            sides.append(_sides(at[inner, k], soft.ravel()[inner], 0.5 * size[k]))
        size = tuple(max(high - low, 1.0) for low, high in sides)
        middle = middle + np.array([0.5 * (low + high) for low, high in sides]) @ axes
    half = 0.5 * np.array(size)
    return middle + (np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half) @ axes


def _sides(at: np.ndarray, share: np.ndarray, half: float) -> tuple[float, float]:
    """Where paint begins and ends along one direction [cells]: its share has fallen to half of what it is inside.

    Looks that miss worn paint lower the share of all of it, and move no side.

    Args:
        at: place of each cell along the direction.
        share: paint of each cell.
        half: half of the length as far as it is known.
    """
    bins = np.rint(at).astype(int)
    first = int(bins.min())
    profile = np.bincount(bins - first, share) / np.maximum(np.bincount(bins - first), 1)
    places = first + np.arange(len(profile))
    inside = np.abs(places) <= max(_INNER * half, 1.0)
    level = 0.5 * float(np.median(profile[inside]))
    return -_end(-places[::-1], profile[::-1], level), _end(places, profile, level)


def _end(places: np.ndarray, profile: np.ndarray, level: float) -> float:
    """The last place at which a profile falls to a level."""
    last = int(np.flatnonzero(profile >= level)[-1])
    if last + 1 >= len(profile):
        return float(places[last]) + 0.5
    return float(places[last] + (profile[last] - level) / max(profile[last] - profile[last + 1], 1e-9))
