"""Robust losses on normalised residuals (room: residuals; pure JAX).

In: v, the signed distance to a mask boundary as a share of the ramp, in [-1, 1]: a loss is as wide as the ramp,
`CostMapConfig.ramp_px`. Out: rho(v) and the weight rho'(v)/v.
Every loss has rho(0) = 0, weight(0) = 1 and `worst` = rho(1), so that rho / worst is a cost in [0, 1].
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array


class RobustLoss(NamedTuple):
    """A robust loss: penalty, its weight for reweighted least squares, and the penalty of a miss."""

    rho: Callable[[Array], Array]
    weight: Callable[[Array], Array]
    worst: float


def _tukey_rho(v: Array) -> Array:
    # Not (1 - (1 - v^2)^3) / 6: in float32 that is 0 below |v| = 2e-4, and its root has no derivative.
    s = jnp.minimum(v * v, 1)
    return s * (3 - 3 * s + s * s) / 6


def _tukey_weight(v: Array) -> Array:
    t = jnp.maximum(1 - v * v, 0)
    return t * t


CAUCHY_SCALE = 0.3
HUBER_SCALE = 0.3

LOSSES: dict[str, RobustLoss] = {
    # Redescends exactly where the ramp ends: a sample beyond the ramp neither pulls nor keeps others from pulling.
    "tukey": RobustLoss(_tukey_rho, _tukey_weight, 1 / 6),
    "cauchy": RobustLoss(
        lambda v: 0.5 * CAUCHY_SCALE**2 * jnp.log1p((v / CAUCHY_SCALE) ** 2),
        lambda v: 1 / (1 + (v / CAUCHY_SCALE) ** 2),
        0.5 * CAUCHY_SCALE**2 * math.log1p(CAUCHY_SCALE**-2),
    ),
    "huber": RobustLoss(
        lambda v: jnp.where(jnp.abs(v) < HUBER_SCALE, 0.5 * v * v, HUBER_SCALE * (jnp.abs(v) - 0.5 * HUBER_SCALE)),
        lambda v: HUBER_SCALE / jnp.maximum(jnp.abs(v), HUBER_SCALE),
        HUBER_SCALE * (1 - 0.5 * HUBER_SCALE),
    ),
    "squared": RobustLoss(lambda v: 0.5 * v * v, jnp.ones_like, 0.5),
}
"""Losses by name; `tukey` is the default of every configuration."""


def robust_root(v: Array, loss: RobustLoss) -> Array:
    """Residual whose half square is rho(v): sign(v) sqrt(2 rho(v)), smooth at zero."""
    tiny = jnp.asarray(1e-6, v.dtype)
    near = jnp.abs(v) < tiny
    safe = jnp.where(near, tiny, v)
    return jnp.where(near, v, v * jnp.sqrt(2 * loss.rho(safe)) / jnp.abs(safe))
