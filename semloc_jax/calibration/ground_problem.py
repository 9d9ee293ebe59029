"""Mounts (and lenses) of cameras that see the same points of the ground (room: calibration; pure JAX).

In: pixels of one ground point in two cameras, mounts to start from. Out: mounts under which both cameras see it at the
same place. Minimises the sum of distances, as a mean distance is what is reported; shared unknowns only, no poses.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.calibration.drive_problem import MIN_GAIN_NATS
from semloc_jax.cameras import Camera
from semloc_jax.geometry import lie
from semloc_jax.residuals.camera_equations import with_fields
from semloc_jax.solvers.dense import DenseEquations
from semloc_jax.solvers.front import solve
from semloc_jax.solvers.levenberg_marquardt import SolveConfig
from semloc_jax.solvers.problem import Step

_LOWEST = 1e-3
"""A line of sight is taken to dip at least this much: one above the horizon meets the ground nowhere."""


class GroundState(eqx.Module):
    """Mounts and changes of the lenses."""

    T_base_cam: Float[Array, "c 4 4"]
    intrinsics: Float[Array, "c k"]


class GroundPointProblem(eqx.Module):
    """Sum of the distances between what two cameras take for the same point of the ground; a `LeastSquaresProblem`."""

    cameras: tuple[Camera, ...]
    camera: Int[Array, "p 2"]
    """Which two cameras see a point."""
    uv: Float[Array, "p 2 2"]
    """Its pixel in each of them."""
    weight: Float[Array, " p"]
    """1 for points that are used, 0 for those held out."""
    T_prior: Float[Array, "c 4 4"]
    sigma: Float[Array, " s"]
    """Of the priors: mounts (right tangents), then lenses; 0 locks."""
    noise_m: float = eqx.field(static=True)
    """Mean distance that is expected to be left."""
    smooth_m: float = eqx.field(static=True)
    """Distances below this count by their square."""
    names: tuple[tuple[str, ...], ...] = eqx.field(static=True)

    def distances(self, state: GroundState) -> Float[Array, "p 2"]:
        """Ground point of the first camera less that of the second, in the vehicle frame [m]."""
        points = jnp.zeros((*self.uv.shape[:2], 2), self.uv.dtype)
        for index, (camera, names) in enumerate(zip(self.cameras, self.names, strict=True)):
            T = state.T_base_cam[index]
            lens = with_fields(camera.astype(self.uv.dtype), names, state.intrinsics[index])
            ray, _ = lens.unproject(self.uv)
            sight = jnp.matmul(ray, T[:3, :3].T, precision=jax.lax.Precision.HIGHEST)
            reach = T[2, 3] / jnp.maximum(-sight[..., 2], _LOWEST)
            own = T[:2, 3] + reach[..., None] * sight[..., :2]
            points = jnp.where((self.camera == index)[..., None], own, points)
        return points[:, 0] - points[:, 1]

    def linearise(self, value: GroundState, skip: Bool[Array, ""]) -> DenseEquations:
        """Normal equations at a state, in units of the priors."""
        free = self.sigma > 0
        unit = jnp.where(free, self.sigma, 0.0)

        def moved(x: Array) -> tuple[Array, Array]:
            there = self._at(value, x)
            return self.distances(there), self._deviation(there)

        zero = jnp.zeros_like(unit)
        (d, off), (J, J_off) = moved(zero), jax.jacfwd(moved)(zero)
        length = jnp.sqrt(jnp.sum(d * d, axis=1) + self.smooth_m**2)
        pull = self.weight / (length * self.noise_m)
        H = jnp.einsum("pki,p,pkj->ij", J, pull, J) + J_off.T @ J_off
        g = jnp.einsum("pki,p,pk->i", J, pull, d) + J_off.T @ off
        cost = jnp.sum(self.weight * (length - self.smooth_m)) / self.noise_m + 0.5 * jnp.sum(off * off)
        locked = jnp.diag(jnp.where(free, 0.0, 1.0)).astype(unit.dtype)
        return DenseEquations(cost, g * unit, H * unit[:, None] * unit + locked)

    def step(self, equations: DenseEquations, damping: Float[Array, ""]) -> Step:
        """The damped step in units of the priors."""
        return equations.step(damping, jnp.ones_like(equations.gradient))

    def retract(self, value: GroundState, tangent: Float[Array, " s"]) -> GroundState:
        """The state after a step in units of the priors."""
        return self._at(value, tangent * self.sigma)

    def residuals(self, state: GroundState) -> Float[Array, " m"]:
        """Residuals whose half squared norm is the cost."""
        d = self.distances(state)
        beyond = jnp.sqrt(jnp.sum(d * d, axis=1) + self.smooth_m**2) - self.smooth_m
        return jnp.concatenate([jnp.sqrt(2 * self.weight * beyond / self.noise_m), self._deviation(state)])

    def _at(self, state: GroundState, x: Float[Array, " s"]) -> GroundState:
        num = state.T_base_cam.shape[0]
        T = lie.compose(state.T_base_cam, lie.exp(x[: 6 * num].reshape(num, 6)))
        return GroundState(T, state.intrinsics + x[6 * num :].reshape(state.intrinsics.shape))

    def _deviation(self, state: GroundState) -> Float[Array, " s"]:
        """Deviations from the priors in sigmas."""
        off = lie.log(lie.compose(lie.inverse(self.T_prior), state.T_base_cam))
        free = self.sigma > 0
        values = jnp.concatenate([off.ravel(), state.intrinsics.ravel()])
        return jnp.where(free, values / jnp.where(free, self.sigma, 1.0), 0.0)


@eqx.filter_jit
def solve_ground_points(
    problem: GroundPointProblem, start: GroundState, weights: Float[Array, "fold p"]
) -> tuple[GroundState, DenseEquations, Array]:
    """Best states, normal equations there and distances [fold p] of all points, for each row of weights."""

    def one(weight: Array) -> tuple[GroundState, DenseEquations, Array]:
        own = eqx.tree_at(lambda p: p.weight, problem, weight)
        solution = solve(own, start, SolveConfig(1e-4, 100, min_gain_nats=MIN_GAIN_NATS))
        return solution.value, solution.equations, jnp.linalg.norm(own.distances(solution.value), axis=1)

    return jax.lax.map(one, weights)
