"""Elements of a packed drive as columns of whole numbers (room: maps; host).

In: elements with beliefs. Out: their kinds and columns, and the elements back.
No number is finer than what it tells is known: places are in whole centimetres, heights in decimetres above the way,
outlines and lines keep as many corners as their sigma asks for, and a round board is told by its two sides.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from semloc_jax.geometry import polyline
from semloc_jax.maps.beliefs import Belief
from semloc_jax.maps.curves import as_ring, simplify
from semloc_jax.maps.elements import UPRIGHT_CLASSES, MapElement
from semloc_jax.structs import ElementClass

_CELLS = np.array([100.0, 100.0, 10.0])
"""Cells of a metre, along x, y and up."""
_THIN_M, _FLATTER = 0.05, np.array([1.0, 1.0, 0.2])
"""How far the middle of a line may move that is known as well, and by how much less its height counts there."""
_THIN_OUTLINE_M = (0.02, 0.05)
"""How far a corner of painted outlines may move that are known as well, at least and at most: it is their shape."""
_SIZES, _NORMALS, _LOG_STEPS, _LOGIT_STEPS = 100.0, 100.0, 4.0, 1.0
_MOST_LOGIT = 12.0
_ROUND, _LEAST_CORNERS, _MOST_CORNERS = "circle", 8, 64
_SAME_M = np.array([0.01, 0.01, 0.1])
_CLOSED, _START, _END, _HAS_HEIGHT, _HAS_NORMAL = (1 << k for k in range(5))
Kind = tuple[str, str, str, int, int]
"""Class, style, shape, flags, corners of a round board or 0."""


def told_elements(
    elements: Sequence[MapElement], beliefs: Mapping[str, Belief], way: Float[np.ndarray, "k 4"]
) -> tuple[list[Kind], list[Float[np.ndarray, " n"]]]:
    """The kinds of elements, and columns of whole numbers, in the order of kinds and of the way.

    Args:
        elements, beliefs: of the drive, in its own frame.
        way: as the file tells it: a road rises and falls by more than most things stand above it.
    """
    rows = sorted(
        ((_kind(e), _told_points(e, beliefs[e.id].sigma_across_m), e, beliefs[e.id]) for e in elements),
        key=lambda row: (row[0], *row[1][0]),
    )
    kinds = sorted({kind for kind, *_ in rows})
    row_of = {kind: k for k, kind in enumerate(kinds)}
    cells = [_cells(points, way) for _, points, _, _ in rows]
    firsts = np.array([points[0] for points in cells])
    steps = np.concatenate([np.zeros((0, 3)), *(np.diff(points, axis=0) for points in cells)])
    normals = np.array([e.normal for _, _, e, _ in rows if e.normal is not None]).reshape(-1, 3) * _NORMALS
    # Posts are as thick at the top as at the foot.
    sizes = [[e.width_m, e.radius_m, e.height_m, e.radius_top_m - e.radius_m] for _, _, e, _ in rows]
    sizes = np.array(sizes) * _SIZES
    sigmas = np.log([[b.sigma_across_m, b.sigma_along_m] for *_, b in rows]) * _LOG_STEPS
    logits = [_LOGIT_STEPS * float(np.clip(b.existence_logit, -_MOST_LOGIT, _MOST_LOGIT)) for *_, b in rows]
    counts = [[row_of[kind], len(points), b.num_seen, b.num_missed] for kind, points, _, b in rows]
    tables = (
        firsts,
        steps,
        normals,
        sizes,
        sigmas,
        np.array(logits)[:, None],
        np.array(counts, float),
    )
    return kinds, [column for table in tables for column in np.rint(table).T]


def elements_of(
    name: str, kinds: Sequence[Sequence], columns: list[np.ndarray], way: Float[np.ndarray, "k 4"]
) -> list[tuple[MapElement, Belief]]:
    """The elements of these columns, with the name of their drive.

    Raises:
        ValueError, KeyError: no such kinds, or columns of other lengths.
    """
    firsts, steps, normals = (np.column_stack(columns[k : k + 3]).astype(np.float64) for k in (0, 3, 6))
    sizes = np.column_stack(columns[9:13]) / _SIZES
    across, along, logits, kind, lengths, seen, missed = columns[13:]
    if (lengths < 1).any() or int((lengths - 1).sum()) != len(steps):
        raise ValueError("elements of other numbers of points")
    bounds = np.concatenate([[0], np.cumsum(lengths - 1)])
    faces = iter(normals)
    found = []
    for k, first in enumerate(firsts):
        label, style, shape, flags, corners = kinds[int(kind[k])]
        points = _places(np.cumsum(np.vstack([first, steps[bounds[k] : bounds[k + 1]]]), axis=0), way)
        width_m, radius_m, height_m, more_m = sizes[k].tolist()
        element = MapElement(
            id=f"{ElementClass[label].name.lower()}_{k}",
            label=ElementClass[label],
            points=_round(points, int(corners)) if corners else points,
            closed=bool(flags & _CLOSED),
            width_m=width_m,
            radius_m=radius_m,
            radius_top_m=round(radius_m + more_m, 2),
            height_m=height_m,
            style=str(style),
            shape=str(shape),
            normal=_unit(next(faces)) if flags & _HAS_NORMAL else None,
            true_ends=(bool(flags & _START), bool(flags & _END)),
            has_height=bool(flags & _HAS_HEIGHT),
        )
        sigmas_m = np.exp(np.array([across[k], along[k]]) / _LOG_STEPS).tolist()
        counts = int(seen[k]), int(missed[k])
        found.append((element, Belief(*sigmas_m, logits[k] / _LOGIT_STEPS, *counts, provenance=name)))
    return found


def _cells(points: Float[np.ndarray, "k 3"], way: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "k 3"]:
    """The cell of each point, its height above the way."""
    xy = np.rint(points[:, :2] * _CELLS[:2])
    return np.column_stack([xy, np.rint((points[:, 2] - _way_z(xy / _CELLS[:2], way)) * _CELLS[2])])


def _places(cells: Float[np.ndarray, "k 3"], way: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "k 3"]:
    xy = cells[:, :2] / _CELLS[:2]
    return np.column_stack([xy, cells[:, 2] / _CELLS[2] + _way_z(xy, way)])


def _way_z(xy: Float[np.ndarray, "k 2"], way: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, " k"]:
    return np.interp(polyline.nearest(way[:, :2], xy).s_m, polyline.arc_length(way[:, :2]), way[:, 2])


def _kind(e: MapElement) -> Kind:
    flags = zip((_CLOSED, _START, _END, _HAS_HEIGHT), (e.closed, *e.true_ends, e.has_height), strict=True)
    told = sum(flag for flag, holds in flags if holds) + (_HAS_NORMAL if e.normal is not None else 0)
    return (e.label.name, e.style, e.shape, told, len(e.points) if _is_round(e) else 0)


def _told_points(element: MapElement, sigma_across_m: float) -> Float[np.ndarray, "k 3"]:
    points = element.points
    if _is_round(element):
        return points[[0, len(points) // 2]]
    if element.label in UPRIGHT_CLASSES or len(points) < 3:
        return points
    if element.closed:
        thin = simplify(as_ring(points) * _FLATTER, float(np.clip(sigma_across_m, *_THIN_OUTLINE_M)))[:-1]
        return thin / _FLATTER if len(thin) > 2 else points
    return simplify(points * _FLATTER, max(_THIN_M, sigma_across_m)) / _FLATTER


def _is_round(element: MapElement) -> bool:
    """Whether it is an upright round board as `_round` draws it, as far as a file tells."""
    points, num = element.points, len(element.points)
    if element.shape != _ROUND or not element.closed or num % 2 or not _LEAST_CORNERS <= num <= _MOST_CORNERS:
        return False
    return bool((np.abs(_round(points[[0, num // 2]], num) - points) < _SAME_M).all())


def _round(sides: Float[np.ndarray, "2 3"], num: int) -> Float[np.ndarray, "n 3"]:
    """Corners of an upright round board, from one of its sides over the top to the other and back."""
    if len(sides) != 2 or num % 2 or not _LEAST_CORNERS <= num <= _MOST_CORNERS:
        raise ValueError("a round board of another number of sides or corners")
    centre, aside = sides.mean(axis=0), 0.5 * (sides[0] - sides[1])
    turn = np.linspace(0.0, 2.0 * np.pi, num, endpoint=False)[:, None]
    return centre + np.cos(turn) * aside + np.sin(turn) * np.array([0.0, 0.0, np.linalg.norm(aside)])


def _unit(face: np.ndarray) -> np.ndarray:
    return face / max(float(np.linalg.norm(face)), 1e-9)
