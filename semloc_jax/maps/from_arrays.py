"""A map from arrays: polylines with their classes (room: maps; host).

In: (class, points) pairs. Out: SemanticMap.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.maps.elements import UPRIGHT_CLASSES, GeoOrigin, MapElement, element_class
from semloc_jax.maps.semantic_map import SemanticMap
from semloc_jax.structs import ElementClass

AREA_CLASSES = frozenset(
    {
        ElementClass.CROSSWALK,
        ElementClass.ROAD_MARK,
        ElementClass.PARKING_SLOT,
        ElementClass.SPEED_BUMP,
        ElementClass.SIGN,
        ElementClass.PILLAR,
    }
)
"""Classes whose points are an outline."""


def map_from_arrays(
    lines: Iterable[Sequence],
    *,
    width_m: float = 0.12,
    radius_m: float = 0.06,
    height_m: float = 2.5,
    name: str = "arrays",
    origin: GeoOrigin | None = None,
) -> SemanticMap:
    """The map of some polylines.

    Args:
        lines: (class, points) or (class, points, {field of MapElement: value}) for each element. The class is an
            ElementClass or its name; points `[k 3]`, or `[k 2]` where heights are not known, in the map frame [m].
            Painted lines: centre line; crosswalk bars, arrows, signs, pillars: outline without a repeated last point;
            poles, cones, traffic lights: base and top.
        width_m: Width of painted lines [m].
        radius_m: Radius of poles and cones [m].
        height_m: Height of pillars above their points [m].
        name: For messages.
        origin: Where the frame sits on the earth; None where it does not matter.

    Raises:
        SemlocError: an unknown class, points of another shape, too few of them, or none at all.

    >>> left, right = [[0, 2, 0], [40, 2, 0]], [[0, -2, 0], [40, -2, 0]]
    >>> pole = [[20, 5, 0], [20, 5, 6]]
    >>> lane = sj.map_from_arrays([("lane_marking", left), ("lane_marking", right), ("pole", pole)])
    >>> [(element.id, element.label.name) for element in lane.elements]
    [('lane_marking-0', 'LANE_MARKING'), ('lane_marking-1', 'LANE_MARKING'), ('pole-2', 'POLE')]
    """
    sizes = {"width_m": width_m, "radius_m": radius_m, "radius_top_m": radius_m, "height_m": height_m}
    elements = [_element(index, entry, sizes) for index, entry in enumerate(lines)]
    if not elements:
        raise SemlocError("map_from_arrays: given no lines; expected at least one (class, points) pair")
    return SemanticMap(tuple(elements), origin, name)


def _element(index: int, entry: Sequence, sizes: Mapping[str, float]) -> MapElement:
    where = f"map_from_arrays: entry {index}"
    if not isinstance(entry, tuple | list) or len(entry) not in (2, 3):
        raise SemlocError(f"{where}: given {repr(entry)[:80]}; expected (class, points) or (class, points, fields)")
    label = element_class(entry[0], where)
    points = _points(entry[1], label, f"{where} ({label.name.lower()})")
    fields = {"closed": label in AREA_CLASSES, "has_height": points.shape[1] == 3, **_sizes(label, sizes)}
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    fields |= {"id": f"{label.name.lower()}-{index}"} | dict(entry[2] if len(entry) == 3 else {})
    try:
        return MapElement(label=label, points=points, **fields)
    except TypeError as error:
        raise SemlocError(
            f"{where}: {error}; expected fields of MapElement such as width_m, radius_m, style"
        ) from error


def _points(values: Any, label: ElementClass, where: str) -> np.ndarray:
    try:
        points = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise SemlocError(f"{where}: points {repr(values)[:60]}; expected numbers [k 3] or [k 2] in metres") from error
    least = 3 if label in AREA_CLASSES else 2
    if points.ndim != 2 or points.shape[1] not in (2, 3) or len(points) < least:
        raise SemlocError(f"{where}: points of shape {points.shape}; expected [k 3] or [k 2] with k >= {least}")
    if label in UPRIGHT_CLASSES and (points.shape != (2, 3) or not points[1, 2] > points[0, 2]):
        raise SemlocError(f"{where}: points {points.tolist()}; expected base and top [2 3], the base below the top")
    return points


def _sizes(label: ElementClass, sizes: Mapping[str, float]) -> dict[str, float]:
    """The sizes that a class has."""
    if label in (ElementClass.POLE, ElementClass.CONE):
        return {key: sizes[key] for key in ("radius_m", "radius_top_m")}
    if label == ElementClass.PILLAR:
        return {"height_m": sizes["height_m"]}
    painted = (ElementClass.LANE_MARKING, ElementClass.STOP_LINE, ElementClass.SLOT_LINE, ElementClass.TRAFFIC_LIGHT)
    return {"width_m": sizes["width_m"]} if label in painted else {}
