"""Height of the road beside a way, told by short marks that many frames show (room: mapping; host).

In: looks at short marks along a way. Out: RoadProfile, None where marks tell nothing but a plane.
A built road falls to both sides of its crown. What lies lower than the plane of the vehicle is drawn too far away, and
elsewhere from each place; at its true height all looks at a mark meet.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from semloc_jax.mapping.mark_looks import MarkLooks
from semloc_jax.mapping.road_profile import RoadProfile

_KNOTS_M = np.arange(-12.0, 12.1, 0.75)
"""Distances to the left of the way at which a profile is told."""
_LANE_M = 1.75
"""Half of the own lane, which is the plane that the wheels stand on."""
_BIN_M = 1.5
"""Looks at this width of the road tell one height."""
_STEP_M = 0.025
_HEIGHTS_M = np.arange(-0.6, 0.601, _STEP_M)
_APART_M = 1.5
"""Two looks from nearer places meet at any height."""
_MEETS_M = 0.12
"""By which looks at one mark miss each other at its true height: borders of masks, heading and pitch of a frame."""
_LEAST_LOOKS = 30
_LEAST_MET = 0.7
"""Other looks that must meet a look, on average: with fewer, chance does it."""
_LEAST_CONTRAST = 2.0
"""How many times as many must meet as at other heights: rows of marks meet their neighbours at any."""
_TOLD_SIGMA_M = 0.03
_SLOPE_SIGMA, _BEND_SIGMA = 0.1, 0.05
"""Slopes across roads, and by how much they change within a knot."""
_PLANE_M = 2.0 * _TOLD_SIGMA_M
"""A profile that stays as near to the plane is the plane."""
_STRETCH_M = 100.0
"""Way along which one profile is told, since vehicles pitch and few marks scatter; half of it from one to the next."""


def road_profile(looks: MarkLooks, Ts_map_base: Float[np.ndarray, "n 4 4"]) -> RoadProfile | None:
    """The profile of the road beside a way; None where short marks tell of none.

    Args:
        looks: at short marks, of frames of the way.
        Ts_map_base: its poses; the plane z = 0 of each is the road under the wheels.
    """
    steps = np.linalg.norm(np.diff(Ts_map_base[:, :3, 3], axis=0), axis=1)
    way_m = np.append(0.0, np.cumsum(steps))
    at_m, told = [], []
    for middle_m in np.arange(0.0, way_m[-1] + 0.25 * _STRETCH_M, 0.5 * _STRETCH_M):
        near = np.abs(way_m[looks.frame] - middle_m) <= 0.5 * _STRETCH_M
        heights = _profile(looks.where(near), Ts_map_base)
        if heights is not None:
            at_m.append(middle_m)
            told.append(heights)
    if not told:
        return None
    return RoadProfile(_KNOTS_M, _along(way_m, np.array(at_m), np.array(told)))


def _along(way_m: np.ndarray, at_m: np.ndarray, told: np.ndarray) -> np.ndarray:
    """Profiles of all poses from those of some stretches: between them in line, far from them the plane."""
    plane = np.zeros(told.shape[1])
    places, rows = [at_m[0] - _STRETCH_M], [plane]
    for k, place in enumerate(at_m):
        if k and place - at_m[k - 1] > 2.0 * _STRETCH_M:
            places += [at_m[k - 1] + _STRETCH_M, place - _STRETCH_M]
            rows += [plane, plane]
        places.append(place)
        rows.append(told[k])
    places.append(at_m[-1] + _STRETCH_M)
    rows.append(plane)
    return np.stack([np.interp(way_m, places, column) for column in np.array(rows).T], axis=1)


def _profile(looks: MarkLooks, Ts_map_base: np.ndarray) -> np.ndarray | None:
    """Height at each knot beside one stretch; None where it is a plane, or nobody knows."""
    left_m = looks.on_plane(0.0)[:, 1]
    told = []
    for low in np.arange(_KNOTS_M[0], _KNOTS_M[-1], _BIN_M):
        rows = np.flatnonzero((left_m >= low) & (left_m < low + _BIN_M))
        if len(rows) < _LEAST_LOOKS or abs(low + 0.5 * _BIN_M) < _LANE_M:
            continue
        some = looks.where(rows)
        height_m = _height_where_looks_meet(some, Ts_map_base)
        if height_m is not None:
            told.append((float(np.median(some.on_plane(height_m)[:, 1])), height_m))
    return None if not told else _fitted(np.array(told))


def _height_where_looks_meet(looks: MarkLooks, Ts_map_base: np.ndarray) -> float | None:
    """Height above the plane of the vehicle at which looks from different places meet; None where no height is best."""
    T = Ts_map_base[looks.frame]
    eye = np.einsum("nij,nj->ni", T[:, :2, :3], looks.camera_base) + T[:, :2, 3]
    met = np.zeros(len(_HEIGHTS_M))
    for k, height_m in enumerate(_HEIGHTS_M):
        xy = np.einsum("nij,nj->ni", T[:, :2, :3], looks.on_plane(height_m)) + T[:, :2, 3]
        one, other = cKDTree(xy).query_pairs(3.0 * _MEETS_M, output_type="ndarray").T
        is_apart = np.linalg.norm(eye[one] - eye[other], axis=1) > _APART_M
        off2 = ((xy[one] - xy[other]) ** 2).sum(axis=1)
        met[k] = 2.0 * np.exp(-0.5 * off2[is_apart] / _MEETS_M**2).sum() / len(xy)
    best = int(met.argmax())
    is_inside = 0 < best < len(met) - 1
    if not is_inside or met[best] < max(_LEAST_MET, _LEAST_CONTRAST * float(np.median(met))):
        return None
    # The top of a parabola through the best and its neighbours.
    before, top, after = met[best - 1 : best + 2]
    bend = before - 2.0 * top + after
    steps = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float(_HEIGHTS_M[best] + steps * _STEP_M)


def _fitted(told: Float[np.ndarray, "m 2"]) -> np.ndarray | None:
    """The smoothest heights at all knots that places with told heights allow; None where they are a plane."""
    num, step_m = len(_KNOTS_M), _KNOTS_M[1] - _KNOTS_M[0]
    unit = np.eye(num)
    at = np.clip((told[:, 0] - _KNOTS_M[0]) / step_m, 0, num - 1.001)
    column, share = at.astype(int), at - at.astype(int)
    says = (1.0 - share)[:, None] * unit[column] + share[:, None] * unit[column + 1]
    lane = unit[np.abs(_KNOTS_M) <= _LANE_M]
    rows = [
        says / _TOLD_SIGMA_M,
        lane / (0.1 * _TOLD_SIGMA_M),
        np.diff(unit, axis=0) / (_SLOPE_SIGMA * step_m),
        np.diff(unit, 2, axis=0) / (_BEND_SIGMA * step_m),
    ]
    values = [told[:, 1] / _TOLD_SIGMA_M, *(np.zeros(len(part)) for part in rows[1:])]
    heights = np.linalg.lstsq(np.concatenate(rows), np.concatenate(values), rcond=None)[0]
    return None if np.abs(says @ heights).max() < _PLANE_M else heights
