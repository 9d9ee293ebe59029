"""What Levenberg-Marquardt asks of a problem, and what it returns (room: solvers; pure JAX).

In: nothing. Out: the protocols LeastSquaresProblem and Equations; Step, Solution.
Cost is half the squared norm of the whitened residuals [nats].
"""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.structs import SolveStatus


class Step(NamedTuple):
    """A damped step of the quadratic model."""

    tangent: Any
    """What `LeastSquaresProblem.retract` takes."""
    change: Float[Array, ""]
    """Change of the cost that the quadratic model predicts [nats]; never positive where the step is the minimum."""
    length: Float[Array, ""]
    """Largest coordinate, in the units of the damping."""


class Equations(Protocol):
    """Normal equations: a quadratic model of the cost around a value; a pytree of fixed shapes."""

    cost: Float[Array, ""]


@runtime_checkable
class LeastSquaresProblem(Protocol):
    """A cost over values on a manifold."""

    def linearise(self, value: Any, skip: Bool[Array, ""]) -> Any:
        """`Equations` at a value. Where `skip` is True nobody looks at the result: it may be anything finite."""

    def step(self, equations: Any, damping: Float[Array, ""]) -> Step:
        """Minimum of the model with `damping` added to the information of every coordinate, in units of that one."""

    def retract(self, value: Any, tangent: Any) -> Any:
        """The value after a step."""


class Solution(eqx.Module):
    """The best value that was found."""

    value: Any
    equations: Any
    """Undamped normal equations at the value."""
    num_steps: Int[Array, ""]
    """Evaluations that were spent."""
    status: Int[Array, ""]
    """`SolveStatus`: CONVERGED, MAX_STEPS or NOT_FINITE."""

    @property
    def cost(self) -> Float[Array, ""]:
        """Cost at the value [nats]."""
        return self.equations.cost

    @property
    def converged(self) -> Bool[Array, ""]:
        """Whether the last step was below the tolerance."""
        return self.status == SolveStatus.CONVERGED
