"""The pose that explains matched landmarks: class-wise residuals in one solve (room: alignment; host around JAX).

In: Match list, landmarks, a prior. Out: ExplicitPose: pose, covariance with the prior, cost of every match.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.compact_landmarks import Landmark
from semloc_jax.alignment.explicit_association import ROUNDING_PX, AssociationConfig, Match, lane_noise, offsets
from semloc_jax.residuals.lamp_line import LineSight, lamp_residual
from semloc_jax.residuals.lane_curve import MOST_PLACES, CurveSight, lane_residual
from semloc_jax.residuals.motion import cauchy, pose_residual
from semloc_jax.residuals.seen_point import PointSight
from semloc_jax.residuals.sign_circle import circle_residual
from semloc_jax.residuals.sign_corners import MOST_CORNERS, corners_residual
from semloc_jax.solvers.factors import POSE, Factors
from semloc_jax.solvers.front import solve
from semloc_jax.solvers.graph import FactorGraph, Family
from semloc_jax.solvers.levenberg_marquardt import SolveConfig
from semloc_jax.structs import ElementClass, SolveStatus

_THRESHOLD = 2.5
"""Whitened residuals beyond this (root of their mean square) pull no harder; ours."""
_SOLVE = SolveConfig(tolerance=1e-4, max_steps=20)
_AWAY_M = 1e4
"""Where the points of padding are: never at a camera."""


class ExplicitPose(NamedTuple):
    """The answer of one solve."""

    T_local_base: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]
    """Of its right tangent, the prior included."""
    costs: Float[np.ndarray, " match"]
    """Robust cost of each match [nats]."""
    status: SolveStatus


class _Row(NamedTuple):
    """What one factor takes, and the match that it belongs to."""

    data: tuple[Any, ...]
    sqrt_info: np.ndarray
    match: int


@dataclass(frozen=True)
class _Kind:
    """A kind of residual: how many there may be, and one that is switched off."""

    residual: Callable
    capacity: int
    size: int
    """Numbers of one residual."""
    padding: _Row

    def factors(self, rows: Sequence[_Row]) -> Factors:
        """A family of fixed size."""
        filled = [*rows, *[self.padding] * (self.capacity - len(rows))]
        data = jax.tree.map(lambda *leaves: np.stack(leaves), *(row.data for row in filled))
        sqrt_info = np.stack([row.sqrt_info for row in filled])
        keys = (np.zeros(self.capacity, int),)
        robust = cauchy(_THRESHOLD * float(np.sqrt(self.size)))
        return Factors(self.residual, ("pose",), keys, data, sqrt_info, robust=robust)


def solved(
    matches: Sequence[Match],
    landmarks: Sequence[Landmark],
    T_prior: Float[np.ndarray, "4 4"],
    sigma: Float[np.ndarray, "6"],
    T_start: Float[np.ndarray, "4 4"],
    config: AssociationConfig,
) -> ExplicitPose:
    """The most likely pose, from matches and a prior.

    Args:
        matches: Shapes and their points of the map; the first ones where there are too many.
        landmarks: What the matches name.
        T_prior: Mean of the prior, in the local frame.
        sigma: Its standard deviations (right tangent).
        T_start: Where the solve begins.
        config: How sure the map is.
    """
    rows: dict[str, list[_Row]] = {name: [] for name in _KINDS}
    for index, match in enumerate(matches):
        name, found = _rows(index, match, landmarks[match.landmark], T_start, config)
        rows[name] += found
    rows = {name: found[: _KINDS[name].capacity] for name, found in rows.items()}
    factors = [_KINDS[name].factors(found) for name, found in rows.items()]
    held = Factors(pose_residual, ("pose",), (np.zeros(1, int),), (T_prior[None],), np.diag(1.0 / sigma)[None])
    graph = FactorGraph((Family("pose", POSE, 1),), (*factors, held))
    with jax.enable_x64(True):
        T, covariance, costs, status = jax.tree.map(np.asarray, _solved(graph, T_start))
    of_match = np.zeros(len(matches))
    for found, cost in zip(rows.values(), costs, strict=True):
        np.add.at(of_match, [row.match for row in found], cost[: len(found)])
    return ExplicitPose(T, covariance, of_match, SolveStatus(int(status)))


@eqx.filter_jit
def _solved(graph: FactorGraph, T_start):
    found = solve(graph, {"pose": T_start[None]}, _SOLVE)
    costs = [factors.costs(found.value) for factors in graph.factors[:-1]]
    return found.value["pose"][0], found.equations.covariance(), costs, found.status


def _rows(
    index: int, match: Match, landmark: Landmark, T_local_base: np.ndarray, config: AssociationConfig
) -> tuple[str, list[_Row]]:
    """The factors of a match, and their kind."""
    sights = PointSight(*(leaf[list(match.used)] for leaf in match.sight.sights))
    distance_m = offsets(T_local_base, match.points, sights).distance_m
    of_map = (match.sight.px_per_rad * config.map_sigma_m / distance_m) ** 2
    label = match.sight.label
    if label == ElementClass.LANE_MARKING:
        return "lane", [_lane_row(index, match, sights, distance_m, config)]
    if label == ElementClass.POLE:
        return "post", [_post_row(index, match, sights, of_map)]
    if len(match.used) > 1:
        return "corners", [_corners_row(index, match, sights, of_map)]
    return "circle", [_circle_row(index, match, landmark, sights, of_map)]


def _lane_row(index: int, match: Match, sights: PointSight, distance_m: np.ndarray, config: AssociationConfig) -> _Row:
    curve, v = match.sight.shape, match.sight.uv[list(match.used), 1]
    noise = lane_noise(match.sight, v, distance_m, config)
    sqrt_info = np.zeros((MOST_PLACES, MOST_PLACES))
    sqrt_info[: len(v), : len(v)] = np.linalg.inv(np.linalg.cholesky(noise))
    places = np.minimum(np.arange(MOST_PLACES), len(v) - 1)
    seen = CurveSight(PointSight(*(leaf[places] for leaf in sights)), curve.normal(v)[places], curve.bend(v)[places])
    return _Row((match.points[places], seen), sqrt_info, index)


def _post_row(index: int, match: Match, sights: PointSight, of_map: np.ndarray) -> _Row:
    lamp, rows = match.sight.shape, match.sight.uv[:, 1]
    across = lamp.axis.covariance_across(rows) + np.diag(of_map) + ROUNDING_PX**2 * np.eye(2)
    sqrt_info = np.zeros((4, 4))
    sqrt_info[:2, :2] = np.linalg.inv(np.linalg.cholesky(across))
    sqrt_info[[2, 3], [2, 3]] = np.array(match.has_end) / np.sqrt(lamp.end_sigma_px**2 + of_map)
    return _Row((match.points, LineSight(sights, lamp.axis.normal(rows))), sqrt_info, index)


def _corners_row(index: int, match: Match, sights: PointSight, of_map: np.ndarray) -> _Row:
    num = len(match.used)
    covariance = match.sight.shape.covariance + (of_map + ROUNDING_PX**2)[:, None, None] * np.eye(2)
    sqrt_info = np.zeros((MOST_CORNERS, 2, 2))
    sqrt_info[:num] = np.linalg.inv(np.linalg.cholesky(covariance))
    places = np.minimum(np.arange(MOST_CORNERS), num - 1)
    return _Row((match.points[places], PointSight(*(leaf[places] for leaf in sights))), sqrt_info, index)


def _circle_row(index: int, match: Match, landmark: Landmark, sights: PointSight, of_map: np.ndarray) -> _Row:
    outline = match.sight.shape
    is_round = outline.shape == landmark.shape == "circle"
    variance = outline.centre_sigma_px**2 + of_map[0] + ROUNDING_PX**2
    sqrt_info = np.array([1.0, 1.0, float(is_round)]) / np.sqrt(variance)
    one = PointSight(*(leaf[0] for leaf in sights))
    return _Row((match.points[0], np.float64(landmark.radius_m), one, np.float64(outline.radius_px)), sqrt_info, index)


def _kinds() -> dict[str, _Kind]:
    """Every kind, with as many as one frame may show."""
    away = np.array([0.0, 0.0, _AWAY_M])
    one = PointSight(np.eye(4), np.array([0.0, 0.0, 1.0]), np.eye(3)[:2])

    def many(num: int) -> PointSight:
        return PointSight(*(np.stack([leaf] * num) for leaf in one))

    across = np.array([1.0, 0.0])
    zero = np.float64(0.0)
    return {
        "lane": _Kind(
            lane_residual,
            24,
            MOST_PLACES,
            _Row(
                (
                    np.stack([away] * MOST_PLACES),
                    CurveSight(many(MOST_PLACES), np.stack([across] * MOST_PLACES), np.zeros(MOST_PLACES)),
                ),
                np.zeros((MOST_PLACES, MOST_PLACES)),
                0,
            ),
        ),
        "post": _Kind(
            lamp_residual,
            24,
            4,
            _Row((np.stack([away] * 2), LineSight(many(2), np.stack([across] * 2))), np.zeros((4, 4)), 0),
        ),
        "corners": _Kind(
            corners_residual,
            12,
            8,
            _Row((np.stack([away] * MOST_CORNERS), many(MOST_CORNERS)), np.zeros((MOST_CORNERS, 2, 2)), 0),
        ),
        "circle": _Kind(circle_residual, 16, 3, _Row((away, zero, one, zero), np.zeros(3), 0)),
    }


_KINDS = _kinds()
