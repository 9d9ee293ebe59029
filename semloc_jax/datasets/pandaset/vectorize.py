"""Lines and signs from labelled lidar points (room: datasets; host).

In: points of one class. Out: centre lines of paint, outlines of signs, in the map frame.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from semloc_jax.geometry.polyline import arc_length

CELLS_M = (0.04, 0.12)
"""Rasters: fine where points are dense, coarse for what is left, far from the vehicle."""
_MAX_DASH_M = 5.5
_MAX_DASH_RMS_M = 0.07
"""A piece with less spread than this about its axis is one straight line."""
_STATION_M = 0.5
_CROSS_M = 0.11
_DOUBLE_REACH_M = 0.3
_DOUBLE_GAP_M = (0.17, 0.4)
"""Distance between the two strokes of a double line."""
_SIGN_GAP_M = 0.35
_MIN_SIGN_POINTS = 60


@dataclass(frozen=True)
class StrokeSizes:
    """What is traced as a stroke. All values are ours.

    Args:
        min_points: of a connected piece.
        min_dash_points: with fewer points the ends of a piece are gaps between the rings of the lidar, not ends of
            paint.
        min_length_m: of a stroke.
    """

    min_points: int = 40
    min_dash_points: int = 100
    min_length_m: float = 0.8


@dataclass(frozen=True)
class TracedLine:
    """Centre line of one painted stroke.

    Args:
        points: vertices in the map frame [m].
        is_isolated: no other paint touches it, and it is short and straight: a dash, whose ends are real.
        width_m: where the points tell it.
    """

    points: Float[np.ndarray, "k 3"]
    is_isolated: bool
    width_m: float | None = None


LABELS = StrokeSizes()
"""For points as they are labelled."""


def trace_lines(
    points: Float[np.ndarray, "n 3"], sizes: StrokeSizes = LABELS, cells_m: tuple[float, ...] = CELLS_M
) -> list[TracedLine]:
    """Strokes of paint among the points of one class.

    Points are drawn into a raster; a connected piece that is short and straight is one line along its principal axis;
    any other piece is thinned to a skeleton, cut at its junctions, and each branch is drawn to the mean of its points.
    """
    lines: list[TracedLine] = []
    for cell_m in cells_m:
        traced = np.zeros(len(points), dtype=bool)
        if len(points) >= sizes.min_points:
            found, traced = _trace_at(points, cell_m, cell_m == CELLS_M[0], sizes)
            lines += found
        points = points[~traced]
    return lines


def _trace_at(
    points: np.ndarray, cell_m: float, is_finest: bool, sizes: StrokeSizes
) -> tuple[list[TracedLine], np.ndarray]:
    """Strokes in a raster of one cell size, and which points bool[n] belong to them."""
    low = points[:, :2].min(axis=0) - 10 * cell_m
    cell = np.floor((points[:, :2] - low) / cell_m).astype(int)
    raster = np.zeros(cell.max(axis=0)[::-1] + 10, dtype=np.uint8)
    raster[cell[:, 1], cell[:, 0]] = 1
    raster = cv2.morphologyEx(raster, cv2.MORPH_CLOSE, np.ones((3, 3), dtype=np.uint8))
    _, pieces = cv2.connectedComponents(raster)
    piece_of = pieces[cell[:, 1], cell[:, 0]]
    lines: list[TracedLine] = []
    traced = np.zeros(len(points), dtype=bool)
    for piece in np.flatnonzero(np.bincount(piece_of) >= sizes.min_points):
        own = points[piece_of == piece]
        dash = _straight_line(own, sizes.min_length_m)
        found = [TracedLine(dash, is_finest and len(own) >= sizes.min_dash_points)] if dash is not None else []
        for branch in [] if found else _branches(pieces == piece, cell_m, sizes.min_length_m):
            strokes = _strokes_along(low + (branch + 0.5) * cell_m, own, sizes.min_length_m)
            found += [TracedLine(line, False) for line in strokes]
        traced |= (piece_of == piece) & bool(found)
        lines += found
    return lines, traced


def _straight_line(points: np.ndarray, min_length_m: float) -> np.ndarray | None:
    """Ends of the principal axis of a short straight piece, else None."""
    center = points.mean(axis=0)
    axis = np.linalg.svd(points - center, full_matrices=False)[2][0]
    along = (points - center) @ axis
    across = np.linalg.norm((points - center)[:, :2] - np.outer(along, axis[:2]), axis=1)
    low, high = np.percentile(along, [0.5, 99.5])
    if not min_length_m <= high - low <= _MAX_DASH_M or np.sqrt(np.mean(across**2)) > _MAX_DASH_RMS_M:
        return None
    return center + np.outer([low, high], axis)


def _branches(piece: np.ndarray, cell_m: float, min_length_m: float) -> list[np.ndarray]:
    """Ordered pixels (column, row) of each branch of the skeleton between its junctions."""
    from skimage.morphology import skeletonize  # slow to import, and most drives are not of this kind

    rows, columns = np.flatnonzero(piece.any(axis=1)), np.flatnonzero(piece.any(axis=0))
    top, left = rows[0] - 1, columns[0] - 1
    skeleton = skeletonize(piece[top : rows[-1] + 2, left : columns[-1] + 2]).astype(np.uint8)
    neighbours = cv2.filter2D(skeleton, -1, np.ones((3, 3)), borderType=cv2.BORDER_CONSTANT) - 1
    junction = cv2.dilate(((skeleton > 0) & (neighbours > 2)).astype(np.uint8), np.ones((3, 3), dtype=np.uint8))
    count, parts = cv2.connectedComponents(skeleton * (1 - junction), connectivity=8)
    branches = []
    for part in range(1, count):
        pixels = np.argwhere(parts == part)[:, ::-1]
        if len(pixels) * cell_m >= min_length_m:
            branches.append(_walked(pixels) + [left, top])
    return branches


def _walked(pixels: np.ndarray) -> np.ndarray:
    """Pixels of a line without junctions, from one end to the other."""
    gap = np.abs(pixels[:, None] - pixels[None]).max(axis=2)
    start = int(np.argmin(np.sum(gap == 1, axis=1)))
    order, left = [start], set(range(len(pixels))) - {start}
    while left:
        near = [k for k in left if gap[order[-1], k] == 1]
        if not near:
            break
        # Straight neighbours before diagonal ones keeps corners of the staircase in order.
        order.append(min(near, key=lambda k: np.abs(pixels[k] - pixels[order[-1]]).sum()))
        left.remove(order[-1])
    return pixels[order]


def _strokes_along(path_xy: np.ndarray, points: np.ndarray, min_length_m: float) -> list[np.ndarray]:
    """One line through the points beside a path, or two where they are a double line; none if the path is too short."""
    knots = arc_length(path_xy)
    if knots[-1] < min_length_m:
        return []
    at = np.linspace(0.0, knots[-1], max(2, round(knots[-1] / _STATION_M) + 1))
    xy = np.column_stack([np.interp(at, knots, path_xy[:, axis]) for axis in range(2)])
    middle = _drawn_to_points(xy, points, _DOUBLE_REACH_M)
    if middle is None:
        return []
    offsets = _double_offsets(middle[:, :2], points)
    left = _left(middle[:, :2])
    lines = [_drawn_to_points(middle[:, :2] + offset * left, points, _CROSS_M) for offset in offsets]
    return [line for line in lines if line is not None]


def _double_offsets(xy: np.ndarray, points: np.ndarray) -> tuple[float, ...]:
    """Offsets to the left of a path at which strokes run: (0,), or two where the points fall into two groups."""
    left = _left(xy)
    nearest = np.argmin(np.linalg.norm(points[:, None, :2] - xy[None], axis=2), axis=1)
    across = np.sum((points[:, :2] - xy[nearest]) * left[nearest], axis=1)
    across = across[np.abs(across) < _DOUBLE_REACH_M]
    low, high = np.percentile(across, [15, 85])
    for _ in range(10):
        is_high = across > 0.5 * (low + high)
        if is_high.all() or not is_high.any():
            return (0.0,)
        low, high = across[~is_high].mean(), across[is_high].mean()
    spread = np.sqrt(np.mean((across - np.where(is_high, high, low)) ** 2))
    share = is_high.mean()
    is_double = _DOUBLE_GAP_M[0] <= high - low <= _DOUBLE_GAP_M[1] and spread < 0.3 * (high - low) and 0.2 < share < 0.8
    return (float(low), float(high)) if is_double else (0.0,)


def _left(xy: np.ndarray) -> np.ndarray:
    """Unit vectors to the left of a path at its vertices."""
    tangent = np.gradient(xy, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return np.column_stack([-tangent[:, 1], tangent[:, 0]])


def _drawn_to_points(xy: np.ndarray, points: np.ndarray, cross_m: float) -> np.ndarray | None:
    """The path [k 2] with each vertex at the mean of the points beside it, and their height; None where few are."""
    xy, z = xy.copy(), np.full(len(xy), np.nan)
    for _ in range(3):
        left = _left(xy)
        ahead = np.column_stack([left[:, 1], -left[:, 0]])
        for k in range(len(xy)):
            offset = points[:, :2] - xy[k]
            near = (np.abs(offset @ ahead[k]) < 0.8 * _STATION_M) & (np.abs(offset @ left[k]) < cross_m)
            if near.sum() >= 5:
                xy[k] += np.mean(offset[near] @ left[k]) * left[k]
                z[k] = np.median(points[near, 2])
    known = np.isfinite(z)
    if known.sum() < 0.5 * len(z):
        return None
    return np.column_stack([xy, np.interp(np.arange(len(z)), np.flatnonzero(known), z[known])])


def trace_signs(points: Float[np.ndarray, "n 3"]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Upright rectangles [4 3] around dense groups of points on a vertical plane, with their unit normals [3]."""
    if len(points) < _MIN_SIGN_POINTS:
        return []
    cell = np.floor((points - points.min(axis=0)) / _SIGN_GAP_M).astype(int)
    occupied, member = np.unique(cell, axis=0, return_inverse=True)
    group_of = _neighbour_groups(occupied)[member.ravel()]
    signs = []
    for group in np.unique(group_of):
        own = points[group_of == group]
        if len(own) < _MIN_SIGN_POINTS:
            continue
        center = np.median(own, axis=0)
        values, vectors = np.linalg.eigh(np.cov((own - center)[:, :2].T))
        normal, right = np.append(vectors[:, 0], 0.0), np.append(vectors[:, 1], 0.0)
        if np.sqrt(values[0]) > 0.08:
            continue
        across, up = (own - center) @ right, own[:, 2] - center[2]
        (left_m, right_m), (low, high) = np.percentile(across, [2, 98]), np.percentile(up, [2, 98])
        if right_m - left_m < 0.25 or high - low < 0.25:
            continue
        corners = [(left_m, low), (right_m, low), (right_m, high), (left_m, high)]
        signs.append((np.array([center + a * right + [0.0, 0.0, b] for a, b in corners]), normal))
    return signs


def _neighbour_groups(cells: np.ndarray) -> np.ndarray:
    """Group number of each cell; cells that touch, by a corner too, are in one group."""
    index = {tuple(cell): k for k, cell in enumerate(cells.tolist())}
    steps = np.array(np.meshgrid(*[[-1, 0, 1]] * 3)).reshape(3, -1).T.tolist()
    group = np.full(len(cells), -1)
    for first in range(len(cells)):
        if group[first] >= 0:
            continue
        waiting = [first]
        group[first] = first
        while waiting:
            cell = cells[waiting.pop()].tolist()
            for step in steps:
                other = index.get(tuple(a + b for a, b in zip(cell, step, strict=True)))
                if other is not None and group[other] < 0:
                    group[other] = first
                    waiting.append(other)
    return group
