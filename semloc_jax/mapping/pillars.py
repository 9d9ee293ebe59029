"""The outline of a pillar from the bearings of its two sides (room: mapping; host).

In: a Standing, its sightings. Out: MapElement: four corners on the road and a height.
From every place a box shows two edges, which are its corners farthest to the left and to the right as seen from there:
edges seen from many places hold its middle, its direction and its sides.
"""

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from semloc_jax.mapping.sightings import column
from semloc_jax.mapping.triangulation import HeightOf, Standing
from semloc_jax.maps import MapElement
from semloc_jax.structs import ElementClass

_STARTS_RAD = np.deg2rad([0.0, 30.0, 60.0])
"""A box that is turned by 90 deg is the same."""
_SQUARE_M = 0.15
"""By how much one side is longer than the other: from one aisle the far side is not seen. Ours."""
_PLACE_M = 0.02
"""Standard deviation of the way between frames."""
_LEAST_M = 0.1
_STEP_M = 0.3
"""The floor around a pillar is no farther above or below the road."""
_SIGNS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def pillar(name: str, thing: Standing, rows: Float[np.ndarray, "k 13"], height_of: HeightOf) -> MapElement:
    """The element of a pillar.

    Args:
        name: its id.
        thing: where it stands.
        rows: its sightings, see `sightings.COLUMNS`.
        height_of: height of the road.
    """
    corners = box_of(rows, thing.xy, thing.width_m)
    road_m = float(height_of(corners.mean(axis=0)[None])[0])
    # What stands before its foot is not always of a class that is known to.
    foot_m = thing.foot_m if thing.knows_foot and abs(thing.foot_m - road_m) < _STEP_M else road_m
    points = np.column_stack([corners, np.full(4, foot_m)])
    height_m = max(thing.top_m - foot_m, _LEAST_M)
    return MapElement(name, ElementClass.PILLAR, points, closed=True, height_m=height_m)


def box_of(rows: Float[np.ndarray, "k 13"], xy: Float[np.ndarray, " 2"], width_m: float) -> Float[np.ndarray, "4 2"]:
    """Corners of the rectangle whose edges lie where the sightings have them [m], counter-clockwise.

    Args:
        rows: sightings of a pillar, see `sightings.COLUMNS`.
        xy: about where it stands [m].
        width_m: about how wide it looks [m].
    """
    camera, bearing, half = rows[:, 2:4], column(rows, "bearing"), 0.5 * column(rows, "width")
    along = np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    range_m = np.maximum(np.linalg.norm(camera - xy, axis=1), 1.0)
    sigma_rad = np.hypot(column(rows, "sigma"), _PLACE_M / range_m)
    # From its diagonal a square looks 1.4 times as wide as its sides.
    size_m = max(width_m / 1.2, _LEAST_M)

    def residual(box: np.ndarray) -> np.ndarray:
        offset = corners_of(box)[None] - camera[:, None]
        ahead = np.einsum("kci,ki->kc", offset, along)
        aside = along[:, None, 0] * offset[..., 1] - along[:, None, 1] * offset[..., 0]
        off_rad = np.arctan2(aside, ahead)
        edges = np.stack([off_rad.max(axis=1) - half, off_rad.min(axis=1) + half]) / sigma_rad
        return np.append(edges.ravel(), (box[3] - box[4]) / _SQUARE_M)

    starts = (np.array([*xy, turn_rad, size_m, size_m]) for turn_rad in _STARTS_RAD)
    found = [least_squares(residual, start, loss="cauchy", f_scale=2.0, max_nfev=60) for start in starts]
    return corners_of(min(found, key=lambda one: one.cost).x)


def corners_of(box: Float[np.ndarray, " 5"]) -> Float[np.ndarray, "4 2"]:
    """Corners [m] of a rectangle: middle x, y [m], direction [rad], length and width [m]."""
    c, s = np.cos(box[2]), np.sin(box[2])
    half = 0.5 * np.maximum(np.abs(box[3:]), _LEAST_M)
    return box[:2] + (_SIGNS * half) @ np.array([[c, s], [-s, c]])
