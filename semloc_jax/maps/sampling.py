"""Sampling of the contours that a camera can see at fixed intervals (room: maps; host).

In: a LocalMap. Out: MapSamples, padded to a bucket, in the local frame `LocalMap.frame`.
"""

from collections.abc import Sequence

import jax
import numpy as np
import shapely

from semloc_jax.errors import SemlocError
from semloc_jax.geometry import polyline
from semloc_jax.maps.contours import Contour, element_contours, open_ends, touching_paint
from semloc_jax.maps.curves import TooManySamples, resample
from semloc_jax.maps.elements import MapElement
from semloc_jax.maps.heights import height_sigmas
from semloc_jax.maps.semantic_map import LocalMap
from semloc_jax.structs import ElementClass, MapSamples, SampleKind

BUCKETS = tuple(256 * 2**k for k in range(13))
"""Capacities that samples are padded to, so that jitted code is compiled a few times only."""
_PROBE_M = 0.005
"""How far beside an edge the neighbouring paint is looked for: bridges the rounding of coordinates in files."""
_CARRIER_M = 0.3
"""A pole nearer than this to the middle of a sign or traffic light is taken to carry it."""
_SAME_LEVEL_M = 0.5
"""Paint farther apart in height than this (bridges, decks) does not cover other paint."""


def sample(local_map: LocalMap, spacing_m: float, capacity: int | None = None) -> MapSamples:
    """Returns samples on the visible contours of the local map, one each `spacing_m` of contour.

    The edges of what is painted are sampled, not centre lines: both sides of a line and its true ends, outlines of
    areas and signs, both silhouettes of round things, vertical edges of pillars. Edges inside other paint of the class
    are left out, and so are logical elements.

    Args:
        local_map: from `SemanticMap.query`.
        spacing_m: distance between samples along a contour.
        capacity: number of rows; None takes the smallest bucket that fits.

    Raises:
        SemlocError: the spacing is not positive, or there are more samples than `capacity`.

    >>> samples = sj.sample(street.query([0.0, 0.0], 50.0), spacing_m=0.25)
    >>> int(samples.valid.sum()), samples.p_map.shape
    (516, (1024, 3))
    """
    if not (np.isfinite(spacing_m) and spacing_m > 0):
        raise SemlocError(f"sample spacing {spacing_m} m; expected a positive number such as 0.25")
    contours, owner = _all_contours(local_map.elements)
    try:
        position, tangent, length, contour, share = resample([c.line for c in contours], spacing_m)
    except TooManySamples as error:
        name = local_map.elements[owner[error.line]].id
        raise SemlocError(f"map element '{name[:60]}': {error}; repair it, or give a larger sample spacing") from error
    element = owner[contour]
    shown = _is_outermost(local_map.elements, element, position, tangent)
    shown = np.flatnonzero(shown & ~_is_behind_plate(local_map.elements, element, position))
    position, tangent, length, contour, share = (a[shown] for a in (position, tangent, length, contour, share))
    offset_m = np.array([c.offset_m for c in contours]).reshape(-1, 2)[contour]
    kind = np.array([c.kind for c in contours], dtype=np.int32)[contour]
    center = position.copy()
    boxed = kind == SampleKind.CORNER
    center[boxed, :2] = [contours[c].axis for c in contour[boxed]] or np.zeros((0, 2))
    columns = {
        "p_map": local_map.frame.from_map(position),
        "tangent_map": tangent.astype(np.float32),
        "offset_m": ((1.0 - share) * offset_m[:, 0] + share * offset_m[:, 1]).astype(np.float32),
        "length_m": length.astype(np.float32),
        "label": np.array([e.label for e in local_map.elements], dtype=np.int32)[element[shown]],
        "kind": kind,
        "element": element[shown].astype(np.int32),
        "center_map": local_map.frame.from_map(center),
        "height_sigma": height_sigmas(local_map.elements)[element[shown]].astype(np.float32),
    }
    return _pad(columns, capacity)


