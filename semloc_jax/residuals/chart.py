"""The chart in which a pose is sought (room: residuals; pure JAX).

In: start pose, scales, coordinates. Out: Chart, its pose, and how fast the pose moves with the coordinates.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.geometry import lie


class Chart(NamedTuple):
    """T_local_base = T_start exp(sigma y): a place y in scaled tangent coordinates of a start pose."""

    T_start: Float[Array, "4 4"]
    """Origin of the chart, relative to the local origin."""
    sigma: Float[Array, "6"]
    """Scale of each coordinate [m, rad]; 0 locks a direction."""
    y: Float[Array, "6"]

    @classmethod
    def at(cls, T_local_base: Float[Array, "4 4"]) -> "Chart":
        """The chart in metres and radians whose origin is the pose itself."""
        return cls(T_local_base, jnp.ones(6, T_local_base.dtype), jnp.zeros(6, T_local_base.dtype))

    def pose(self) -> Float[Array, "4 4"]:
        """T_local_base."""
        return self.T_start @ lie.exp(self.sigma * self.y)

    def jacobian(self) -> Float[Array, "6 6"]:
        """Derivative of the right tangent of the pose by y."""
        return right_jacobian(self.sigma * self.y) * self.sigma


def right_jacobian(xi: Float[Array, "6"]) -> Float[Array, "6 6"]:
    """Right Jacobian of SE(3), sum_k (-ad xi)^k / (k+1)! up to k = 6: float32 precision for rotations up to 0.3 rad.

    A solve stays that close to its start pose; the truncated series is cheaper than the closed form and has no branch.
    ad^5 = -2 s ad^3 - s^2 ad with s = |omega|^2 leaves three products of matrices.
    """
    W, V = lie.skew(xi[3:]), lie.skew(xi[:3])
    ad = jnp.block([[W, V], [jnp.zeros_like(W), W]])
    s, identity = jnp.sum(xi[3:] ** 2), jnp.eye(6, dtype=xi.dtype)
    ad2 = _matmul(ad, ad)
    even = identity + _matmul(ad2, (1 / 6 - s * s / 5040) * identity + (1 / 120 - s / 2520) * ad2)
    return even - _matmul(ad, (1 / 2 - s * s / 720) * identity + (1 / 24 - s / 360) * ad2)


_matmul = partial(jnp.matmul, precision=jax.lax.Precision.HIGHEST)
