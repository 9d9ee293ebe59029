"""Curves through the middles of what a mask shows row by row: u = c(v) with covariance (room: perception; host).

In: one patch of a mask. Out: RowCurve: a polynomial in the row, sub-pixel, with its covariance and width.
Lane markings and lamp posts are both narrow and steep enough in an image to be cut by its rows.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int


@dataclass(frozen=True)
class RowCurveConfig:
    """When a patch is a curve. All values are ours."""

    min_rows: int = 6
    rows_per_degree: int = 24
    """A polynomial of one degree more needs so many rows more."""
    max_degree: int = 3
    max_slope: float = 6.0
    """Columns per row: a flatter curve is not cut by rows."""
    together_px: float = 15.0
    """Errors of a border over such a way are alike."""
    border_px: float = 0.4
    """Standard deviation of a middle that is left however well the curve fits: rounding of both borders."""
    max_rms_px: float = 2.5


class RowCurve(NamedTuple):
    """u = c(v), v in [first, last] [px]."""

    coefficients: Float[np.ndarray, " d"]
    """Of powers of the row in units of `scale` from `middle`, lowest first."""
    covariance: Float[np.ndarray, "d d"]
    middle: float
    scale: float
    first: int
    last: int
    width: Float[np.ndarray, "2"]
    """Width at the first and at the last row [px along the row]."""

    def powers(self, v: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n d"]:
        """Powers of rows, as the coefficients take them."""
        return np.vander((v - self.middle) / self.scale, len(self.coefficients), increasing=True)

    def column(self, v: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """c(v) [px]."""
        return self.powers(v) @ self.coefficients

    def slope(self, v: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """c'(v)."""
        return self.powers(v)[:, :-1] @ _derived(self.coefficients) / self.scale

    def bend(self, v: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Curvature towards `normal` [1/px]."""
        second = self.powers(v)[:, :-2] @ _derived(_derived(self.coefficients)) / self.scale**2
        return second / (1.0 + self.slope(v) ** 2) ** 1.5

    def normal(self, v: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """Unit vector across the curve, towards larger columns."""
        slope = self.slope(v)
        return np.stack([np.ones(len(v)), -slope], axis=1) / np.hypot(1.0, slope)[:, None]

    def covariance_across(self, v: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n n"]:
        """Of the places of the curve at rows, across it [px^2]."""
        J = self.powers(v) / np.hypot(1.0, self.slope(v))[:, None]
        return J @ self.covariance @ J.T

    def width_across(self, v: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Width of the patch across the curve [px]."""
        return np.interp(v, [self.first, self.last], self.width) / np.hypot(1.0, self.slope(v))


def row_curve(
    patch: Bool[np.ndarray, "h w"],
    corner: tuple[int, int],
    beside: Bool[np.ndarray, "h w"],
    config: RowCurveConfig,
    max_degree: int | None = None,
) -> RowCurve | None:
    """The curve through a patch; None where it is none.

    Args:
        patch: Pixels of one thing, cut out of the mask.
        corner: Column and row of its first pixel in the mask.
        beside: Pixels of the same cut next to which a border may be that of something else.
        config: When a patch is a curve.
        max_degree: Less than that of the configuration.
    """
    rows, left, right = _single_runs(patch, beside)
    if len(rows) < config.min_rows:
        return None
    u = 0.5 * (left + right) + corner[0]
    v, width = rows + float(corner[1]), (right - left + 1).astype(np.float64)
    typical = np.polynomial.Polynomial.fit(v, width, 1)(v)
    is_usual = np.abs(width - typical) <= 0.5 * np.abs(typical) + 1.5
    u, v, width = u[is_usual], v[is_usual], width[is_usual]
    highest = config.max_degree if max_degree is None else max_degree
    degree = int(np.clip(1 + (len(v) - config.min_rows) // config.rows_per_degree, 1, highest))
    for _ in range(2):
        if len(v) < max(config.min_rows, degree + 2):
            return None
        fitted = _fitted(u, v, width, degree, config)
        off = np.abs(u - fitted.column(v))
        keep = off <= 3.0 * max(1.48 * float(np.median(off)), config.border_px)
        u, v, width = u[keep], v[keep], width[keep]
    steepest = np.abs(fitted.slope(np.array([fitted.first, fitted.last], np.float64))).max()
    is_curve = float(np.sqrt(np.mean(off[keep] ** 2))) <= config.max_rms_px and steepest <= config.max_slope
    return fitted if is_curve else None


def _single_runs(
    patch: Bool[np.ndarray, "h w"], beside: Bool[np.ndarray, "h w"]
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Rows that cut a patch once, with both borders free, and the first and last column of each."""
    padded = np.pad(patch, ((0, 0), (1, 1))).astype(np.int8)
    begins = np.diff(padded, axis=1) == 1
    rows = np.flatnonzero(begins.sum(axis=1) == 1)
    left = patch[rows].argmax(axis=1)
    right = patch.shape[1] - 1 - patch[rows, ::-1].argmax(axis=1)
    is_free = ~(beside[rows, left] | beside[rows, right])
    return rows[is_free], left[is_free], right[is_free]


def _fitted(u: np.ndarray, v: np.ndarray, width: np.ndarray, degree: int, config: RowCurveConfig) -> RowCurve:
    middle, scale = 0.5 * (v.min() + v.max()), max(0.5 * float(np.ptp(v)), 1.0)
    powers = np.vander((v - middle) / scale, degree + 1, increasing=True)
    coefficients, *_ = np.linalg.lstsq(powers, u, rcond=None)
    slope = (coefficients[1] if degree else 0.0) / scale
    spread = float(np.mean((u - powers @ coefficients) ** 2))
    # A flat curve is longer than its rows; what errs together counts once.
    alike = min(max(config.together_px / np.hypot(1.0, slope), 1.0), len(v) / (degree + 1))
    variance = alike * max(spread, config.border_px**2 * (1.0 + slope**2))
    covariance = variance * np.linalg.inv(powers.T @ powers)
    first, last = int(v.min()), int(v.max())
    wide = np.polynomial.Polynomial.fit(v, width, 1)(np.array([first, last]))
    return RowCurve(coefficients, covariance, middle, scale, first, last, np.maximum(wide, 1.0))


def _derived(coefficients: np.ndarray) -> np.ndarray:
    return coefficients[1:] * np.arange(1, len(coefficients))
