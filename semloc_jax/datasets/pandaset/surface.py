"""The shape of the road between its paint (room: datasets; host).

In: lidar points of the road, the driven path. Out: logical map elements across the road, which no camera can see.
A vehicle in the right lane of a crowned street rolls by 3 deg; paint along the crown alone does not say so.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from semloc_jax.maps import MapElement
from semloc_jax.structs import ElementClass

_EVERY_M = 1.5
_REACH_M, _STEP_M = 1.6, 0.4
"""Half length of a profile and distance of its points [m]."""
_NEAR_M, _MIN_POINTS = 0.5, 8


def road_profiles(
    road: Float[np.ndarray, "n 3"], Ts_map_base: Float[np.ndarray, "k 4 4"], ahead_m: float = 15.0
) -> list[MapElement]:
    """Cross profiles of the road along the driven path and its straight continuation to both sides.

    Args:
        road: Points on the road surface in the map frame [m].
        Ts_map_base: Driven poses, in order.
        ahead_m: How far before the first and beyond the last pose the path is continued.
    """
    if len(road) < _MIN_POINTS:
        return []
    tree = cKDTree(road[:, :2])
    elements = []
    for number, T in enumerate(_stations(Ts_map_base, ahead_m)):
        offset = np.arange(-_REACH_M, _REACH_M + 1e-6, _STEP_M)
        xy = T[:2, 3] + offset[:, None] * T[:2, 1]
        near = tree.query_ball_point(xy, _NEAR_M)
        known = np.array([len(rows) >= _MIN_POINTS for rows in near])
        if known.sum() < 3:
            continue
        height = [np.median(road[rows, 2]) for rows, ok in zip(near, known, strict=True) if ok]
        elements.append(
            MapElement(
                id=f"profile_{number}",
                label=ElementClass.LANE_MARKING,
                points=np.column_stack([xy[known], height]),
                style="virtual",
                attributes={"class": "lane_boundary", "note": "height of the road, not painted"},
            )
        )
    return elements


def _stations(Ts_map_base: np.ndarray, ahead_m: float) -> list[np.ndarray]:
    """Poses every few metres of the path, continued straight at both ends."""
    stations = [Ts_map_base[0]]
    for T in Ts_map_base:
        if np.linalg.norm(T[:2, 3] - stations[-1][:2, 3]) >= _EVERY_M:
            stations.append(T)
    steps = np.arange(_EVERY_M, ahead_m + 1e-6, _EVERY_M)
    before = [_moved(Ts_map_base[0], -step) for step in steps[::-1]]
    return before + stations + [_moved(Ts_map_base[-1], step) for step in steps]


def _moved(T_map_base: np.ndarray, ahead_m: float) -> np.ndarray:
    T = T_map_base.copy()
    T[:3, 3] += ahead_m * T[:3, 0]
    return T
