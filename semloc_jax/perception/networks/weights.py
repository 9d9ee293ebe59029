"""Weights of a network on disk, with a card that says what it is (room: perception; host).

In: any equinox module and a card. Out: one npz file, written whole; read only where every array fits.
"""

import json
from pathlib import Path
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.storage import npz_arrays, write_npz

_CARD = "card"
_MOST_BYTES = 2**28
"""No network of ours has as much: a small file may state any size."""
T = TypeVar("T")


def save_weights(path: str | Path, network: Any, card: dict[str, Any]) -> None:
    """Write the arrays of a network and its card: kind, settings, classes, what it was taught on, figures.

    Args:
        path: File, `.weights`.
        network: Its arrays are stored as float32.
        card: Whatever JSON holds.
    """
    arrays = {name: np.asarray(leaf, np.float32) for name, leaf in _leaves(network)}
    write_npz(path, arrays | {_CARD: np.frombuffer(json.dumps(card).encode(), np.uint8)})


def read_card(path: str | Path) -> dict[str, Any]:
    """The card of a file of weights.

    Raises:
        SemlocError: no such file, or no card in it.
    """
    where = f"weights {path}"
    if not Path(path).is_file():
        raise SemlocError(f"{where}: no such file; expected what `semloc learn` wrote")
    content = npz_arrays(Path(path), where, _MOST_BYTES, (_CARD,)).get(_CARD)
    try:
        card = json.loads(np.asarray(content, np.uint8).tobytes())
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        raise SemlocError(f"{where}: has no card; expected what `semloc learn` wrote") from error
    if not isinstance(card, dict):
        raise SemlocError(f"{where}: its card is a {type(card).__name__}; expected what `semloc learn` wrote")
    return card


def load_weights(path: str | Path, like: T) -> T:
    """The network of a file.

    Args:
        path: The file.
        like: A network of the same make, as its card says; its arrays are replaced.

    Raises:
        SemlocError: the file is missing, has other arrays, or some that are not finite.
    """
    where = f"weights {path}"
    if not Path(path).is_file():
        raise SemlocError(f"{where}: no such file; expected what `semloc learn` wrote")
    stored = npz_arrays(Path(path), where, _MOST_BYTES)
    stored.pop(_CARD, None)
    expected = dict(_leaves(like))
    other = sorted(set(stored) ^ set(expected))
    if other:
        raise SemlocError(f"{where}: its arrays are not those of such a network ({other[0]}); get the file anew")
    for name, leaf in expected.items():
        if stored[name].shape != leaf.shape or stored[name].dtype != np.float32 or not np.isfinite(stored[name]).all():
            raise SemlocError(
                f"{where}: {name} is {stored[name].dtype}{list(stored[name].shape)}; expected finite "
                f"float32{list(leaf.shape)}; get the file anew"
            )
    arrays, rest = eqx.partition(like, eqx.is_inexact_array)
    _, structure = jax.tree.flatten(arrays)
    leaves = [jnp.asarray(stored[name], leaf.dtype) for name, leaf in expected.items()]
    return eqx.combine(jax.tree.unflatten(structure, leaves), rest)


def _leaves(network: Any) -> list[tuple[str, Any]]:
    """Name and array of every parameter, e.g. blocks.0.1.first.kernel."""
    leaves = jax.tree.leaves_with_path(eqx.filter(network, eqx.is_inexact_array))
    return [(jax.tree_util.keystr(path, simple=True, separator="."), leaf) for path, leaf in leaves]
