"""Landmarks eliminated first give the step and the covariance of the full matrix."""

import jax
import jax.numpy as jnp
import numpy as np

from semloc_jax.solvers.schur import SchurEquations


def equations(frames=8, seen=6, landmarks=5, seed=0):
    """A random problem whose first `seen` frame unknowns see the landmarks; and its full Hessian and gradient."""
    rng = np.random.default_rng(seed)
    size = frames + 3 * landmarks
    H, g = np.diag(np.full(size, 0.1)), rng.normal(size=size)
    for k in range(landmarks):
        at = [*range(seen), *range(frames + 3 * k, frames + 3 * k + 3)]
        J = rng.normal(size=(12, len(at)))
        H[np.ix_(at, at)] += J.T @ J
    J = rng.normal(size=(4, frames))
    H[:frames, :frames] += J.T @ J
    blocks = [slice(frames + 3 * k, frames + 3 * k + 3) for k in range(landmarks)]
    parts = SchurEquations(
        jnp.asarray(1.0),
        jnp.asarray(g[:frames]),
        jnp.asarray(H[:frames, :frames]),
        jnp.asarray(np.stack([g[b] for b in blocks])),
        jnp.asarray(np.stack([H[b, b] for b in blocks])),
        jnp.asarray(np.stack([H[:seen, b] for b in blocks])),
    )
    return parts, H, g


def test_step_and_marginal_are_those_of_the_full_matrix():
    parts, H, g = equations()
    units, own = np.linspace(0.5, 2.0, 8), np.array([1.0, 0.5, 2.0])
    damping = 0.3
    full = H + damping * np.diag(1.0 / np.concatenate([units, np.tile(own, 5)]) ** 2)
    x = -np.linalg.solve(full, g)
    step = jax.jit(SchurEquations.step)(parts, jnp.asarray(damping), jnp.asarray(units), jnp.asarray(own))
    np.testing.assert_allclose(np.concatenate([step.tangent[0], step.tangent[1].ravel()]), x, atol=1e-10)
    np.testing.assert_allclose(step.change, g @ x + 0.5 * x @ H @ x, atol=1e-10)
    left = jax.jit(SchurEquations.reduced)(parts)
    np.testing.assert_allclose(np.linalg.inv(left.information), np.linalg.inv(H)[:8, :8], atol=1e-10)
    np.testing.assert_allclose(np.linalg.solve(left.information, left.gradient), np.linalg.solve(H, g)[:8], atol=1e-10)
