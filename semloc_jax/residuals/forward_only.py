"""Functions without a derivative say so and name the one that has it (room: residuals; pure JAX).

In: the arguments of such a function. Out: the same values; differentiating by them raises.
Without this a derivative would stop at a foreign call with JAX's own words, or pass through a rounding as a silent 0.
"""

from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp

from semloc_jax.errors import SemlocError

Tree = TypeVar("Tree")


def forward_only(what: str, tree: Tree) -> Tree:
    """The same values.

    Args:
        what: The function that has no derivative, for the message.
        tree: Its arguments; only floating-point arrays are looked at.

    Raises:
        SemlocError: While JAX differentiates by one of them (grad, jacobian, jvp, linearize).
    """
    leaves, structure = jax.tree.flatten(tree)
    place = [k for k, leaf in enumerate(leaves) if _is_float(leaf)]
    if place:  # one rule for all of them: each that is traced costs a millisecond
        for k, leaf in zip(place, _checked(what, [leaves[k] for k in place]), strict=True):
            leaves[k] = leaf
    return jax.tree.unflatten(structure, leaves)


def _is_float(leaf: object) -> bool:
    # Only a tracer can carry a derivative; what is concrete passes as it is.
    return isinstance(leaf, jax.core.Tracer) and jnp.issubdtype(leaf.dtype, jnp.floating)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _checked(what: str, leaves: list[jax.Array]) -> list[jax.Array]:
    return leaves


@_checked.defjvp
def _refuse(what: str, primals: tuple, tangents: tuple) -> tuple:
    raise SemlocError(
        f"{what} has no derivative; expected to be called outside of jax.grad. The differentiable way: "
        "semloc_jax.align(..., differentiable=True) from arrays, or semloc_jax.align_differentiable on a SmoothScene"
    )