def _all_contours(elements: Sequence[MapElement]) -> tuple[list[Contour], np.ndarray]:
    """Returns the contours of all elements, and the element of each `int[c]`."""
    contours: list[Contour] = []
    owner: list[int] = []
    for index, (element, caps) in enumerate(zip(elements, open_ends(elements), strict=True)):
        own = element_contours(element, (bool(caps[0]), bool(caps[1])))
        contours += own
        owner += [index] * len(own)
    return contours, np.array(owner, dtype=np.int64)


def _is_outermost(
    elements: Sequence[MapElement], element: np.ndarray, position: np.ndarray, tangent: np.ndarray
) -> np.ndarray:
    """Returns whether each sample lies on the outline of the union of its class's paint, `bool[n]`.

    A sample is inside the union if the place just outside of its own element is painted by a neighbour. Where two
    elements share an edge and its side (doubled entries of a map), the first one keeps it.
    """
    outward = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    keep = np.ones(len(element), dtype=bool)
    first = np.searchsorted(element, np.arange(len(elements) + 1))
    for index, neighbour, polygon in touching_paint(elements):
        rows = np.arange(first[index], first[index + 1])
        outside = position[rows, :2] + _PROBE_M * outward[rows]
        hidden = shapely.contains_xy(polygon, outside)
        if neighbour < index:
            hidden |= shapely.contains_xy(polygon, position[rows, :2] - _PROBE_M * outward[rows])
        if hidden.any():
            keep[rows[hidden]] &= ~_is_level(position[rows[hidden]], elements[neighbour].points)
    return keep


def _is_behind_plate(elements: Sequence[MapElement], element: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Returns whether each sample `[n 3]` lies on a part of a pole that carries a sign or a traffic light."""
    boxes = [_box(e) for e in elements if e.label in (ElementClass.SIGN, ElementClass.TRAFFIC_LIGHT) and e.has_height]
    behind = np.zeros(len(element), dtype=bool)
    rows = np.flatnonzero(np.array([e.label == ElementClass.POLE for e in elements], dtype=bool)[element])
    if boxes and len(rows):
        center, lowest, highest = (np.array(part) for part in zip(*boxes, strict=True))
        near = ((position[rows, None, :2] - center) ** 2).sum(axis=2) < _CARRIER_M**2
        height = position[rows, None, 2]
        behind[rows] = (near & (height > lowest) & (height < highest)).any(axis=1)
    return behind


def _box(element: MapElement) -> tuple[np.ndarray, float, float]:
    """Returns the middle seen from above `[2]`, the lowest and the highest point of a plate."""
    height = element.points[:, 2]
    return element.points[:, :2].mean(axis=0), float(height.min()), float(height.max())


def _is_level(position: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Returns whether each position `[n 3]` is about as high as the line `points` `[k 3]` where it is nearest."""
    lowest, highest = min(position[:, 2].min(), points[:, 2].min()), max(position[:, 2].max(), points[:, 2].max())
    if highest - lowest < _SAME_LEVEL_M:
        return np.ones(len(position), dtype=bool)
    points = points[np.concatenate([[True], np.any(np.diff(points[:, :2], axis=0) != 0.0, axis=1)])]
    along = polyline.arc_length(points[:, :2])
    height = np.interp(polyline.nearest(points[:, :2], position[:, :2]).s_m, along, points[:, 2])
    return np.abs(position[:, 2] - height) < _SAME_LEVEL_M


def _pad(columns: dict[str, np.ndarray], capacity: int | None) -> MapSamples:
    """Returns the samples with rows of padding up to the capacity, or up to the next bucket."""
    count = len(columns["label"])
    if capacity is None:
        capacity = next((size for size in BUCKETS if size >= count), count)
    if count > capacity:
        raise SemlocError(f"{count} map samples do not fit a capacity of {capacity}; use a larger spacing or capacity")
    padded = {}
    for name, values in columns.items():
        fill = -1 if name == "element" else 0
        padded[name] = np.full((capacity, *values.shape[1:]), fill, dtype=values.dtype)
        padded[name][:count] = values
    return MapSamples(**jax.device_put({**padded, "valid": np.arange(capacity) < count}))
