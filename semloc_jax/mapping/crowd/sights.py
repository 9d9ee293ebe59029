"""What one drive saw, laid into the frame of the map (room: mapping; host).

In: PackedDrive, the frame of the map. Out: Sights: things and lines with their place on the drive's way, and the area
that it looked at. A base map is laid out the same way: it is what somebody saw before.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import shapely
from jaxtyping import Bool, Float

from semloc_jax.evaluation.map_shapes import POSTS, is_line, kind_of, thing_of
from semloc_jax.geometry import polyline, rigid
from semloc_jax.geometry.geodesy import enu_from_wgs84, wgs84_from_enu
from semloc_jax.mapping.crowd.fragments import are_fragments
from semloc_jax.mapping.crowd.rejoined import rejoined
from semloc_jax.maps import Belief, BeliefMap, GeoOrigin, MapElement
from semloc_jax.maps.io.packed_drive import PackedDrive

_UPRIGHT_REACH_M = 6.0
"""Posts and signs beside the road are seen where the road nearby is."""
_FAR_M = 100.0
_SURVEYED_M, _DRIVEN_M = 0.02, 1.5
"""How far a surveyed map and that of one drive may be off as a whole; ours."""
LEAST_DRIVEN_M = 0.1
"""A map that may be off by more as a whole was made by drives; ours."""
_LEAST_SIGMA_M = (0.05, 0.02)
"""No drive knows a thing better along and across: what it sees is off alike in all its frames."""
CROWD = "crowd"
"""Provenance of what drives made together: its counts are of drives."""


@dataclass(frozen=True)
class Things:
    """Things with two sides and posts, as columns.

    Attributes:
        elements: in the frame of the map.
        beliefs: of each.
        kind: as `map_shapes` names them.
        centre: `float64[n 2]` [m].
        along: unit `float64[n 2]` along the longest side.
        half_m: `float64[n 2]` half the length and half the width.
        has_ends: whether both ends were seen: else the middle of what was seen is not that of the thing.
        sigma_m: `float64[n 2]` along and across.
    """

    elements: tuple[MapElement, ...]
    beliefs: tuple[Belief, ...]
    kind: np.ndarray
    centre: Float[np.ndarray, "n 2"]
    along: Float[np.ndarray, "n 2"]
    half_m: Float[np.ndarray, "n 2"]
    has_ends: Bool[np.ndarray, " n"]
    sigma_m: Float[np.ndarray, "n 2"]

    @classmethod
    def of(cls, known: Sequence[tuple[MapElement, Belief]]) -> "Things":
        """The columns of elements that are no lines."""
        n = len(known)
        shapes = [thing_of(element) for element, _ in known]
        along = np.array([s.along for s in shapes]).reshape(n, 2)
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        half = [[np.ptp(s.corners @ a), np.ptp(s.corners @ b)] for s, a, b in zip(shapes, along, across, strict=True)]
        # Of a post the corners are the two ends of its axis.
        half = [[0.0, 0.0] if e.label in POSTS else h for (e, _), h in zip(known, half, strict=True)]
        # Of a stop line a drive often sees a part: traffic hides it, its own lane ends.
        kind, centre = np.array([kind_of(e) for e, _ in known], dtype=object), np.array([s.centre for s in shapes])
        centre, half_m = centre.reshape(n, 2), 0.5 * np.array(half).reshape(n, 2)
        has_ends = np.array([all(s.ends) for s in shapes], dtype=bool) & (kind != "stop_line")
        sigma = np.array([[b.sigma_along_m, b.sigma_across_m] for _, b in known]).reshape(n, 2)
        return cls(
            tuple(e for e, _ in known),
            tuple(b for _, b in known),
            kind,
            centre,
            along,
            half_m,
            has_ends & ~are_fragments(kind, centre, along, half_m),
            np.maximum(sigma, np.outer([num_drives_of(b) ** -0.5 for _, b in known], _LEAST_SIGMA_M)),
        )

    def __len__(self) -> int:
        return len(self.elements)


@dataclass(frozen=True)
class Sights:
    """What one drive saw.

    Attributes:
        name: of the drive.
        things: in the frame of the map.
        lines: elements that are compared by the metre, with their beliefs.
        way: `float64[k 2]` in the map [m]; empty for a base map.
        sigma_place_m: how far all of it may be off together.
        area: of the road that was looked at; None for a base map.
        when_s: when; None where unknown.
        source: hash of the map that it was packed from.
        num_drives: of so many drives it is the sum; more than 1 for a base map that drives made.
        scale: how many times as large wheels and fixes alone have its way.
    """

    name: str
    things: Things
    lines: tuple[tuple[MapElement, Belief], ...]
    way: Float[np.ndarray, "k 2"]
    sigma_place_m: float
    area: shapely.Geometry | None
    when_s: float | None = None
    source: str = ""
    num_drives: int = 1
    scale: float = 1.0

    @property
    def is_base(self) -> bool:
        """Whether it is the map that was there before."""
        return self.area is None

    @cached_property
    def upright_area(self) -> shapely.Geometry | None:
        """Where posts and signs would have been seen."""
        return None if self.area is None else self.area.buffer(_UPRIGHT_REACH_M)

    def feet(self, xy: Float[np.ndarray, "n 2"]) -> tuple[np.ndarray, np.ndarray]:
        """Arc length of the place of the way nearest to each point, and that place `[n 2]`; themselves for a base."""
        if self.is_base or not len(xy):
            return np.zeros(len(xy)), xy
        s_m = polyline.nearest(self.way, xy).s_m
        return s_m, polyline.interpolate(self.way, s_m)


def sights_of(drive: PackedDrive, origin: GeoOrigin | None) -> Sights:
    """What a drive saw, in the frame of a map with that place on the earth."""
    x, y, z, heading_rad = _placed(drive, origin)
    T = rigid.planar_pose(x, y, heading_rad, z)
    known = [(_moved(T, e), drive.beliefs.beliefs[e.id]) for e in drive.beliefs.map.elements if not e.is_logical]
    known = rejoined(known)
    way = drive.way[:, :3] @ T[:3, :3].T + T[:3, 3]
    area = shapely.union_all([shapely.Polygon(ring @ T[:2, :2].T + T[:2, 3]).buffer(0.0) for ring in drive.rings])
    things = Things.of([item for item in known if not is_line(item[0])])
    lines = tuple(item for item in known if is_line(item[0]))
    told = drive.sigma_place_m, area, drive.when_s, drive.source
    return Sights(drive.name, things, lines, way[:, :2], *told, scale=drive.scale)


@dataclass(frozen=True)
class Base:
    """A map that was there before.

    Attributes:
        beliefs: the map.
        sigma_place_m: how far all of it may be off together.
        num_drives: so many drives made it; 1 for what somebody surveyed, or one drive made.
    """

    beliefs: BeliefMap
    sigma_place_m: float
    num_drives: int = 1

    @classmethod
    def of(cls, beliefs: BeliefMap) -> "Base":
        """A map of unknown making: one that a drive made lies where its satellite fixes put it."""
        driven = any(b.num_seen > 0 and b.provenance != CROWD for b in beliefs.beliefs.values())
        return cls(beliefs, _DRIVEN_M if driven else _SURVEYED_M)

    @property
    def is_surveyed(self) -> bool:
        """Whether it lies where it lies, whatever drives say."""
        return self.sigma_place_m < LEAST_DRIVEN_M


def base_sights(base: Base) -> Sights:
    """What the map before says, as if it had been seen once."""
    known = [(e, base.beliefs.beliefs[e.id]) for e in base.beliefs.map.elements if not e.is_logical]
    things = Things.of([item for item in known if not is_line(item[0])])
    lines = tuple(item for item in known if is_line(item[0]))
    way = np.zeros((0, 2))
    return Sights(base.beliefs.map.name, things, lines, way, base.sigma_place_m, None, num_drives=base.num_drives)


def num_drives_of(belief: Belief) -> int:
    """How many drives a belief is the sum of."""
    return max(belief.num_seen, 1) if belief.provenance == CROWD else 1


def _placed(drive: PackedDrive, origin: GeoOrigin | None) -> np.ndarray:
    """x, y, z, heading of the drive's frame in the map."""
    if origin is None or drive.origin is None or origin == drive.origin:
        return drive.place
    x, y, z, heading_rad = drive.place
    ahead = _FAR_M * np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0])
    two = np.array([x, y, z]) + np.array([np.zeros(3), ahead])
    here, there = enu_from_wgs84(*wgs84_from_enu(two, drive.origin), origin)
    return np.array([*here, np.arctan2(there[1] - here[1], there[0] - here[0])])


def _moved(T: np.ndarray, element: MapElement) -> MapElement:
    normal = None if element.normal is None else T[:3, :3] @ element.normal
    return replace(element, points=element.points @ T[:3, :3].T + T[:3, 3], normal=normal)
