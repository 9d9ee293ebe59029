"""What stands on the road, in parts that are painted one after the other (room: simulation; host).

In: sizes, colours. Out: Body: BoxPart, RoundPart, Sheet, Bar parts with patterns on them; `paint` puts one on a Canvas.
"""

from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import Float

from semloc_jax.simulation.cylinder_views.canvas import Canvas, Colour

_AROUND = np.linspace(0.0, 2.0 * np.pi, 15)[:-1]
_CIRCLE = np.column_stack([np.cos(_AROUND), np.sin(_AROUND), np.zeros(14)])
UNIT = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
"""A face by its shares of width and height, from its lower left corner."""


class Patch(NamedTuple):
    """A spot of another colour on a face: its corners as shares of width and height, convex."""

    outline: Float[np.ndarray, "n 2"]
    colour: Colour


@runtime_checkable
class Part(Protocol):
    """Anything that can be painted."""

    def paint(self, canvas: Canvas, thing: int) -> None:
        """Put it on a canvas, as a part of a thing."""


class BoxPart(NamedTuple):
    """Four sides and a lid between two quadrilaterals: boxes, cabins of cars.

    Args:
        low, high: `float64[4 3]`, corners against the clock seen from above.
        colour: of all sides.
        patches: of each of the four sides, in the order of the corners; None for none.
    """

    low: Float[np.ndarray, "4 3"]
    high: Float[np.ndarray, "4 3"]
    colour: Colour
    patches: tuple[tuple[Patch, ...], ...] = ((), (), (), ())

    def paint(self, canvas: Canvas, thing: int) -> None:
        """The sides that face the camera."""
        for k, patches in enumerate(self.patches):
            j = (k + 1) % 4
            _face(canvas, np.array([self.low[k], self.low[j], self.high[j], self.high[k]]), self.colour, patches, thing)
        _face(canvas, self.high, self.colour, (), thing)


class Band(NamedTuple):
    """A piece of a RoundPart: from `low_m` to `high_m` over the road, radius there, colour."""

    low_m: float
    high_m: float
    radius_low_m: float
    radius_high_m: float
    colour: Colour


class RoundPart(NamedTuple):
    """Something round and upright, in bands from below to above."""

    middle: Float[np.ndarray, " 2"]
    bands: tuple[Band, ...]

    def paint(self, canvas: Canvas, thing: int) -> None:
        """Each band with its bright side."""
        base, side = np.append(self.middle, 0.0), 0.6 * canvas.light * [1.0, 1.0, 0.0]
        for band in self.bands:
            low, high = base + [0.0, 0.0, band.low_m], base + [0.0, 0.0, band.high_m]
            rings = [low + band.radius_low_m * _CIRCLE, high + band.radius_high_m * _CIRCLE]
            canvas.hull(np.concatenate(rings), band.colour * (0.5 * canvas.ambient + 0.4), thing)
            lit = [
                low + band.radius_low_m * (0.6 * _CIRCLE + 0.6 * side),
                high + band.radius_high_m * (0.6 * _CIRCLE + 0.6 * side),
            ]
            canvas.hull(np.concatenate(lit), band.colour, thing)


class Sheet(NamedTuple):
    """A flat quadrilateral that is seen from both sides, corners from the lower left one against the clock."""

    corners: Float[np.ndarray, "4 3"]
    colour: Colour
    patches: tuple[Patch, ...] = ()

    def paint(self, canvas: Canvas, thing: int) -> None:
        """The side that faces the camera."""
        corners = self.corners if canvas.faces_us(self.corners) else self.corners[[1, 0, 3, 2]]
        _face(canvas, corners, self.colour, self.patches, thing)


class Bar(NamedTuple):
    """A bent bar in stripes: places along it, its thickness, the colours that take turns."""

    places: Float[np.ndarray, "n 3"]
    wide_m: float
    colours: tuple[Colour, ...]

    def paint(self, canvas: Canvas, thing: int) -> None:
        """Piece after piece."""
        for k, (a, b) in enumerate(zip(self.places[:-1], self.places[1:], strict=True)):
            canvas.bar(np.array([a, b]), self.wide_m, self.colours[k % len(self.colours)], thing)


