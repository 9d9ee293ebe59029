"""Paint of a map found again in a top view: how far surveyed corners are off (room: perception; host).

In: a top view, the true pose, a map. Out: for each surveyed corner its place and error [m].
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from semloc_jax.cameras import BevCamera
from semloc_jax.maps import MapElement
from semloc_jax.maps.contours import painted_polygon
from semloc_jax.perception.surround import SurroundView
from semloc_jax.perception.surround_quality import peak, tells_place
from semloc_jax.structs import ElementClass

_PATCH_M, _REACH_M = 0.9, 0.25
_LEAST_SCORE = 0.6
_SHIFT = 6
_LEAST_PAINT, _MOST_PAINT = 0.04, 0.7
_FLAT_RATIO = 0.08


@dataclass(frozen=True)
class CornerError:
    """One surveyed corner.

    Attributes:
        p_base: float64[2], where it is in the base frame [m].
        off_m: float64[2], where the top view shows it less where it is, in the base frame.
        score: correlation of the picture with the paint of the map there.
    """

    p_base: Float[np.ndarray, " 2"]
    off_m: Float[np.ndarray, " 2"]
    score: float


def corner_errors(
    top: np.ndarray,
    view: SurroundView,
    elements: Sequence[MapElement],
    T_map_base: Float[np.ndarray, "4 4"],
) -> list[CornerError]:
    """Errors of the corners of parking slots: the paint of the map is correlated with the picture around each.

    A corner counts where its whole patch is in the picture and shows paint in two directions that correlates.

    Args:
        top: uint8[h w 3] or a mask of paint uint8[h w]; 0 where nothing is seen.
        view: the top view that it is of.
        elements: painted elements, and slots whose corners were surveyed.
        T_map_base: true pose of the vehicle.
    """
    bev, T_base_bev = view.bev, view.T_base_bev
    grey = top if top.ndim == 2 else cv2.cvtColor(top, cv2.COLOR_BGR2GRAY)
    blind = cv2.erode((top if top.ndim == 2 else top.max(axis=2)), np.ones((3, 3), np.uint8)) == 0
    T_bev_map = np.linalg.inv(np.asarray(T_map_base, np.float64) @ T_base_bev)
    ideal = _drawn([e for e in elements if e.is_painted], bev, T_bev_map)
    scale, half, reach = float(bev.fx), round(0.5 * _PATCH_M * float(bev.fx)), round(_REACH_M * float(bev.fx))
    found = []
    for corner in _corners(elements):
        uv = _to_bev(corner[None], bev, T_bev_map)[0]
        u, v = (round(float(x)) for x in uv)
        inner = ideal[max(v - half, 0) : v + half + 1, max(u - half, 0) : u + half + 1]
        outer = slice(v - half - reach, v + half + reach + 1), slice(u - half - reach, u + half + reach + 1)
        if min(v, u) < half + reach or max(v - grey.shape[0], u - grey.shape[1]) >= -half - reach:
            continue
        if (top.ndim == 3 and blind[outer].mean() > 0.02) or not _is_corner(inner):
            continue
        scores = cv2.matchTemplate(grey[outer].astype(np.float32), inner.astype(np.float32), cv2.TM_CCOEFF_NORMED)
        place = peak(scores)
        if place is None or place[2] < _LEAST_SCORE:
            continue
        off_bev = np.array([place[0] - reach, place[1] - reach]) / scale
        p_bev = np.array([(uv[0] - float(bev.cx)) / scale, (uv[1] - float(bev.cy)) / scale, 0.0])
        p_base = T_base_bev[:3, :3] @ p_bev + T_base_bev[:3, 3]
        found.append(CornerError(p_base[:2], T_base_bev[:2, :2] @ off_bev, float(place[2])))
    return found


def _corners(elements: Sequence[MapElement]) -> np.ndarray:
    """Corners of slots without repeats, float64[n 3]."""
    points = [e.points[:4] for e in elements if e.label == ElementClass.PARKING_SLOT]
    if not points:
        return np.zeros((0, 3))
    all_points = np.concatenate(points)
    return all_points[np.unique(np.round(all_points[:, :2] / 0.05).astype(int), axis=0, return_index=True)[1]]


def _to_bev(p_map: np.ndarray, bev: BevCamera, T_bev_map: np.ndarray) -> np.ndarray:
    p_bev = p_map @ T_bev_map[:3, :3].T + T_bev_map[:3, 3]
    return p_bev[:, :2] * float(bev.fx) + [float(bev.cx), float(bev.cy)]


def _drawn(elements: Sequence[MapElement], bev: BevCamera, T_bev_map: np.ndarray) -> np.ndarray:
    """The paint of the map from above, uint8[h w], with soft edges."""
    width, height = bev.resolution
    picture = np.zeros((2 * height, 2 * width), np.uint8)
    for element in elements:
        polygon = painted_polygon(element)
        if polygon is None or polygon.is_empty:
            continue
        # OpenCV fills the pixels that the outline passes, too: half a pixel too much on every side.
        polygon = polygon.buffer(-0.25 / float(bev.fx), join_style="mitre")
        if polygon.is_empty:
            continue
        xy = np.asarray(polygon.exterior.coords)[:, :2]
        z = np.full((len(xy), 1), float(element.points[:, 2].mean()))
        uv = 2.0 * _to_bev(np.hstack([xy, z]), bev, T_bev_map) + 0.5
        if (np.abs(uv) < 8 * max(width, height)).all():
            cv2.fillPoly(picture, [np.round(uv * 2**_SHIFT).astype(np.int32)], 255, shift=_SHIFT)
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)


def _is_corner(patch: np.ndarray) -> bool:
    """Whether a patch of paint has edges in two directions."""
    share = float(patch.mean()) / 255.0 if patch.size else 0.0
    return _LEAST_PAINT < share < _MOST_PAINT and tells_place(patch, 1.0, _FLAT_RATIO)
