"""Normal equations with many small unknowns that are eliminated first: landmarks of a window (room: solvers; pure JAX).

In: blocks of the frames, of the landmarks and between them. Out: steps, what the landmarks leave on the frames.
No factor binds two landmarks, so each is eliminated alone; what is left is dense in the unknowns of the frames.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from semloc_jax.solvers import landmark_kernels
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

    def reduced(self) -> DenseEquations:
        """What is left on the frames."""
        return self._reduced(_inverses(self.landmark))

    def _reduced(self, inverse: Float[Array, "l k k"]) -> DenseEquations:
        num = self.across.shape[1]
        S, g = _eliminated(self.across, inverse, self.landmark_gradient)
        H = self.information.at[:num, :num].add(-0.5 * (S + S.T))
        free = jnp.einsum("lij,lj->li", inverse, self.landmark_gradient, precision=_HIGHEST)
        cost = self.cost - 0.5 * jnp.sum(free * self.landmark_gradient)
        return DenseEquations(cost, self.gradient.at[:num].add(-g), H)

    def step(self, damping: Float[Array, ""], units: Float[Array, " d"], landmark_units: Float[Array, " k"]) -> Step:
        """Minimum of the damped model; its tangent is the pair (frames [d], landmarks [l k]).

        Its length is that of the step of the frames in standard deviations: landmarks that fit badly go on and on
        without moving them.
        """
        on_frames, on_landmarks = damping / units**2, damping / landmark_units**2
        inverse = _inverses(self.landmark + jnp.diag(on_landmarks))
        left = self._reduced(inverse)
        scaled = units[:, None] * (left.information + jnp.diag(on_frames)) * units
        frames = -units * jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(scaled), units * left.gradient)
        pulled = jnp.einsum("lpk,p->lk", self.across, frames[: self.across.shape[1]], precision=_HIGHEST)
        landmarks = -jnp.einsum("lij,lj->li", inverse, self.landmark_gradient + pulled, precision=_HIGHEST)
        # (H + damping) x = -g gives x H x = -g x - damping x x.
        promised = jnp.dot(self.gradient, frames) + jnp.sum(self.landmark_gradient * landmarks)
        held = jnp.sum(on_frames * frames**2) + jnp.sum(on_landmarks * landmarks**2)
        length = jnp.sqrt(jnp.maximum(-jnp.dot(left.gradient, frames), 0.0))
        return Step((frames, landmarks), 0.5 * (promised - held), length)


def _eliminated(
    across: Float[Array, "l p k"], inverse: Float[Array, "l k k"], gradient: Float[Array, "l k"]
) -> tuple[Float[Array, "p p"], Float[Array, " p"]]:
    if across.shape[2] == 3 and landmark_kernels.are_used(across.dtype):
        return landmark_kernels.eliminated(across, inverse, gradient)
    gain = jnp.einsum("lij,lpj->lip", inverse, across, precision=_HIGHEST)
    S = jnp.einsum("lpk,lkq->pq", across, gain, precision=_HIGHEST)
    return S, jnp.einsum("lkp,lk->p", gain, gradient, precision=_HIGHEST)


def _inverses(blocks: Float[Array, "l k k"]) -> Float[Array, "l k k"]:
    """Inverses of small positive definite matrices, by sweeping one pivot after another; LAPACK takes each alone."""
    swept = blocks
    for k in range(blocks.shape[-1]):
        pivot = swept[:, k, k, None]
        row = swept[:, k] / pivot
        swept = swept - swept[:, :, k, None] * row[:, None]
        swept = swept.at[:, k].set(row).at[:, :, k].set(row).at[:, k, k].set(-1.0 / pivot[:, 0])
    return -swept
