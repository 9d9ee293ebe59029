"""Things that stand on the ground of a simulated scene, and where rays hit them (room: simulation; host).

In: rays. Out: distances to the first hit, normals there; each solid has a class id and a colour.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from semloc_jax.datasets.drive import CLASS_IDS

Points = Float[np.ndarray, "n 3"]


@dataclass(frozen=True)
class Solid(ABC):
    """A shape with a label.

    Args:
        class_id: id in the masks.
        color: albedo, blue green red in [0, 1].
    """

    class_id: int
    color: tuple[float, float, float]

    @property
    @abstractmethod
    def bounds(self) -> tuple[np.ndarray, float]:
        """Centre [3] and radius [m] of a sphere around it."""

    @abstractmethod
    def hit(self, origin: Float[np.ndarray, "3"], ray: Points) -> Float[np.ndarray, " n"]:
        """Distance along unit rays to the first hit, inf where they miss."""

    @abstractmethod
    def normal_at(self, point: Points, ray: Points) -> Points:
        """Unit normals at points of the surface that are hit by `ray`."""


@dataclass(frozen=True)
class Frustum(Solid):
    """Upright round pole or cone without lids: radius changes linearly from base to top."""

    base: np.ndarray
    height_m: float
    radius_m: float
    radius_top_m: float

    @property
    def bounds(self) -> tuple[np.ndarray, float]:
        widest = max(self.radius_m, self.radius_top_m)
        return self.base + [0.0, 0.0, 0.5 * self.height_m], float(np.hypot(0.5 * self.height_m, widest))

    def hit(self, origin: Float[np.ndarray, "3"], ray: Points) -> Float[np.ndarray, " n"]:
        offset = origin - self.base
        taper = (self.radius_top_m - self.radius_m) / self.height_m
        radius_here = self.radius_m + taper * offset[2]
        # |xy offset + t xy ray|^2 = (radius_here + t taper ray_z)^2
        a = ray[:, 0] ** 2 + ray[:, 1] ** 2 - (taper * ray[:, 2]) ** 2
        b = ray[:, 0] * offset[0] + ray[:, 1] * offset[1] - radius_here * taper * ray[:, 2]
        c = offset[0] ** 2 + offset[1] ** 2 - radius_here**2
        root = b * b - a * c
        safe_a = np.where(np.abs(a) > 1e-12, a, 1.0)
        t = (-b - np.sqrt(np.maximum(root, 0.0))) / safe_a
        z = offset[2] + t * ray[:, 2]
        seen = (root >= 0.0) & (np.abs(a) > 1e-12) & (t > 0.0) & (z >= 0.0) & (z <= self.height_m)
        return np.where(seen, t, np.inf)

    def normal_at(self, point: Points, ray: Points) -> Points:
        outward = (point - self.base) * [1.0, 1.0, 0.0]
        return outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)


@dataclass(frozen=True)
class Box(Solid):
    """Box with its own axes: columns of R_map_box."""

    center: np.ndarray
    size_m: tuple[float, float, float]
    R_map_box: np.ndarray

    @property
    def bounds(self) -> tuple[np.ndarray, float]:
        return self.center, 0.5 * float(np.linalg.norm(self.size_m))

    def hit(self, origin: Float[np.ndarray, "3"], ray: Points) -> Float[np.ndarray, " n"]:
        start = (origin - self.center) @ self.R_map_box
        enter, leave = np.zeros(len(ray)), np.full(len(ray), np.inf)
        for axis, half in enumerate(0.5 * np.asarray(self.size_m)):
            direction = ray @ self.R_map_box[:, axis]
            direction = np.where(np.abs(direction) < 1e-12, 1e-12, direction)
            one, other = (-half - start[axis]) / direction, (half - start[axis]) / direction
            np.maximum(enter, np.minimum(one, other), out=enter)
            np.minimum(leave, np.maximum(one, other), out=leave)
        # A ray that starts inside the box enters at zero: it does not see the box.
        return np.where((enter <= leave) & (enter > 0.0), enter, np.inf)

    def normal_at(self, point: Points, ray: Points) -> Points:
        local = (point - self.center) @ self.R_map_box / (0.5 * np.asarray(self.size_m))
        axis = np.argmax(np.abs(local), axis=1)
        side = np.sign(np.take_along_axis(local, axis[:, None], axis=1))
        return self.R_map_box.T[axis] * side


@dataclass(frozen=True)
class Plate(Solid):
    """Flat convex polygon seen from both sides, vertices in order."""

    outline: np.ndarray

    @property
    def bounds(self) -> tuple[np.ndarray, float]:
        center = self.outline.mean(axis=0)
        return center, float(np.linalg.norm(self.outline - center, axis=1).max())

    def hit(self, origin: Float[np.ndarray, "3"], ray: Points) -> Float[np.ndarray, " n"]:
        normal = self._normal
        speed = ray @ normal
        speed = np.where(np.abs(speed) < 1e-12, 1e-12, speed)
        t = ((self.outline[0] - origin) @ normal) / speed
        # A point is inside a convex outline when it is on the same side of every edge; the edge normals are dotted
        # with the hit point directly, without building the points.
        inside = t > 0.0
        for vertex, edge in zip(self.outline, np.roll(self.outline, -1, axis=0) - self.outline, strict=True):
            inward = np.cross(normal, edge)
            inside &= (origin - vertex) @ inward + t * (ray @ inward) >= 0.0
        return np.where(inside, t, np.inf)

    def normal_at(self, point: Points, ray: Points) -> Points:
        return -np.sign(ray @ self._normal)[:, None] * self._normal

    @property
    def _normal(self) -> np.ndarray:
        normal = np.cross(self.outline[1] - self.outline[0], self.outline[2] - self.outline[1])
        return normal / np.linalg.norm(normal)


@dataclass(frozen=True)
class Ball(Solid):
    """Sphere: the crown of a tree."""

    center: np.ndarray
    radius_m: float

    @property
    def bounds(self) -> tuple[np.ndarray, float]:
        return self.center, self.radius_m

    def hit(self, origin: Float[np.ndarray, "3"], ray: Points) -> Float[np.ndarray, " n"]:
        offset = origin - self.center
        b = ray @ offset
        root = b * b - (offset @ offset - self.radius_m**2)
        t = -b - np.sqrt(np.maximum(root, 0.0))
        return np.where((root >= 0.0) & (t > 0.0), t, np.inf)

    def normal_at(self, point: Points, ray: Points) -> Points:
        return (point - self.center) / self.radius_m


def rotation_about_z(yaw_rad: float) -> np.ndarray:
    """R [3 3] of a heading."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def car(base: np.ndarray, R_map_car: np.ndarray, color: tuple[float, float, float]) -> list[Solid]:
    """Body and cabin of a car whose centre stands on the ground at `base`."""
    forward, up, class_id = R_map_car[:, 0], R_map_car[:, 2], CLASS_IDS["vehicle"]
    body = Box(class_id, color, base + 0.55 * up, (4.5, 1.8, 0.75), R_map_car)
    cabin = Box(class_id, (0.18, 0.17, 0.16), base + 1.2 * up - 0.2 * forward, (2.4, 1.6, 0.55), R_map_car)
    return [body, cabin]


