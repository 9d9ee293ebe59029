"""Derivatives of a solution by what it was found from (room: solvers; pure JAX).

In: the force (gradient of the cost by the unknowns) at the solution and its Jacobian. Out: a step of length zero that
carries the derivative.
The solution y solves F(y, theta) = 0, so dy = -J^-1 (dF/dtheta) dtheta with J = dF/dy, the full Hessian. The Gauss-
Newton matrix leaves out the curvature of residuals and losses: with it derivatives are only about right.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def damped_inverse(matrix: Float[Array, "d d"], least: float) -> tuple[Float[Array, "d d"], Float[Array, ""]]:
    """The inverse with singular values of at least `least`, and the smallest singular value; finite for any matrix."""
    finite = jnp.where(jnp.all(jnp.isfinite(matrix)), matrix, jnp.eye(len(matrix), dtype=matrix.dtype))
    U, s, Vt = jnp.linalg.svd(finite)
    return (Vt.T / jnp.maximum(s, least)) @ U.T, s[-1]


def implicit_step(inverse: Float[Array, "d d"], force: Float[Array, " d"]) -> Float[Array, " d"]:
    """Zero, with the derivative of the solution: a Newton step of which only the derivative is left.

    Args:
        inverse: Of the full Hessian at the solution, a constant.
        force: Gradient of the cost at the solution held constant, as a function of what the solution depends on.
    """
    return -jax.lax.stop_gradient(inverse) @ (force - jax.lax.stop_gradient(force))
