"""The map as few explicit landmarks: lanes, signs with their shape, lamp posts (room: alignment; host).

In: a LocalMap. Out: Landmark tuple, in the local frame. The map side of systems with a compact map (MLVHM 2020).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.geometry.polyline import arc_length, interpolate
from semloc_jax.maps import LocalMap, MapElement
from semloc_jax.structs import ElementClass

_LANE_STEP_M = 1.0
_CORNERS = {3: "triangle", 4: "rectangle"}


class Landmark(NamedTuple):
    """One landmark."""

    label: ElementClass
    """LANE_MARKING, SIGN or POLE."""
    points: Float[np.ndarray, "k 3"]
    """Of a lane: places on its middle, a metre apart; of a sign: corners; of a post: base and top [m]."""
    shape: str = ""
    """Of a sign: triangle, rectangle, circle, or patch where it is none of these."""
    radius_m: float = 0.0
    """Of a circle; of other signs half the root of their area."""
    width_m: float = 0.0
    """Of a lane marking."""
    normal: Float[np.ndarray, "3"] | None = None
    """Out of the face of a sign."""
    element: int = -1
    """Place among the elements of the local map."""

    @property
    def middle(self) -> Float[np.ndarray, "3"]:
        """Its middle [m]."""
        return self.points.mean(axis=0)


def compact_landmarks(local_map: LocalMap) -> tuple[Landmark, ...]:
    """The landmarks of a local map; everything else in it is left out."""
    found = []
    for index, element in enumerate(local_map.elements):
        landmark = _landmark(element, local_map.frame.from_map(element.points, np.float64))
        if landmark is not None:
            found.append(landmark._replace(element=index))
    return tuple(found)


def _landmark(element: MapElement, points: np.ndarray) -> Landmark | None:
    label = element.label
    if label == ElementClass.POLE and len(points) >= 2 and points[-1, 2] > points[0, 2]:
        return Landmark(label, points[[0, -1]])
    if label == ElementClass.SIGN and len(points) >= 3:
        return _sign(element, points)
    if label == ElementClass.LANE_MARKING and not element.is_logical and len(points) >= 2:
        length_m = float(arc_length(points)[-1])
        if length_m > 0.0:
            at = np.linspace(0.0, length_m, max(int(length_m / _LANE_STEP_M), 1) + 1)
            return Landmark(label, np.asarray(interpolate(points, at)), width_m=element.width_m)
    return None


def _sign(element: MapElement, points: np.ndarray) -> Landmark:
    centre = points.mean(axis=0)
    reach = float(np.linalg.norm(points - centre, axis=1).mean())
    if element.shape == "circle":
        return Landmark(element.label, points, "circle", reach, normal=element.normal)
    turned = np.cross(points - centre, np.roll(points, -1, axis=0) - centre)
    half_m = 0.5 * float(np.sqrt(0.5 * np.linalg.norm(turned.sum(axis=0))))
    shape = _CORNERS.get(len(points), "patch")
    return Landmark(element.label, points, shape, half_m, normal=element.normal)
