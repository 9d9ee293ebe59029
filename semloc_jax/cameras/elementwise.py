"""The few elementwise functions that the camera models are made of (room: cameras; pure JAX).

In: coordinates, limits, polynomial coefficients. Out: angles [rad], clamped values, polynomials and where they turn.
Each is written for one fused loop on CPU: cheap value, cheap derivative, nothing that is not finite.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

MIN_SLOPE = 0.05
"""A distortion polynomial is used up to where its slope falls to this share of the slope at the centre."""

# Minimax fit of atan(a) / a in a^2 on [0, 1]; error below 1.2e-7 rad in float32. The library's atan2 is not vectorised
# on CPU and costs twelve times as much, more than the rest of a projection.
_ATAN = (
    0.9999993355,
    -0.3332986059,
    0.1994656399,
    -0.1390862277,
    0.0964218251,
    -0.05591214829,
    0.02186284633,
    -0.004054538959,
)
_TINY = 1e-12


@jax.custom_jvp
def angle_of(y: ArrayLike, x: ArrayLike) -> Array:
    """atan2(y, x) with a finite derivative at the origin; a polynomial in float32, the library's in float64."""
    y, x = jnp.asarray(y), jnp.asarray(x)
    if jnp.result_type(x, y) != jnp.float32:
        return jnp.arctan2(y, x)
    ax, ay = jnp.abs(x), jnp.abs(y)
    a = jnp.minimum(ax, ay) / jnp.maximum(jnp.maximum(ax, ay), jnp.finfo(jnp.float32).tiny)
    octant = a * horner(_ATAN, a * a)
    quadrant = jnp.where(ay > ax, np.float32(np.pi / 2) - octant, octant)
    return jnp.copysign(jnp.where(x < 0, np.float32(np.pi) - quadrant, quadrant), y)


@angle_of.defjvp
def _angle_of_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    y, x = primals
    dy, dx = tangents
    scale = 1 / (x * x + y * y + _TINY)
    return angle_of(y, x), (x * scale) * dy - (y * scale) * dx


@jax.custom_jvp
def at_least(value: ArrayLike, limit: ArrayLike) -> Array:
    """max(value, limit) for a constant limit, whose derivative is a plain select (jnp.maximum splits ties)."""
    return jnp.maximum(value, limit)


@at_least.defjvp
def _at_least_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    value, limit = primals
    return at_least(value, limit), jnp.where(value > limit, tangents[0], 0)


@jax.custom_jvp
def at_most(value: ArrayLike, limit: ArrayLike) -> Array:
    """min(value, limit) for a constant limit; see `at_least`."""
    return jnp.minimum(value, limit)


@at_most.defjvp
def _at_most_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    value, limit = primals
    return at_most(value, limit), jnp.where(value < limit, tangents[0], 0)


def horner(coefficients: tuple, s: Array) -> Array:
    """Value of the polynomial with ascending coefficients."""
    value = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        value = value * s + coefficient
    return value


def derivative(coefficients: tuple) -> tuple:
    """Coefficients of the derivative of a polynomial."""
    return tuple(power * c for power, c in enumerate(coefficients) if power)


def slope(coefficients: tuple) -> tuple:
    """Coefficients in s = r^2 of d/dr of the odd polynomial r (c0 + c1 r^2 + c2 r^4 + ...)."""
    return tuple((2 * power + 1) * c for power, c in enumerate(coefficients))


def positive_roots(polynomial: np.ndarray) -> np.ndarray:
    """Real roots above 0 of a polynomial with these coefficients, lowest power first.

    A coefficient that changes nothing in 15 digits counts as none: roots are found by dividing by the highest.
    """
    counts = np.abs(polynomial) > 1e-15 * np.abs(polynomial).max()
    roots = np.polynomial.polynomial.polyroots(np.trim_zeros(np.where(counts, polynomial, 0.0), "b"))
    return roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]


def usable_radius(coefficients: tuple, largest: float) -> float:
    """Radius up to which r (c0 + c1 r^2 + ...) rises with at least MIN_SLOPE c0; at most `largest`.

    Past that radius the image folds back on itself: points that no lens sees would land in the image.
    """
    polynomial = np.array(slope(tuple(float(c) for c in coefficients)))
    polynomial[0] -= MIN_SLOPE * polynomial[0]
    turning = positive_roots(polynomial)
    return float(min(np.sqrt(turning.min()), largest)) if turning.size else float(largest)
