"""Normal equations of a chain of poses with shared unknowns: a block arrow (room: solvers; pure JAX).

In: blocks of the poses, of neighbours, across, of what is shared. Out: steps, and what the chain leaves of the shared
part. Cost grows with the number of poses, not with its cube: each pose is eliminated into the next, all into what is
shared.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class ArrowEquations(eqx.Module):
    """Quadratic model cost + g x + 0.5 x H x of poses 0 .. n-1 (six unknowns each) and s shared unknowns."""

    cost: Float[Array, ""]
    pose: Float[Array, "n 6 6"]
    """Diagonal blocks of the poses."""
    next: Float[Array, "n 6 6"]
    """Block of pose i (rows) and pose i + 1 (columns); the last one is zero."""
    across: Float[Array, "n 6 s"]
    """Block of pose i (rows) and the shared unknowns (columns)."""
    shared: Float[Array, "s s"]
    pose_gradient: Float[Array, "n 6"]
    shared_gradient: Float[Array, " s"]

    def damped(self, pose: Float[Array, "6"], shared: Float[Array, " s"]) -> "ArrowEquations":
        """The equations with further information on every pose and on the shared unknowns."""
        return eqx.tree_at(
            lambda e: (e.pose, e.shared), self, (self.pose + jnp.diag(pose), self.shared + jnp.diag(shared))
        )

    def dense(self) -> tuple[Float[Array, "d d"], Float[Array, " d"]]:
        """Hessian and gradient in full, poses first: for tests and small problems."""
        num, size = self.pose.shape[0], self.shared.shape[0]
        H = jnp.zeros((6 * num + size, 6 * num + size), self.shared.dtype).at[6 * num :, 6 * num :].set(self.shared)
        for i in range(num):
            here = slice(6 * i, 6 * i + 6)
            H = H.at[here, here].set(self.pose[i]).at[here, 6 * num :].set(self.across[i])
            H = H.at[6 * num :, here].set(self.across[i].T)
            if i + 1 < num:
                after = slice(6 * i + 6, 6 * i + 12)
                H = H.at[here, after].set(self.next[i]).at[after, here].set(self.next[i].T)
        return H, jnp.concatenate([self.pose_gradient.reshape(-1), self.shared_gradient])


def reduced(
    equations: ArrowEquations,
) -> tuple[Float[Array, "s s"], Float[Array, " s"], Float[Array, "n 6 t"]]:
    """Information and gradient of the shared unknowns when every pose is free, and the solved chain [across, gradient].

    Block elimination of the tridiagonal chain, then the Schur complement.
    """
    right = jnp.concatenate([equations.across, equations.pose_gradient[..., None]], axis=-1)
    solved = _solve_chain(equations.pose, equations.next, right)
    S = equations.shared - _sum(equations.across, solved[..., :-1])
    g = equations.shared_gradient - _sum(equations.across, solved[..., -1:])[:, 0]
    return 0.5 * (S + S.T), g, solved


def step(equations: ArrowEquations) -> tuple[Float[Array, "n 6"], Float[Array, " s"]]:
    """The minimum of the quadratic model: steps of the poses and of the shared unknowns."""
    S, g, solved = reduced(equations)
    shared = -jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(S), g)
    return -(solved[..., -1] + _mul(solved[..., :-1], shared)), shared


def _solve_chain(D: Float[Array, "n 6 6"], B: Float[Array, "n 6 6"], R: Float[Array, "n 6 t"]) -> Float[Array, "n 6 t"]:
    """X with D_i X_i + B_i X_i+1 + B_i-1' X_i-1 = R_i."""

    def forward(carry: tuple, row: tuple) -> tuple[tuple, tuple]:
        gain, right = carry  # B_i-1' D_i-1^-1 B_i-1 and B_i-1' D_i-1^-1 R_i-1
        D_i, B_i, R_i = row
        factor = jax.scipy.linalg.cho_factor(D_i - gain)
        solved = jax.scipy.linalg.cho_solve(factor, jnp.concatenate([B_i, R_i - right], axis=1))
        carried = _mul(B_i.T, solved)
        return (carried[:, :6], carried[:, 6:]), (solved[:, :6], solved[:, 6:])

    def backward(after: Array, row: tuple) -> tuple[Array, Array]:
        along, free = row
        here = free - _mul(along, after)
        return here, here

    start = (jnp.zeros((6, 6), D.dtype), jnp.zeros((6, R.shape[-1]), D.dtype))
    _, rows = jax.lax.scan(forward, start, (D, B, R))
    return jax.lax.scan(backward, start[1], rows, reverse=True)[1]


def _sum(across: Float[Array, "n 6 s"], solved: Float[Array, "n 6 t"]) -> Float[Array, "s t"]:
    return jnp.einsum("nks,nkt->st", across, solved, precision=jax.lax.Precision.HIGHEST)


def _mul(A: Array, b: Array) -> Array:
    return jnp.matmul(A, b, precision=jax.lax.Precision.HIGHEST)