@dataclass
class Body:
    """One thing.

    Attributes:
        parts: painted in this order.
        middle: float64[2] of its footprint.
        footprint: float64[n 2], convex.
        height_m: of its top.
        kind: class of OBSTACLES; "" for what is none.
    """

    middle: Float[np.ndarray, " 2"]
    footprint: Float[np.ndarray, "n 2"]
    height_m: float
    kind: str = ""
    parts: list[Part] = field(default_factory=list)

    def paint(self, canvas: Canvas, thing: int = 0) -> None:
        """All of it, its farthest parts first."""
        for part in self.parts:
            part.paint(canvas, thing)

    def shadow(self, light: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "n 3"]:
        """Outline on the road."""
        step = -light[:2] / max(float(light[2]), 0.2) * min(self.height_m, 3.0)
        both = np.concatenate([self.footprint, self.footprint + step]).astype(np.float32)
        flat = cv2.convexHull(both)[:, 0].astype(float)
        return np.column_stack([flat, np.zeros(len(flat))])


def box(
    middle: Float[np.ndarray, " 2"],
    size_m: tuple[float, float],
    yaw: float,
    low_m: float,
    high_m: float,
    colour: Colour,
    patches: tuple[tuple[Patch, ...], ...] = ((), (), (), ()),
    taper: float = 1.0,
) -> BoxPart:
    """An upright box; sides in the order right, front, left, back of its yaw.

    Args:
        middle: of its base.
        size_m: along its yaw and across it.
        yaw: from x towards y.
        low_m, high_m: over the road.
        colour, patches: of its sides.
        taper: its lid is so much smaller.
    """
    flat = rectangle(size_m, yaw)
    low, high = (
        np.column_stack([middle + flat, np.full(4, low_m)]),
        np.column_stack([middle + taper * flat, np.full(4, high_m)]),
    )
    return BoxPart(low, high, colour, patches)


def rectangle(size_m: tuple[float, float], yaw: float) -> Float[np.ndarray, "4 2"]:
    """Corners against the clock around zero: back right, front right, front left, back left."""
    flat = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size_m
    c, s = np.cos(yaw), np.sin(yaw)
    return flat @ np.array([[c, s], [-s, c]])


def stripes(
    colours: tuple[Colour, Colour], num: int, slope: float, low: float = 0.0, high: float = 1.0
) -> tuple[Patch, ...]:
    """Stripes across a part of a face; slope 0 runs level."""
    area = np.array([[0.0, low], [1.0, low], [1.0, high], [0.0, high]], np.float32)
    found, step = [Patch(area.astype(float), colours[0])], (high - low + abs(slope)) / num
    for k in range(0, num, 2):
        start = low + k * step - max(slope, 0.0)
        slanted = np.array([[0, start], [1, start + slope], [1, start + slope + step], [0, start + step]], np.float32)
        size, part = cv2.intersectConvexConvex(area, slanted)
        if size > 1e-4 and part is not None:
            found.append(Patch(part[:, 0].astype(float), colours[1]))
    return tuple(found)


def _face(
    canvas: Canvas, corners: Float[np.ndarray, "4 3"], colour: Colour, patches: tuple[Patch, ...], thing: int
) -> None:
    """One side, where it faces the camera, from its lower left corner against the clock as seen from there."""
    if not canvas.faces_us(corners):
        return
    normal = np.cross(corners[1] - corners[0], corners[3] - corners[0])
    shade = canvas.shade(normal / max(float(np.linalg.norm(normal)), 1e-9))
    wide_m = float(np.linalg.norm(corners[1] - corners[0]))
    num = int(np.clip(np.ceil(2.0 * wide_m / max(float(np.linalg.norm(corners[0, :2])), 0.5)), 2, 12))
    canvas.area(corners, shade * colour, thing, num)
    for outline, own in patches:
        a, b = outline.T
        low = corners[0] + a[:, None] * (corners[1] - corners[0])
        high = corners[3] + a[:, None] * (corners[2] - corners[3])
        canvas.area(low + b[:, None] * (high - low), shade * own, thing, num)
