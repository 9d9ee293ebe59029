"""The state of a localizer in a file, bit for bit (room: localization; host).

In: TrackerState. Out: an npz file, written whole or not at all; and back.
"""

from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.localization.track_state import ElementTrust, TrackerState
from semloc_jax.storage import npz_arrays, writing

_META = "next_frame", "is_initialised"


class Checkpoint(NamedTuple):
    """Where a run stands after a frame."""

    state: TrackerState
    next_frame: int
    """Place of the next frame in the list of frames."""
    is_initialised: bool
    """Whether the vehicle was tracked before."""


def save(checkpoint: Checkpoint, path: Path) -> None:
    """Write a checkpoint; a kill while it is written leaves the one before."""
    leaves = {name: np.asarray(leaf) for name, leaf in _named(checkpoint.state)}
    sizes = {"num_tracks": len(checkpoint.state.tracks), "num_coasting": len(checkpoint.state.coasting)}
    meta = {key: getattr(checkpoint, key) for key in _META}
    with writing(path) as partial, partial.open("wb") as file:
        np.savez(file, **leaves, **sizes, **meta)


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
        tracks = template.tracks * int(content["num_tracks"])
        coasting = template.coasting * int(content["num_coasting"])
        wanted = template._replace(tracks=tracks, coasting=coasting)
        leaves = [_checked(content[name], leaf, name) for name, leaf in _named(wanted)]
        state = jax.tree.unflatten(jax.tree.structure(wanted), leaves)
        _require_same_map(state.trust, template.trust)
        return Checkpoint(state, int(content["next_frame"]), bool(content["is_initialised"]))
    except FileNotFoundError as error:
        raise SemlocError(f"checkpoint {path}: no such file; give --resume the folder of an unfinished run") from error
    except (KeyError, ValueError) as error:
        raise SemlocError(
            f"checkpoint {path}: does not fit ({error}); resume with the map, the fusion and the version of the run"
        ) from error


def _named(state: TrackerState) -> list[tuple[str, Any]]:
    return [(jax.tree_util.keystr(path), leaf) for path, leaf in jax.tree_util.tree_flatten_with_path(state)[0]]


def _require_same_map(found: ElementTrust, like: ElementTrust) -> None:
    if found.num_in_map != like.num_in_map:
        raise ValueError(f"a map of {found.num_in_map:.0f} elements, expected {like.num_in_map:.0f}")


def _checked(found: np.ndarray, like: Any, name: str) -> np.ndarray | np.generic:
    # A list that starts empty may have grown.
    is_list = np.shape(like) == (0,) and found.ndim == 1
    if found.shape != np.shape(like) and not is_list:
        raise ValueError(f"{name} has shape {found.shape}, expected {np.shape(like)}")
    return found[()] if found.ndim == 0 else found