def own_body() -> Box:
    """The body of the own vehicle in the base frame, as its fisheyes see it."""
    return Box(CLASS_IDS["ego"], (0.3, 0.3, 0.32), np.array([1.4, 0.0, 0.55]), (4.62, 1.86, 0.6), np.eye(3))


def tree(
    base: np.ndarray, crown_m: float, foot_m: float, stem_m: tuple[float, float, float] = (3.0, 0.16, 0.12)
) -> list[Solid]:
    """A stem (height, radius below and above) and a round crown of this radius, which begins at `foot_m` [m]."""
    green, top = CLASS_IDS["vegetation"], base + [0.0, 0.0, foot_m + crown_m]
    return [Frustum(green, (0.2, 0.28, 0.35), base, *stem_m), Ball(green, (0.15, 0.4, 0.22), top, crown_m)]


def house(base: np.ndarray, R_map_wall: np.ndarray, size_m: tuple[float, float, float], shade: float) -> Box:
    """A house of this width, depth and height over the ground in its middle; it stands some metres in it, too."""
    width, depth, height = size_m
    color, middle = tuple(shade * np.array([0.75, 0.9, 1.0])), base + [0.0, 0.0, 0.5 * height - 2.0]
    return Box(CLASS_IDS["building"], color, middle, (width, depth, height + 4.0), R_map_wall)
