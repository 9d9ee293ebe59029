"""The motion between two sets of corresponding points (Umeyama 1991) (room: geometry; pure JAX, and numpy alike).

In: corresponding points [n d], d = 2 or 3, and weights. Out: Similarity, in the library (numpy or JAX) of the input.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float


class Similarity(NamedTuple):
    """p_a = scale R_a_b p_b + t_a_b."""

    scale: Float[Array | np.ndarray, ""]
    R_a_b: Float[Array | np.ndarray, "d d"]
    t_a_b: Float[Array | np.ndarray, " d"]

    def apply(self, p_b: Float[Array | np.ndarray, "n d"]) -> Float[Array | np.ndarray, "n d"]:
        """Points of frame b in frame a."""
        return self.scale * _dot(p_b, self.R_a_b.T) + self.t_a_b


def umeyama(
    p_a: Float[Array | np.ndarray, "n d"],
    p_b: Float[Array | np.ndarray, "n d"],
    weight: Float[Array | np.ndarray, " n"] | None = None,
    with_scale: bool = False,
) -> Similarity:
    """The rotation, translation and (if asked) scale that bring `p_b` onto `p_a` with the least weighted squares.

    Never a reflection. Points on one line (3D) or in one place leave the rotation undetermined: some valid one is
    returned, and derivatives are not finite there.

    Args:
        p_a: Points in frame a [m].
        p_b: The same points in frame b [m].
        weight: Weight of each pair, 0 for padding; None weighs all alike.
        with_scale: Whether to estimate the scale; else it is 1.
    """
    xp = p_a.__array_namespace__()
    weight = xp.ones_like(p_a[:, 0]) if weight is None else weight
    weight = weight / weight.sum()
    mean_a, mean_b = (weight[:, None] * p_a).sum(axis=0), (weight[:, None] * p_b).sum(axis=0)
    a, b = p_a - mean_a, p_b - mean_b
    covariance = (weight[:, None, None] * a[:, :, None] * b[:, None, :]).sum(axis=0)
    U, variances, Vt = xp.linalg.svd(covariance)
    sign = xp.sign(xp.linalg.det(U) * xp.linalg.det(Vt))
    keep = xp.concatenate([xp.ones_like(variances[:-1]), sign[None]])
    R_a_b = _dot(U * keep, Vt)
    spread = (weight * (b * b).sum(axis=1)).sum()
    scale = (variances * keep).sum() / spread if with_scale else xp.ones_like(spread)
    return Similarity(scale, R_a_b, mean_a - scale * _dot(mean_b[None], R_a_b.T)[0])


def _dot(a: Array | np.ndarray, b: Array | np.ndarray) -> Array | np.ndarray:
    # Sums of products: an accelerator's matrix product would shorten float32.
    return (a[:, :, None] * b[None, :, :]).sum(axis=1)
