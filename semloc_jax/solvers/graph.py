"""A factor graph: variables by families, factors by families (room: solvers; pure JAX).

In: kinds of variables, factors. Out: FactorGraph: its cost, its local normal equations, its retraction.
Values are a dictionary: name of the family -> array with a leading axis over its variables.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations_with_replacement, product
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.solvers.factors import Factors, Kind, Local

Values = dict[str, Array | np.ndarray]
Steps = dict[str, Array | np.ndarray]


class Family(NamedTuple):
    """Variables of one kind."""

    name: str
    kind: Kind
    num: int


class Block(NamedTuple):
    """One block of the Hessian of every factor of a family: (rows, columns) are two of its variables."""

    rows: str
    row_key: Int[Array | np.ndarray, " f"]
    columns: str
    column_key: Int[Array | np.ndarray, " f"]
    hessian: Float[Array, "f a b"]


class FactorGraph(eqx.Module):
    """Variables and what is known of them."""

    families: tuple[Family, ...] = eqx.field(static=True)
    """Every family of variables; their order is that of the unknowns."""
    factors: tuple[Factors, ...]
    free: dict[str, Bool[Array | np.ndarray, "n d"]] = eqx.field(default_factory=dict)
    """False for coordinates that stay where they are; families that are not named are free."""

    def family(self, name: str) -> Family:
        """The family of a name."""
        return next(family for family in self.families if family.name == name)

    def cost(self, values: Values) -> Float[Array, ""]:
        """Sum of the costs of all factors [nats]."""
        return sum(jnp.sum(local.cost) for local in self.local(values))

    def local(self, values: Values, slopes_at: Values | None = None) -> list[Local]:
        """Quadratic models of the factors of every family; locked coordinates do not move them.

        Args:
            values: Where the residuals are taken.
            slopes_at: Where the derivatives are taken (first estimates); None: at the values.
        """
        kinds = {family.name: family.kind for family in self.families}
        found = []
        for factors in self.factors:
            local = factors.local(values, kinds, slopes_at)
            if any(name in self.free for name in factors.on):
                free = [
                    self.free[name][key] if name in self.free else np.ones((len(local.cost), kinds[name].size), bool)
                    for name, key in zip(factors.on, factors.keys, strict=True)
                ]
                mask = jnp.concatenate([jnp.asarray(rows) for rows in free], axis=1)
                hessian = jnp.where(mask[:, :, None] & mask[:, None, :], local.hessian, 0.0)
                local = Local(local.cost, jnp.where(mask, local.gradient, 0.0), hessian)
            found.append(local)
        return found

    def spans(self, factors: Factors) -> list[slice]:
        """Where the coordinates of each variable of a factor stand in its local equations."""
        sizes = [self.family(name).kind.size for name in factors.on]
        return [slice(end - size, end) for size, end in zip(sizes, np.cumsum(sizes).tolist(), strict=True)]

    def blocks(self, local: list[Local], upper: bool = False) -> Iterator[Block]:
        """Every block of the Hessians of all factors; `upper`: without the transposes of those that are yielded."""
        for factors, found in zip(self.factors, local, strict=True):
            slots = list(zip(factors.on, factors.keys, self.spans(factors), strict=True))
            pairs = combinations_with_replacement(slots, 2) if upper else product(slots, repeat=2)
            for (rows, row_key, above), (columns, column_key, beside) in pairs:
                yield Block(rows, row_key, columns, column_key, found.hessian[:, above, beside])

    def gradients(self, local: list[Local]) -> Steps:
        """Gradient of the cost by the tangent of every variable."""
        dtype = local[0].gradient.dtype
        g = {family.name: jnp.zeros((family.num, family.kind.size), dtype) for family in self.families}
        for factors, found in zip(self.factors, local, strict=True):
            for name, key, span in zip(factors.on, factors.keys, self.spans(factors), strict=True):
                g[name] = g[name].at[key].add(found.gradient[:, span])
        return g

    def held(self, name: str) -> Bool[Array | np.ndarray, "n d"]:
        """Which coordinates of a family are locked: their information is 1."""
        family = self.family(name)
        return ~self.free[name] if name in self.free else np.zeros((family.num, family.kind.size), bool)

    def retract(self, values: Values, steps: Steps) -> Values:
        """The values after a step of every variable."""
        return {family.name: family.kind.retract(values[family.name], steps[family.name]) for family in self.families}


def units_of(families: Sequence[Family]) -> np.ndarray:
    """Scale of the damping of every coordinate, family by family."""
    return np.concatenate([np.zeros(0), *(np.tile(family.kind.units, family.num) for family in families)])


def split(x: Float[Array, " d"], families: Sequence[Family]) -> Steps:
    """Steps of every variable from one vector of all, family by family."""
    sizes = [family.num * family.kind.size for family in families]
    parts = jnp.split(x, np.cumsum(sizes)[:-1]) if sizes else []
    return {f.name: part.reshape(f.num, f.kind.size) for f, part in zip(families, parts, strict=True)}
