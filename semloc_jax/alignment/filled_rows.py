"""A function over the filled rows of arrays of a fixed size (room: alignment; pure JAX).

In: a function of one row, rows, how many are filled. Out: its results; rows beyond stay zero and cost nothing.
One program serves any number of rows: how many there are is data.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int


def map_filled(function: Callable[[Any], Any], rows: Any, num: Int[Array, ""] | int) -> Any:
    """`function` of each of the first `num` rows, one after another, in arrays of the size of `rows`.

    Args:
        function: Of one row: a tree of arrays without their leading axis.
        rows: Tree of arrays with one leading axis.
        num: Number of rows that are filled, at most their size.
    """
    size, function = len(jax.tree.leaves(rows)[0]), jax.jit(function)  # traced once for its shapes and for the loop
    shapes = jax.eval_shape(lambda own: function(jax.tree.map(lambda leaf: leaf[0], own)), rows)
    empty = jax.tree.map(lambda shape: jnp.zeros((size, *shape.shape), shape.dtype), shapes)

    def with_row(index: Array, results: Any) -> Any:
        result = function(jax.tree.map(lambda leaf: leaf[index], rows))
        return jax.tree.map(lambda leaf, value: leaf.at[index].set(value), results, result)

    return jax.lax.fori_loop(0, num, with_row, empty)
