"""Distances that were surveyed in a place, against those in a map of it (room: evaluation; host).

In: pairs of corners of slots or tips of arrows with their true places and distance; elements of a made map. Out: Metric
list. The places only say which corner of the map is meant: what is compared is the distance within the map.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.map_shapes import Comparable
from semloc_jax.evaluation.metrics import Metric
from semloc_jax.structs import ElementClass

_REACH_M = 0.5
"""A corner of the map farther from the true place is another one; our choice."""


class SurveyedEnd(NamedTuple):
    """One end of a surveyed distance."""

    label: ElementClass
    """Of the element that it is a corner of."""
    point: Float[np.ndarray, " 3"]
    """Its true place [m]."""


class SurveyedDistance(NamedTuple):
    """A distance between two points that can be found in a map."""

    a: SurveyedEnd
    b: SurveyedEnd
    distance_m: float


def surveyed_distances(rows: Any, name: str) -> list[SurveyedDistance]:
    """The member `surveyed` of a meta.json: ends a and b, each with `what` (slot or arrow) and `point`; `distance_m`.

    Raises:
        SemlocError: one is something else.
    """
    found = []
    try:
        for row in rows:
            ends = [SurveyedEnd(_label(row[key]["what"]), np.array(row[key]["point"], float)) for key in ("a", "b")]
            if any(end.point.shape != (3,) or not np.isfinite(end.point).all() for end in ends):
                raise ValueError("a point is not three numbers")
            found.append(SurveyedDistance(*ends, float(row["distance_m"])))
    except (KeyError, TypeError, ValueError) as error:
        raise SemlocError(
            f"{name}: surveyed: {error!r}; expected a list of {{a, b: {{what, point [3]}}, distance_m}}"
        ) from error
    return found


def surveyed_metrics(
    elements: Iterable[Comparable],
    surveyed: Iterable[SurveyedDistance],
    T_reference_made: Float[np.ndarray, "4 4"],
) -> list[Metric]:
    """How many of the surveyed distances the map holds, and by how much they are off.

    Args:
        elements: of the made map.
        surveyed: the distances.
        T_reference_made: the motion that lays the map on the true places.
    """
    corners: dict[ElementClass, list[np.ndarray]] = {}
    for element in elements:
        own = element.points[:2] if element.label == ElementClass.PARKING_SLOT else element.points
        corners.setdefault(element.label, []).append(np.asarray(own, dtype=np.float64))
    places = {label: np.concatenate(parts) for label, parts in corners.items()}
    rows, off_m = list(surveyed), []
    for pair in rows:
        ends = [_nearest(places.get(end.label), end.point, T_reference_made) for end in (pair.a, pair.b)]
        if ends[0] is not None and ends[1] is not None:
            off_m.append(float(np.linalg.norm(ends[0] - ends[1])) - pair.distance_m)
    metrics = [
        Metric("surveyed.distances", float(len(rows)), "distances", "report"),
        Metric("surveyed.found", float(len(off_m)), "distances", "higher"),
    ]
    if off_m:
        metrics.append(Metric("surveyed.rmse", float(np.sqrt(np.mean(np.square(off_m)))), "m", "lower", 0.01))
        metrics.append(Metric("surveyed.max", float(np.abs(off_m).max()), "m", "lower", 0.02))
    return metrics


def _label(what: str) -> ElementClass:
    return ElementClass.PARKING_SLOT if "slot" in what else ElementClass.ROAD_MARK


def _nearest(
    places: Float[np.ndarray, "k 3"] | None, point: np.ndarray, T_reference_made: np.ndarray
) -> Float[np.ndarray, " 3"] | None:
    """The corner of the map that lies on a true place, in the frame of the map."""
    if places is None:
        return None
    moved = places @ T_reference_made[:3, :3].T + T_reference_made[:3, 3]
    away_m = np.linalg.norm(moved[:, :2] - point[:2], axis=1)
    return places[int(away_m.argmin())] if away_m.min() <= _REACH_M else None
