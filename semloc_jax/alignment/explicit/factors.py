"""Matched landmarks as factors: one kind of residual for each class (room: alignment; host).

In: a Match and its landmark. Out: FactorRow, and from many of them Factors of fixed size, on poses or poses and shifts.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.explicit.landmarks import Landmark
from semloc_jax.alignment.explicit.pairs import ROUNDING_PX, Match, lane_noise
from semloc_jax.alignment.explicit.prediction import AssociationConfig, offsets
from semloc_jax.residuals.lamp_line import LineSight, lamp_residual
from semloc_jax.residuals.lane_curve import MOST_PLACES, CurveSight, lane_residual
from semloc_jax.residuals.motion import cauchy
from semloc_jax.residuals.seen_point import PointSight
from semloc_jax.residuals.sign_circle import circle_residual
from semloc_jax.residuals.sign_corners import MOST_CORNERS, corners_residual
from semloc_jax.solvers.factors import Factors
from semloc_jax.structs import ElementClass

_THRESHOLD = 2.5
"""Whitened residuals beyond this (root of their mean square) pull no harder; ours."""
_AWAY_M = 1e4
"""Where the points of padding are: never at a camera."""


class FactorRow(NamedTuple):
    """What one factor takes."""

    data: tuple[Any, ...]
    """Points of the landmark first."""
    sqrt_info: np.ndarray


class On(NamedTuple):
    """Which variables a factor binds."""

    row: FactorRow
    pose: int = 0
    shift: int = 0
    """Of the landmark, where its place is a variable."""


@dataclass(frozen=True)
class ShapeFactors:
    """A kind of residual: how many a frame may show, and one that is switched off."""

    residual: Callable
    capacity: int
    size: int
    """Independent numbers of one residual: those of a curve are no more than its coefficients."""
    padding: FactorRow

    def factors(self, given: Sequence[On], num: int, has_shifts: bool = False, is_robust: bool = True) -> Factors:
        """A family of fixed size.

        Args:
            given: Factors; those beyond the number are left out.
            num: Size of the family.
            has_shifts: Whether the landmarks may be elsewhere than the map has them: variables "shift" [m].
            is_robust: Whether what does not fit pulls less.
        """
        filled = [*given[:num], *[On(self.padding)] * (num - len(given))]
        data = jax.tree.map(lambda *leaves: np.stack(leaves), *(one.row.data for one in filled))
        keys = [np.array([one.pose for one in filled])]
        if has_shifts:
            keys.append(np.array([one.shift for one in filled]))
        return Factors(
            _shifted(self.residual) if has_shifts else self.residual,
            ("pose", "shift")[: len(keys)],
            tuple(keys),
            data,
            np.stack([one.row.sqrt_info for one in filled]),
            robust=cauchy(_THRESHOLD * float(np.sqrt(self.size))) if is_robust else None,
        )


@cache
def _shifted(residual: Callable) -> Callable:
    """The residual of a landmark that is elsewhere; the same function object for the same residual."""

    def of_shifted(T_local_base, shift, points_map, *rest):
        return residual(T_local_base, points_map + shift, *rest)

    return of_shifted


def row_of(
    match: Match, landmark: Landmark, T_local_base: Float[np.ndarray, "4 4"], config: AssociationConfig
) -> tuple[str, FactorRow]:
    """The kind of a match, and what its factor takes.

    Args:
        match: A shape and its points of the map.
        landmark: Its landmark.
        T_local_base: About where the vehicle is: distances make pixels of the errors of the map.
        config: How sure the map is.
    """
    sights = PointSight(*(leaf[list(match.used)] for leaf in match.sight.sights))
    distance_m = offsets(T_local_base, match.points, sights).distance_m
    of_map_px = match.sight.px_per_rad * config.map_sigma_m / distance_m
    label = match.sight.label
    if label == ElementClass.LANE_MARKING:
        return "lane", _lane_row(match, sights, distance_m, config)
    if label == ElementClass.POLE:
        return "post", _post_row(match, sights, of_map_px)
    if len(match.used) > 1:
        return "corners", _corners_row(match, sights, of_map_px)
    return "circle", _circle_row(match, landmark, sights, of_map_px)


def _lane_row(match: Match, sights: PointSight, distance_m: np.ndarray, config: AssociationConfig) -> FactorRow:
    curve, v = match.sight.shape, match.sight.uv[list(match.used), 1]
    noise = lane_noise(match.sight, v, distance_m, config)
    sqrt_info = np.zeros((MOST_PLACES, MOST_PLACES))
    sqrt_info[: len(v), : len(v)] = np.linalg.inv(np.linalg.cholesky(noise))
    places = np.minimum(np.arange(MOST_PLACES), len(v) - 1)
    seen = CurveSight(PointSight(*(leaf[places] for leaf in sights)), curve.normal(v)[places], curve.bend(v)[places])
    return FactorRow((match.points[places], seen), sqrt_info)


def _post_row(match: Match, sights: PointSight, of_map_px: np.ndarray) -> FactorRow:
    lamp, rows = match.sight.shape, match.sight.uv[:, 1]
    # What the map has wrong of a post is wrong at both ends.
    across = lamp.axis.covariance_across(rows) + np.outer(of_map_px, of_map_px) + ROUNDING_PX**2 * np.eye(2)
    sqrt_info = np.zeros((4, 4))
    sqrt_info[:2, :2] = np.linalg.inv(np.linalg.cholesky(across))
    sqrt_info[[2, 3], [2, 3]] = np.array(match.has_end) / np.hypot(lamp.end_sigma_px, of_map_px)
    return FactorRow((match.points, LineSight(sights, lamp.axis.normal(rows))), sqrt_info)


def _corners_row(match: Match, sights: PointSight, of_map_px: np.ndarray) -> FactorRow:
    num = len(match.used)
    covariance = np.kron(np.outer(of_map_px, of_map_px), np.eye(2)) + ROUNDING_PX**2 * np.eye(2 * num)
    for k, own in enumerate(match.sight.shape.covariance):
        covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += own
    sqrt_info = np.zeros((2 * MOST_CORNERS, 2 * MOST_CORNERS))
    sqrt_info[: 2 * num, : 2 * num] = np.linalg.inv(np.linalg.cholesky(covariance))
    places = np.minimum(np.arange(MOST_CORNERS), num - 1)
    return FactorRow((match.points[places], PointSight(*(leaf[places] for leaf in sights))), sqrt_info)


def _circle_row(match: Match, landmark: Landmark, sights: PointSight, of_map_px: np.ndarray) -> FactorRow:
    outline = match.sight.shape
    is_round = outline.shape == landmark.shape == "circle"
    variance = outline.centre_sigma_px**2 + of_map_px[0] ** 2 + ROUNDING_PX**2
    sqrt_info = np.array([1.0, 1.0, float(is_round)]) / np.sqrt(variance)
    one = PointSight(*(leaf[0] for leaf in sights))
    return FactorRow((match.points[0], np.float64(landmark.radius_m), one, np.float64(outline.radius_px)), sqrt_info)


def _kinds() -> dict[str, ShapeFactors]:
    """Every kind, with as many as one frame may show."""
    away = np.array([0.0, 0.0, _AWAY_M])
    one = PointSight(np.eye(4), np.array([0.0, 0.0, 1.0]), np.eye(3)[:2])

    def many(num: int) -> PointSight:
        return PointSight(*(np.stack([leaf] * num) for leaf in one))

    across = np.array([1.0, 0.0])
    zero = np.float64(0.0)
    return {
        "lane": ShapeFactors(
            lane_residual,
            24,
            3,
            FactorRow(
                (
                    np.stack([away] * MOST_PLACES),
                    CurveSight(many(MOST_PLACES), np.stack([across] * MOST_PLACES), np.zeros(MOST_PLACES)),
                ),
                np.zeros((MOST_PLACES, MOST_PLACES)),
            ),
        ),
        "post": ShapeFactors(
            lamp_residual,
            24,
            4,
            FactorRow((np.stack([away] * 2), LineSight(many(2), np.stack([across] * 2))), np.zeros((4, 4))),
        ),
        "corners": ShapeFactors(
            corners_residual,
            12,
            8,
            FactorRow(
                (np.stack([away] * MOST_CORNERS), many(MOST_CORNERS)), np.zeros((2 * MOST_CORNERS, 2 * MOST_CORNERS))
            ),
        ),
        "circle": ShapeFactors(circle_residual, 16, 3, FactorRow((away, zero, one, zero), np.zeros(3))),
    }


KINDS = _kinds()
