"""Normal equations with many small unknowns that are eliminated first: landmarks of a window (room: solvers; pure JAX).

In: blocks of the frames, of the landmarks and between them. Out: steps, what the landmarks leave on the frames.
No factor binds two landmarks, so each is eliminated alone; what is left is dense in the unknowns of the frames.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.solvers.dense import DenseEquations
from semloc_jax.solvers.problem import Step

_HIGHEST = jax.lax.Precision.HIGHEST


class SchurEquations(eqx.Module):
    """Quadratic model cost + g x + 0.5 x H x of d frame unknowns and l landmarks of k unknowns each."""

    cost: Float[Array, ""]
    gradient: Float[Array, " d"]
    information: Float[Array, "d d"]
    landmark_gradient: Float[Array, "l k"]
    landmark: Float[Array, "l k k"]
    """Blocks of the landmarks; regular for every one of them."""
    across: Float[Array, "l p k"]
    """Blocks of the first p frame unknowns (rows) and each landmark; the other frame unknowns see none."""

    def reduced(self, more: Float[Array, " k"] | None = None) -> tuple[DenseEquations, Float[Array, "l k p"]]:
        """What is left on the frames, and the gain of every landmark: its step is minimum - gain @ frame step.

        Args:
            more: Further information on every landmark.
        """
        block = self.landmark if more is None else self.landmark + jnp.diag(more)
        inverse = jnp.linalg.inv(block)
        gain = jnp.einsum("lij,lpj->lip", inverse, self.across, precision=_HIGHEST)
        num = self.across.shape[1]
        S = jnp.einsum("lpk,lkq->pq", self.across, gain, precision=_HIGHEST)
        g = jnp.einsum("lkp,lk->p", gain, self.landmark_gradient, precision=_HIGHEST)
        H = self.information.at[:num, :num].add(-0.5 * (S + S.T))
        free = jnp.einsum("lij,lj->li", inverse, self.landmark_gradient, precision=_HIGHEST)
        cost = self.cost - 0.5 * jnp.sum(free * self.landmark_gradient)
        return DenseEquations(cost, self.gradient.at[:num].add(-g), H), gain

    def step(self, damping: Float[Array, ""], units: Float[Array, " d"], landmark_units: Float[Array, " k"]) -> Step:
        """Minimum of the damped model; its tangent is the pair (frames [d], landmarks [l k])."""
        on_frames, on_landmarks = damping / units**2, damping / landmark_units**2
        left, gain = self.reduced(on_landmarks)
        scaled = units[:, None] * (left.information + jnp.diag(on_frames)) * units
        frames = -units * jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(scaled), units * left.gradient)
        damped = self.landmark + jnp.diag(on_landmarks)
        free = jnp.linalg.solve(damped, self.landmark_gradient[..., None])[..., 0]
        landmarks = -free - jnp.einsum("lkp,p->lk", gain, frames[: gain.shape[2]], precision=_HIGHEST)
        # (H + damping) x = -g gives x H x = -g x - damping x x.
        promised = jnp.dot(self.gradient, frames) + jnp.sum(self.landmark_gradient * landmarks)
        held = jnp.sum(on_frames * frames**2) + jnp.sum(on_landmarks * landmarks**2)
        length = jnp.max(jnp.abs(frames / units))
        return Step((frames, landmarks), 0.5 * (promised - held), length)
