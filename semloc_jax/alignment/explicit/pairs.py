"""Whether one shape is one landmark, class by class (room: alignment; host).

In: a Prediction, a landmark, a sight. Out: normalised square and Match; None beyond the chi-square gate.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.explicit.landmarks import Landmark
from semloc_jax.alignment.explicit.prediction import AssociationConfig, Prediction, offsets
from semloc_jax.alignment.explicit.sights import ShapeSight
from semloc_jax.perception.sign_outlines import SignOutline
from semloc_jax.residuals.seen_point import PointSight
from semloc_jax.structs import ElementClass

ROUNDING_PX = 0.2
"""Standard deviation of any place in a mask that is left however well a shape fits: masks lie beside images."""


class Match(NamedTuple):
    """A shape that is held for a landmark."""

    landmark: int
    sight: ShapeSight
    points: Float[np.ndarray, "k 3"]
    """Points of the landmark that belong to the places of the shape, in the local frame [m]."""
    used: tuple[int, ...]
    """Which places of the shape these are."""
    has_end: tuple[bool, bool] = (False, False)
    """Of a post: whether its lower and upper end are those of the map."""


def _distance(r: np.ndarray, J: np.ndarray, noise: np.ndarray, prediction: Prediction) -> float | None:
    """Normalised square of residuals whose gate they pass, with the volume of what was possible; else None."""
    S = J @ prediction.covariance @ J.T + noise
    chi2 = float(r @ np.linalg.solve(S, r))
    if not chi2 < prediction.config.gate(len(r)):
        return None
    return chi2 + float(np.linalg.slogdet(S)[1])


def _is_alike(seen_px: float, expected_px: float, config: AssociationConfig) -> bool:
    low, high = sorted((seen_px, expected_px))
    return bool(high - low <= config.size_px or high <= config.size_ratio * low)


def _sign_pair(prediction: Prediction, k: int, sight: ShapeSight) -> tuple[float, Match] | None:
    landmark, outline = prediction.landmarks[k], sight.shape
    if not are_of_one_shape(landmark, outline):
        return None
    first = PointSight(*(leaf[:1] for leaf in sight.sights))
    at = offsets(prediction.T_local_base, landmark.middle[None], first)
    if not _is_alike(half_px(outline), landmark.radius_m / at.distance_m[0] * sight.px_per_rad, prediction.config):
        return None
    noise = outline.centre_sigma_px**2 + (sight.px_per_rad * prediction.config.map_sigma_m / at.distance_m[0]) ** 2
    cost = _distance(at.off[0], at.by_pose[0], noise * np.eye(2), prediction)
    if cost is None:
        return None
    return cost, sign_match(prediction.T_local_base, k, landmark, sight)


def are_of_one_shape(landmark: Landmark, outline: SignOutline) -> bool:
    """Whether a sign of the map may look like an outline; a patch may be anything."""
    return "patch" in (outline.shape, landmark.shape) or outline.shape == landmark.shape


def sign_match(T_local_base: Float[np.ndarray, "4 4"], k: int, landmark: Landmark, sight: ShapeSight) -> Match:
    """A sign taken for a landmark: by its corners where both have them, else by its centre.

    Args:
        T_local_base: About where the vehicle is: decides which corner is which.
        k: Place of the landmark.
        landmark: The sign of the map.
        sight: As it is seen.
    """
    if sight.shape.shape == landmark.shape and len(sight.shape.corners):
        points = _in_order(T_local_base, landmark.points, sight)
        return Match(k, sight, points, tuple(range(1, 1 + len(points))))
    return Match(k, sight, landmark.middle[None], (0,))


def half_px(outline) -> float:
    """Size of an outline as `Landmark.radius_m` has it."""
    return outline.radius_px if outline.shape == "circle" else 0.5 * float(np.sqrt(outline.area_px))


def _in_order(T_local_base: np.ndarray, corners: np.ndarray, sight: ShapeSight) -> np.ndarray:
    """The corners of the map in the cyclic order that fits the seen ones best."""
    num, best = len(corners), None
    sights = PointSight(*(leaf[1:] for leaf in sight.sights))
    for way in (corners, corners[::-1]):
        for shift in range(num):
            order = np.roll(way, shift, axis=0)
            off = offsets(T_local_base, order, sights).off
            cost = float(np.sum((off - off.mean(axis=0)) ** 2))
            if best is None or cost < best[0]:
                best = cost, order
    return best[1]


def _post_pair(prediction: Prediction, k: int, sight: ShapeSight) -> tuple[float, Match] | None:
    points, view = prediction.of(k, sight.camera)
    seen = np.isfinite(view.uv).all(axis=1)
    lamp, rows = sight.shape, sight.uv[:, 1]
    if seen.sum() < 2:
        return None
    order = np.argsort(view.uv[seen, 1])
    v, p = view.uv[seen, 1][order], points[seen][order]
    covered = min(rows[0], v[-1]) - max(rows[1], v[0])
    if covered < 0.6 * (rows[0] - rows[1]):
        return None
    on_axis = np.stack([np.interp(rows, v, p[:, i]) for i in range(3)], axis=1)
    at = offsets(prediction.T_local_base, on_axis, sight.sights)
    normal = lamp.axis.normal(rows)
    r, J = np.einsum("ni,ni->n", normal, at.off), np.einsum("ni,nij->nj", normal, at.by_pose)
    if abs(r[0] - r[1]) > prediction.config.tilt * (rows[0] - rows[1]) + 4.0 * ROUNDING_PX:
        return None
    shared_px = sight.px_per_rad * prediction.config.map_sigma_m / at.distance_m
    noise = lamp.axis.covariance_across(rows) + np.outer(shared_px, shared_px) + ROUNDING_PX**2 * np.eye(2)
    cost = _distance(r, J, noise, prediction)
    if cost is None:
        return None
    ends = prediction.landmarks[k].points
    off = offsets(prediction.T_local_base, ends, sight.sights)
    along = np.array([-normal[:, 1], normal[:, 0]]).T
    d, D = np.einsum("ni,ni->n", along, off.off), np.einsum("ni,nij->nj", along, off.by_pose)
    spread = lamp.end_sigma_px**2 + np.einsum("ni,ij,nj->n", D, prediction.covariance, D)
    is_end = (d**2 < prediction.config.gate(1) * spread) & np.array(lamp.has_end)
    chosen = np.where(is_end[:, None], ends, on_axis)
    return cost, Match(k, sight, chosen, (0, 1), (bool(is_end[0]), bool(is_end[1])))


def _lane_pair(prediction: Prediction, k: int, sight: ShapeSight) -> tuple[float, Match] | None:
    """As MLVHM: the point of the lane in the row of each place of the curve."""
    points, view = prediction.of(k, sight.camera)
    near = view.in_view & (view.distance_m < prediction.config.reach_m(sight.label))
    if near.sum() < 2:
        return None
    order = np.argsort(view.uv[near, 1])
    v, p = view.uv[near, 1][order], points[near][order]
    rows = sight.uv[:, 1]
    used = np.flatnonzero((rows >= v[0]) & (rows <= v[-1]))
    if len(used) < max(2, len(rows) // 2):
        return None
    on_lane = np.stack([np.interp(rows[used], v, p[:, i]) for i in range(3)], axis=1)
    at = offsets(prediction.T_local_base, on_lane, PointSight(*(leaf[used] for leaf in sight.sights)))
    normal = sight.shape.normal(rows[used])
    r, J = np.einsum("ni,ni->n", normal, at.off), np.einsum("ni,nij->nj", normal, at.by_pose)
    scale = sight.px_per_rad / at.distance_m
    width_px, expected_px = sight.shape.width_across(rows[used]), prediction.landmarks[k].width_m * scale
    # Across the view the road is foreshortened.
    wide_px = float((expected_px * np.abs(normal[:, 0])).mean())
    if wide_px > 0.0 and not _is_alike(float(width_px.mean()), wide_px, prediction.config):
        return None
    noise = lane_noise(sight, rows[used], at.distance_m, prediction.config)
    cost = _distance(r, J, noise, prediction)
    return None if cost is None else (cost, Match(k, sight, on_lane, tuple(int(i) for i in used)))


def lane_noise(
    sight: ShapeSight,
    rows: Float[np.ndarray, " k"],
    distance_m: Float[np.ndarray, " k"],
    config: AssociationConfig,
) -> Float[np.ndarray, "k k"]:
    """Covariance of the places of a curve against a lane of the map, across it [px^2]."""
    shared_px = sight.px_per_rad / distance_m * config.map_sigma_m
    # A curve knows no more than its coefficients, at however many places it is asked. Its places are taken one by one:
    # how it bends tells more of wobbly masks than of the pose.
    repeats = max(len(rows) / len(sight.shape.coefficients), 1.0)
    own = repeats * np.diagonal(sight.shape.covariance_across(rows)) + ROUNDING_PX**2
    return np.diag(own) + np.outer(shared_px, shared_px)


PAIRS = {
    ElementClass.SIGN: _sign_pair,
    ElementClass.POLE: _post_pair,
    ElementClass.LANE_MARKING: _lane_pair,
}
"""Cost and match of a landmark and a shape of each class; None where they are not the same."""
