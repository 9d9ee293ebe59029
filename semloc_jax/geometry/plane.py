"""Planes: a robust fit to points (room: geometry; pure JAX, and numpy alike).

In: points [n 3]. Out: Plane, distances, in the library (numpy or JAX) of the input.
"""

from typing import NamedTuple

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

Points = Float[Array | np.ndarray, "*n 3"]
_NUM_STEPS = 12
SIGMA_OF_MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


class Plane(NamedTuple):
    """The plane normal . (p - point) = 0; the normal has unit length and z >= 0."""

    point: Float[Array | np.ndarray, " 3"]
    normal: Float[Array | np.ndarray, " 3"]
    rms_m: Float[Array | np.ndarray, ""]
    """Weighted root mean square distance of the points of the fit."""


def fit_plane(
    points: Float[Array | np.ndarray, "n 3"],
    weight: Float[Array | np.ndarray, " n"] | None = None,
    noise_m: float = 0.03,
) -> Plane:
    """The plane that most points lie on: total least squares with Geman-McClure weights of shrinking width.

    Holds against about a third of outliers on one side. Fewer than three points, or points on one line, give a plane
    through them whose remaining tilt means nothing: look at the spread of the points before trusting it.

    Args:
        points: Points in any metric frame [m].
        weight: Weight of each, 0 for padding; None weighs all alike.
        noise_m: Standard deviation of the points that belong to the plane [m]; the final width is three of them.
    """
    xp = points.__array_namespace__()
    base = xp.ones_like(points[:, 0]) if weight is None else weight
    plane = _least_squares(points, base)
    width = SIGMA_OF_MAD * _weighted_median(xp.abs(signed_distance(plane, points)), base) * 3
    for _ in range(_NUM_STEPS):
        width = xp.maximum(width, xp.asarray(3 * noise_m, dtype=points.dtype))
        robust = base / (1 + (signed_distance(plane, points) / width) ** 2) ** 2
        plane = _least_squares(points, robust)
        width = width * 0.7
    return plane


def signed_distance(plane: Plane, p: Points) -> Float[ArrayLike, "*n"]:
    """Distance of points from the plane [m], positive on the side of the normal."""
    return ((p - plane.point) * plane.normal).sum(axis=-1)


def _least_squares(points: Array | np.ndarray, weight: Array | np.ndarray) -> Plane:
    xp = points.__array_namespace__()
    total = xp.maximum(weight.sum(), xp.asarray(1e-12, dtype=points.dtype))
    center = (weight[:, None] * points).sum(axis=0) / total
    offset = points - center
    # Sums of products: an accelerator's matrix product would shorten float32.
    covariance = (weight[:, None, None] * offset[:, :, None] * offset[:, None, :]).sum(axis=0) / total
    variances, axes = xp.linalg.eigh(covariance)
    normal = axes[:, 0]
    normal = xp.where(normal[2] < 0, -normal, normal)
    return Plane(center, normal, xp.sqrt(xp.maximum(variances[0], xp.zeros_like(variances[0]))))


def _weighted_median(values: Array | np.ndarray, weight: Array | np.ndarray) -> ArrayLike:
    xp = values.__array_namespace__()
    order = xp.argsort(values)
    below = xp.cumsum(weight[order])
    return values[order][xp.clip(xp.searchsorted(below, 0.5 * below[-1]), 0, len(values) - 1)]
