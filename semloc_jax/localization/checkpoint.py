"""The state of a localizer in a file, bit for bit (room: localization; host).

In: TrackerState. Out: an npz file, written whole or not at all; and back.
"""

import json
import math
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.localization.track_state import ElementTrust, TrackerState
from semloc_jax.storage import npz_arrays, writing

_META = "next_frame", "is_initialised"
_INDEX = "index"
"""Name, type and shape of each leaf, as JSON. Leaves of one type lie in one array: there are some 85, at each frame."""


class Checkpoint(NamedTuple):
    """Where a run stands after a frame."""

    state: TrackerState
    next_frame: int
    """Place of the next frame in the list of frames."""
    is_initialised: bool
    """Whether the vehicle was tracked before."""


def save(checkpoint: Checkpoint, path: Path) -> None:
    """Write a checkpoint; a kill while it is written leaves the one before."""
    leaves, structure = jax.tree.flatten(checkpoint.state)
    arrays = [np.asarray(leaf) for leaf in leaves]
    kinds: dict[str, list[np.ndarray]] = {}
    for array in arrays:
        kinds.setdefault(array.dtype.str, []).append(array.reshape(-1))
    index = [(name, array.dtype.str, array.shape) for name, array in zip(_names(structure), arrays, strict=True)]
    sizes = {"num_tracks": len(checkpoint.state.tracks), "num_coasting": len(checkpoint.state.coasting)}
    meta = {key: getattr(checkpoint, key) for key in _META}
    with writing(path) as partial, partial.open("wb") as file:
        packed = {kind: np.concatenate(parts) for kind, parts in kinds.items()}
        np.savez(file, **packed, **sizes, **meta, **{_INDEX: json.dumps(index)})


def load(path: Path, template: TrackerState) -> Checkpoint:
    """A checkpoint as it was saved.

    Args:
        path: The file.
        template: A state of the same map and fusion with one track and one coasting state.

    Raises:
        SemlocError: there is no such file, or it belongs to another map, fusion or version.
    """
    try:
        content = npz_arrays(path, f"checkpoint {path}")
        state_of = _unpacked(content)
        tracks = template.tracks * int(content["num_tracks"])
        coasting = template.coasting * int(content["num_coasting"])
        wanted = template._replace(tracks=tracks, coasting=coasting)
        like, structure = jax.tree.flatten(wanted)
        leaves = [_checked(state_of[n], leaf, n) for n, leaf in zip(_names(structure), like, strict=True)]
        state = jax.tree.unflatten(structure, leaves)
        _require_same_map(state.trust, template.trust)
        return Checkpoint(state, int(content["next_frame"]), bool(content["is_initialised"]))
    except FileNotFoundError as error:
        raise SemlocError(f"checkpoint {path}: no such file; give --resume the folder of an unfinished run") from error
    except (KeyError, ValueError) as error:
        raise SemlocError(
            f"checkpoint {path}: does not fit ({error}); resume with the map, the fusion and the version of the run"
        ) from error


@lru_cache(maxsize=16)
def _names(structure: jax.tree_util.PyTreeDef) -> tuple[str, ...]:
    """Where each leaf of a state stands in it."""
    places = jax.tree.unflatten(structure, range(structure.num_leaves))
    return tuple(jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_flatten_with_path(places)[0])


def _unpacked(content: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Every leaf by its name, from one array for each type."""
    found, used = {}, dict.fromkeys(content, 0)
    for name, kind, shape in json.loads(str(content[_INDEX])):
        size = math.prod(shape)
        found[name] = content[kind][used[kind] : used[kind] + size].reshape(shape)
        used[kind] += size
    return found


def _require_same_map(found: ElementTrust, like: ElementTrust) -> None:
    if found.num_in_map != like.num_in_map:
        raise ValueError(f"a map of {found.num_in_map:.0f} elements, expected {like.num_in_map:.0f}")


def _checked(found: np.ndarray, like: Any, name: str) -> np.ndarray | np.generic:
    # A list that starts empty may have grown.
    is_list = np.shape(like) == (0,) and found.ndim == 1
    if found.shape != np.shape(like) and not is_list:
        raise ValueError(f"{name} has shape {found.shape}, expected {np.shape(like)}")
    return found[()] if found.ndim == 0 else found
