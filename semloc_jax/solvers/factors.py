"""Variables and factors as data (room: solvers; pure JAX).

In: values, measurements, residual functions. Out: Kind, Factors, and the local normal equations of every factor.
A residual is written for one factor: residual(value, ..., data, ..., sqrt_info) -> whitened residuals.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from semloc_jax.geometry import lie


class Kind(NamedTuple):
    """A manifold that variables live on."""

    size: int
    """Coordinates of the tangent."""
    retract: Callable[[ArrayLike, ArrayLike], Array]
    """(value, tangent) -> value, for any leading axes."""
    units: tuple[float, ...]
    """Scale of the damping along each coordinate."""


def _moved_pose(T: Float[ArrayLike, "*n 4 4"], xi: Float[ArrayLike, "*n 6"]) -> Float[Array, "*n 4 4"]:
    return lie.compose(T, lie.exp(xi))


def _moved_vector(x: Float[ArrayLike, "*n d"], step: Float[ArrayLike, "*n d"]) -> Float[Array, "*n d"]:
    return jnp.asarray(x) + jnp.asarray(step)


POSE = Kind(6, _moved_pose, (0.5, 0.5, 0.5, 0.05, 0.05, 0.05))
"""T_a_b with its right tangent (v, omega) [m, rad]."""


@cache
def vector(*units: float) -> Kind:
    """Vectors with one coordinate for each unit given."""
    return Kind(len(units), _moved_vector, units)


class Local(NamedTuple):
    """Quadratic models of the factors of one family, by the coordinates of the variables that each of them binds."""

    cost: Float[Array, " f"]
    gradient: Float[Array, "f k"]
    hessian: Float[Array, "f k k"]


class WeighedRows(NamedTuple):
    """Costs of the factors of one family, and their rows in reweighted least squares."""

    cost: Float[Array, " f"]
    residuals: Float[Array, "f r"]
    by_tangent: Float[Array, "f r k"]
    """By the coordinates of the variables that each of them binds."""


class Factors(eqx.Module):
    """A family of factors: the same residual on different variables."""

    residual: Callable[..., Array] = eqx.field(static=True)
    """(values ..., data ..., sqrt_info) -> whitened residuals of one factor."""
    on: tuple[str, ...] = eqx.field(static=True)
    """Families of the variables that one factor binds, in the order of the arguments."""
    keys: tuple[Int[Array | np.ndarray, " f"], ...]
    """Place of each variable in its family."""
    data: tuple[Any, ...]
    """What was measured: pytrees with a leading axis over the factors."""
    sqrt_info: Float[Array | np.ndarray, "f ..."]
    """The last argument of the residual; zero switches a factor off."""
    weight: Float[Array | np.ndarray, " f"] | None = None
    """Factor of the cost of each; None for one."""
    robust: Callable[[Array], tuple[Array, Array]] | None = eqx.field(static=True, default=None)
    """residuals -> (cost, root of the weight in reweighted least squares); None for half the squared norm."""
    linearised: Callable[..., tuple[Array, ...]] | None = eqx.field(static=True, default=None)
    """As `residual`, returns it and its derivatives by the tangent of each variable; None for automatic ones."""

    def arguments(self, values: dict[str, Array | np.ndarray]) -> tuple:
        """What the residual takes, with a leading axis over the factors."""
        return (*(values[name][key] for name, key in zip(self.on, self.keys, strict=True)), *self.data, self.sqrt_info)

    def residuals(self, values: dict[str, Array | np.ndarray]) -> Float[Array, "f r"]:
        """Whitened residuals before any robust function and weight."""
        return jax.vmap(self.residual)(*self.arguments(values))

    def costs(self, values: dict[str, Array | np.ndarray]) -> Float[Array, " f"]:
        """Cost of each factor [nats]."""
        return self._weighed(self.residuals(values))[0]

    def local(
        self,
        values: dict[str, Array | np.ndarray],
        kinds: dict[str, Kind],
        slopes_at: dict[str, Array | np.ndarray] | None = None,
    ) -> Local:
        """Cost, gradient and Gauss-Newton Hessian of every factor.

        Args:
            values: Where the residuals are taken.
            kinds: Manifolds of the families.
            slopes_at: Where the derivatives are taken (first estimates); None: at the values.
        """
        cost, r, J = self.rows(values, kinds, slopes_at)
        highest = jax.lax.Precision.HIGHEST
        gradient = jnp.einsum("fri,fr->fi", J, r, precision=highest)
        return Local(cost, gradient, jnp.einsum("fri,frj->fij", J, J, precision=highest))

    def rows(
        self,
        values: dict[str, Array | np.ndarray],
        kinds: dict[str, Kind],
        slopes_at: dict[str, Array | np.ndarray] | None = None,
    ) -> WeighedRows:
        """Costs, residuals and their derivatives, reweighted; arguments as `local`."""
        at = values if slopes_at is None else slopes_at
        r, J = self.derivatives(at, kinds)
        if slopes_at is not None:
            r = self.residuals(values)
        cost, root = self._weighed(r)
        return WeighedRows(cost, r * root[:, None], J * root[:, None, None])

    def derivatives(
        self, values: dict[str, Array | np.ndarray], kinds: dict[str, Kind]
    ) -> tuple[Float[Array, "f r"], Float[Array, "f r k"]]:
        """Whitened residuals before any robust function and weight, and their derivatives by the tangents."""
        arguments, own = self.arguments(values), [kinds[name] for name in self.on]
        if self.linearised is not None:
            r, *J = jax.vmap(self.linearised)(*arguments)
            return r, jnp.concatenate(J, axis=-1)
        ends = np.cumsum([kind.size for kind in own])

        def one(*arguments: Any) -> tuple[Array, Array]:
            variables, data = arguments[: len(own)], arguments[len(own) :]

            def moved(step: Array) -> Array:
                steps = jnp.split(step, ends[:-1])
                at = (kind.retract(v, s) for kind, v, s in zip(own, variables, steps, strict=True))
                return self.residual(*at, *data)

            zero = jnp.zeros(ends[-1], variables[0].dtype)
            return moved(zero), jax.jacfwd(moved)(zero)

        return jax.vmap(one)(*arguments)

    def _weighed(self, r: Float[Array, "f r"]) -> tuple[Float[Array, " f"], Float[Array, " f"]]:
        """Costs, and the roots of the weights in reweighted least squares."""
        if self.robust is None:
            cost, root = 0.5 * jnp.sum(r * r, axis=1), jnp.ones(len(r), r.dtype)
        else:
            cost, root = jax.vmap(self.robust)(r)
        if self.weight is not None:
            cost, root = self.weight * cost, jnp.sqrt(jnp.asarray(self.weight)) * root
        return cost, root


def costs_of(factors: Factors, values: dict[str, Array | np.ndarray]) -> Float[Array, " f"]:
    """`Factors.costs`, for the host: one program for all families of one shape, instead of a hundred operations."""
    return _costs(factors, {name: values[name] for name in factors.on})


@eqx.filter_jit
def _costs(factors: Factors, values: dict[str, Array | np.ndarray]) -> Float[Array, " f"]:
    return factors.costs(values)
