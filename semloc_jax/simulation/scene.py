"""A simulated world: ground, paint, solids, traffic and the path of the vehicle (room: simulation; host).

In: a layout (road, garage ...). Out: World, and the Scene of it, ready to be rendered from any pose.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Bool

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.maps import MapElement
from semloc_jax.simulation.paint import GroundArea, PaintedGround, painted_shape
from semloc_jax.simulation.path import PlanePath
from semloc_jax.simulation.solids import Box, Frustum, Plate, Solid
from semloc_jax.simulation.surface import Surface
from semloc_jax.structs import ElementClass

GREY = (0.55, 0.56, 0.55)
SIGN_COLOR = (0.25, 0.2, 0.75)
LIGHT_COLOR = (0.12, 0.14, 0.12)
CONE_COLOR = (0.1, 0.35, 0.95)
PILLAR_COLOR = (0.6, 0.62, 0.62)


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


@dataclass(frozen=True)
class World:
    """A world as a builder lays it out: its map may still change before it is painted and rendered.

    Args:
        elements: the true map.
        surface: height of the ground.
        areas: stretches of ground, later ones over earlier ones.
        rest: class id of the ground beyond them.
        worn: repeating pattern of places where paint is gone, one cell 3 cm wide; None for none.
        path: line the rear axle follows.
        backdrop: class id of rays that hit nothing.
        bodies: what stands still and is no element of the map.
        traffic: what moves, by time [s].
        ego: body of the vehicle in the base frame.
        parked: cars that stand there on this drive.
        along: line that things are lined up along; None takes the path.
        glyphs: painted figures that no element outlines, with their class ids.
        features: GeoJSON features of the map that are no elements.
    """

    elements: tuple[MapElement, ...]
    surface: Surface
    areas: tuple[GroundArea, ...]
    rest: int
    worn: Bool[np.ndarray, "n n"] | None
    path: PlanePath
    backdrop: int
    bodies: tuple[Solid, ...] = ()
    traffic: Callable[[float], Sequence[Solid]] = lambda time_s: ()
    ego: tuple[Solid, ...] = ()
    parked: tuple[Solid, ...] = ()
    along: PlanePath | None = None
    glyphs: tuple[tuple[shapely.Geometry, int], ...] = ()
    features: tuple[dict, ...] = ()

    def scene(self) -> Scene:
        """The world painted, ready to be rendered."""
        painted = [e for e in self.elements if e.is_painted or e.label == ElementClass.SPEED_BUMP]
        shapes = [painted_shape(element) for element in painted] + [shape for shape, _ in self.glyphs]
        class_ids = [CLASS_IDS[class_name(element)] for element in painted] + [kind for _, kind in self.glyphs]
        ground = PaintedGround(shapes, class_ids, self.areas, self.rest, self.worn)
        solids = [solid for element in self.elements if (solid := solid_of(element)) is not None]
        solids += [*self.bodies, *self.parked]
        return Scene(
            self.elements, self.surface, ground, tuple(solids), self.traffic, self.path, self.backdrop, self.ego
        )


def class_name(element: MapElement) -> str:
    """Name of the class of an element in masks and map files of the drive layout."""
    return str(element.attributes["class"])


def solid_of(element: MapElement) -> Solid | None:
    """The body of an upright element; None for paint."""
    class_id = CLASS_IDS.get(class_name(element), 0)
    if element.label in (ElementClass.POLE, ElementClass.CONE):
        color = CONE_COLOR if element.label == ElementClass.CONE else GREY
        return _frustum(element, class_id, color, element.radius_m, element.radius_top_m)
    if element.label == ElementClass.TRAFFIC_LIGHT:
        return _frustum(element, class_id, LIGHT_COLOR, 0.5 * element.width_m, 0.5 * element.width_m)
    if element.label == ElementClass.SIGN:
        return Plate(class_id, SIGN_COLOR, np.asarray(element.points))
    if element.label == ElementClass.PILLAR:
        return _pillar(element, class_id)
    return None


def _pillar(element: MapElement, class_id: int) -> Box:
    """The pillar from below its lowest corner to its top."""
    center, size = element.points.mean(axis=0), float(element.attributes["size"])
    middle = center + [0.0, 0.0, 0.5 * element.height_m - 0.25]
    return Box(class_id, PILLAR_COLOR, middle, (size, size, element.height_m + 0.5), np.eye(3))


def _frustum(element: MapElement, class_id: int, color: tuple, radius_m: float, radius_top_m: float) -> Frustum:
    base, top = element.points
    return Frustum(class_id, color, base, float(top[2] - base[2]), radius_m, radius_top_m)
