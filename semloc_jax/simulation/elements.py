"""Map elements of simulated scenes, draped on their ground (room: simulation; host).

In: places in the plane. Out: MapElement with the properties a drive map states.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from semloc_jax.maps import MapElement
from semloc_jax.maps.elements import VIRTUAL
from semloc_jax.simulation.path import PlanePath
from semloc_jax.simulation.surface import Surface
from semloc_jax.structs import ElementClass

_SPACING_M = 1.0
"""Vertices of lines: on a curve of 160 m radius the chord is off by less than 1 mm."""

_STYLES = {"lane_solid": "solid", "lane_dashed": "dashed", "lane_boundary": VIRTUAL}

_LIGHT_M = 0.32, 0.95
"""Width and height of a traffic light."""

ARROW = np.array([(-2.5, -0.08), (0.9, -0.08), (0.9, -0.4), (2.5, 0.0), (0.9, 0.4), (0.9, 0.08), (-2.5, 0.08)])
"""Outline of a straight arrow: along it and across [m], the tip ahead."""

ARROW_TIP = 4 * 3
"""Which point of an arrow is its tip: its edges are divided into four."""


@dataclass(frozen=True)
class Painter:
    """Makes elements along a path on a surface; s [m] along the path, d [m] to its left."""

    path: PlanePath
    surface: Surface

    def line(
        self, name: str, paint: str, d_m: float, from_m: float, to_m: float, width_m: float, **attributes: str
    ) -> MapElement:
        """A lane line parallel to the path; `paint` is lane_solid or lane_dashed (one dash)."""
        return self.curve(name, paint, lambda s: np.full_like(s, d_m), from_m, to_m, width_m, **attributes)

    def curve(
        self,
        name: str,
        paint: str,
        d_of_s: Callable[[np.ndarray], np.ndarray],
        from_m: float,
        to_m: float,
        width_m: float,
        **attributes: str,
    ) -> MapElement:
        """A lane line whose distance from the path changes along it; a lane_boundary is logical, not painted."""
        s = np.linspace(from_m, to_m, max(2, round((to_m - from_m) / _SPACING_M) + 1))
        style = _STYLES[paint]
        return MapElement(
            id=name,
            label=ElementClass.LANE_MARKING,
            points=self.surface.drape(self.path.at(s, d_of_s(s))),
            width_m=width_m,
            style=style,
            attributes={"class": paint, "width": width_m, "color": "white", **attributes},
        )

    def dashes(
        self, name: str, d_m: float, from_m: float, to_m: float, dash_m: float, gap_m: float
    ) -> list[MapElement]:
        """Painted bars of a dashed lane line, one element each."""
        starts = np.arange(from_m, to_m - dash_m, dash_m + gap_m)
        return [
            self.line(f"{name}_{k}", "lane_dashed", d_m, s, s + dash_m, 0.15, parent=name)
            for k, s in enumerate(starts.tolist())
        ]

    def area(
        self, name: str, paint: str, label: ElementClass, s_m: np.ndarray, d_m: np.ndarray, **attributes: str
    ) -> MapElement:
        """A painted area with the given corners; its edges are divided so that they follow the ground."""
        s, d = _divided(s_m), _divided(d_m)
        points = self.surface.drape(self.path.at(s, d))
        return MapElement(name, label, points, closed=True, attributes={"class": paint, "color": "white", **attributes})

    def bar(
        self, name: str, paint: str, label: ElementClass, s_range: tuple[float, float], d_range: tuple[float, float]
    ) -> MapElement:
        """A painted rectangle: stop line, crosswalk bar, slot line."""
        s, d = np.array(s_range)[[0, 1, 1, 0]], np.array(d_range)[[0, 0, 1, 1]]
        return self.area(name, paint, label, s, d)

    def arrow(self, name: str, s_m: float, d_m: float, is_forward: bool = True) -> MapElement:
        """An arrow 5 m long whose middle is at (s, d)."""
        sign = 1.0 if is_forward else -1.0
        return self.area(
            name, "arrow", ElementClass.ROAD_MARK, s_m + sign * ARROW[:, 0], d_m + sign * ARROW[:, 1], kind="straight"
        )

    def place(self, s_m: float, d_m: float) -> np.ndarray:
        """Ground point [3] at (s, d)."""
        return self.surface.drape(self.path.at(np.array([s_m]), np.array([d_m])))[0]

    def heading(self, s_m: float) -> float:
        """Heading of the path [rad]."""
        return float(self.path.heading_at(np.array([s_m]))[0])


def pole(name: str, base: np.ndarray, height_m: float, radius_m: float, radius_top_m: float, kind: str) -> MapElement:
    """An upright pole."""
    attributes = {"class": "pole", "radius": radius_m, "radius_top": radius_top_m, "kind": kind}
    points = np.array([base, base + [0.0, 0.0, height_m]])
    return MapElement(
        name, ElementClass.POLE, points, radius_m=radius_m, radius_top_m=radius_top_m, attributes=attributes
    )


def cone(name: str, base: np.ndarray) -> MapElement:
    """A traffic cone 0.7 m high."""
    points = np.array([base, base + [0.0, 0.0, 0.7]])
    attributes = {"class": "cone", "radius": 0.15}
    return MapElement(name, ElementClass.CONE, points, radius_m=0.15, attributes=attributes)


def traffic_light(name: str, foot: np.ndarray) -> MapElement:
    """The housing of a traffic light above `foot`."""
    points = np.array([foot, foot + [0.0, 0.0, _LIGHT_M[1]]])
    attributes = {"class": "traffic_light", "width": _LIGHT_M[0]}
    return MapElement(name, ElementClass.TRAFFIC_LIGHT, points, width_m=_LIGHT_M[0], attributes=attributes)


def sign(name: str, center: np.ndarray, facing_rad: float, shape: str, size_m: float) -> MapElement:
    """An upright sign whose face looks towards the heading `facing_rad`."""
    corners = {"circle": 32, "triangle": 3, "rectangle": 4}[shape]
    start = {"circle": 0.0, "triangle": 90.0, "rectangle": 45.0}[shape]
    angle = np.radians(start) + 2.0 * np.pi * np.arange(corners) / corners
    radius = size_m / 2.0 if shape == "circle" else size_m / np.sqrt(2.0 if shape == "rectangle" else 3.0)
    normal = np.array([np.cos(facing_rad), np.sin(facing_rad), 0.0])
    # Seen by someone in front of the face, `right` is to the right, and the outline runs counter-clockwise.
    right = np.array([-normal[1], normal[0], 0.0])
    up = np.array([0.0, 0.0, 1.0])
    points = center + radius * (np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * up)
    return MapElement(
        id=name,
        label=ElementClass.SIGN,
        points=points,
        closed=True,
        shape=shape,
        normal=normal,
        attributes={
            "class": "sign",
            "shape": shape,
            "center": [float(v) for v in center],
            "width": size_m,
            "height": size_m,
        },
    )


def pillar(name: str, footprint: np.ndarray, height_m: float) -> MapElement:
    """A square pillar on a footprint [4 3]."""
    size = float(np.linalg.norm(footprint[1] - footprint[0]))
    attributes = {"class": "pillar", "height": height_m, "size": size}
    return MapElement(name, ElementClass.PILLAR, footprint, closed=True, height_m=height_m, attributes=attributes)


def with_attributes(element: MapElement, **attributes: str | bool) -> MapElement:
    """The element with more said about it."""
    return replace(element, attributes={**element.attributes, **attributes})


def shifted(element: MapElement, shift: Float[np.ndarray, "*k 3"]) -> MapElement:
    """The element moved by `shift` [m], one for all of its points or one for each; its stated centre with the first."""
    attributes = dict(element.attributes)
    if "center" in attributes:
        first = np.atleast_2d(shift)[0]
        attributes["center"] = [float(a + b) for a, b in zip(attributes["center"], first, strict=True)]
    return replace(element, points=element.points + shift, attributes=attributes)


def _divided(corners: np.ndarray) -> np.ndarray:
    """Corner coordinates with three more points on every edge."""
    step = np.roll(corners, -1) - corners
    return (corners[:, None] + step[:, None] * np.array([0.0, 0.25, 0.5, 0.75])).ravel()
