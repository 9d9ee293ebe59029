"""A simulated world: ground, paint, solids, traffic and the path of the vehicle (room: simulation; host).

In: a layout (road or garage). Out: Scene, ready to be rendered from any pose.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.maps import MapElement
from semloc_jax.simulation.paint import PaintedGround
from semloc_jax.simulation.path import PlanePath
from semloc_jax.simulation.solids import Frustum, Plate, Solid
from semloc_jax.simulation.surface import Surface
from semloc_jax.structs import ElementClass

GREY = (0.55, 0.56, 0.55)
SIGN_COLOR = (0.25, 0.2, 0.75)
LIGHT_COLOR = (0.12, 0.14, 0.12)
CONE_COLOR = (0.1, 0.35, 0.95)


@dataclass(frozen=True)
class Scene:
    """A world that can be rendered.

    Args:
        elements: the true map.
        surface: height of the ground.
        ground: classes of the ground.
        solids: what stands still.
        traffic: what moves, by time [s].
        path: line the rear axle follows.
        backdrop: class id of rays that hit nothing.
        ego: body of the vehicle in the base frame, seen by cameras on its outside.
    """

    elements: tuple[MapElement, ...]
    surface: Surface
    ground: PaintedGround
    solids: tuple[Solid, ...]
    traffic: Callable[[float], Sequence[Solid]]
    path: PlanePath
    backdrop: int
    ego: tuple[Solid, ...] = ()


def class_name(element: MapElement) -> str:
    """Name of the class of an element in masks and map files of the drive layout."""
    return str(element.attributes["class"])


def solid_of(element: MapElement) -> Solid | None:
    """The body of an upright round or flat element; None for paint and pillars."""
    class_id = CLASS_IDS.get(class_name(element), 0)
    if element.label in (ElementClass.POLE, ElementClass.CONE):
        color = CONE_COLOR if element.label == ElementClass.CONE else GREY
        return _frustum(element, class_id, color, element.radius_m, element.radius_top_m)
    if element.label == ElementClass.TRAFFIC_LIGHT:
        return _frustum(element, class_id, LIGHT_COLOR, 0.5 * element.width_m, 0.5 * element.width_m)
    if element.label == ElementClass.SIGN:
        return Plate(class_id, SIGN_COLOR, np.asarray(element.points))
    return None


def _frustum(element: MapElement, class_id: int, color: tuple, radius_m: float, radius_top_m: float) -> Frustum:
    base, top = element.points
    return Frustum(class_id, color, base, float(top[2] - base[2]), radius_m, radius_top_m)
