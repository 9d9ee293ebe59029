"""A pose in the map frame that has derivatives (room: alignment; pure JAX).

In: SmoothEstimate, relative to a local origin. Out: DifferentiablePose.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from semloc_jax.alignment.implicit import SmoothEstimate


class DifferentiablePose(eqx.Module):
    """A pose in the map frame; it, its covariance and its tangent have derivatives."""

    T_map_base: Float[Array, "4 4"]
    """Vehicle pose in the map frame [m]."""
    estimate: SmoothEstimate
    """The same relative to the local origin, with cost, coverage, number of steps."""

    @classmethod
    def of(cls, estimate: SmoothEstimate, origin_map: Float[np.ndarray, "3"]) -> "DifferentiablePose":
        """The estimate with its pose moved to the map."""
        T = estimate.T_local_base
        return cls(T.at[:3, 3].add(jnp.asarray(origin_map, T.dtype)), estimate)

    @property
    def covariance(self) -> Float[Array, "6 6"]:
        """Covariance of the right tangent [m, rad]."""
        return self.estimate.covariance

    @property
    def status(self) -> Int[Array, ""]:
        """SolveStatus."""
        return self.estimate.status

    def tangent(self) -> Float[Array, "6"]:
        """Zero; its derivative is that of the pose as a right tangent (v, omega) [m, rad]."""
        return self.estimate.tangent()
