"""What a run was made of, so that it is only resumed with the same (room: reports).

In: opened inputs, frames, settings. Out: inputs.json with a hash for each part; a sentence that names the part that
differs.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.drive_inputs import Inputs
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.maps import SemanticMap
from semloc_jax.maps.io import StoredMap
from semloc_jax.storage import json_document, reading, write_text

FILE = "inputs.json"
_MAY_CHANGE = ("frames", "overlays", "video", "min_localized_share", "min_tracking_share")


def fingerprint(inputs: Inputs, settings: object, options: Mapping[str, Any]) -> dict[str, str]:
    """A hash for each part of what a run depends on; which frames were chosen may change from run to run.

    Args:
        inputs: drive, map and masks; the masks of the first frame stand for those of all.
        settings: configuration; anything whose repr tells it apart.
        options: of the verb; those that only choose frames, draw or judge may change.
    """
    same = {name: value for name, value in options.items() if name not in _MAY_CHANGE}
    return {"map": _of_map(inputs.map), **fingerprint_without_map(inputs.drive, inputs.masks, settings, same)}


def fingerprint_without_map(
    drive: Drive, masks: MaskSource, settings: object, options: Mapping[str, Any]
) -> dict[str, str]:
    """A hash for each part of what a run depends on that needs no map; arguments as for `fingerprint`."""
    return {
        "drive": _of_drive(drive),
        "masks": _of_masks(masks, drive.frames[0]),
        "settings": _digest(settings),
        "options": _digest(sorted(options.items())),
    }


def file_digest(path: Path) -> str:
    """A hash of a file."""
    with reading(f"file {path}"), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:20]


def begun(folder: Path, parts: Mapping[str, str], is_resumed: bool) -> None:
    """Note what a new run begins with; check it where a run is resumed.

    Raises:
        SemlocError: the run that is resumed began with something else, or does not say.
    """
    (_require_same if is_resumed else _note)(folder, parts)


def _note(folder: Path, parts: Mapping[str, str]) -> None:
    write_text(folder / FILE, json.dumps(dict(parts), indent=1) + "\n")


def _require_same(folder: Path, parts: Mapping[str, str]) -> None:
    path = folder / FILE
    if not path.is_file():
        raise SemlocError(f"--resume {folder}: has no {FILE}; give the folder of an unfinished run of this version")
    made = json_document(path.read_bytes(), str(path))
    other = [name for name, digest in parts.items() if made.get(name) != digest]
    if other:
        raise SemlocError(
            f"--resume {folder}: began with other {', '.join(other)}; give the same as then, or start again with "
            "another --out"
        )


def _of_drive(drive: Drive) -> str:
    # The text of a rig names models and sizes, its leaves hold the numbers.
    rig = [repr(drive.rig), drive.rig.names, *(np.asarray(leaf) for leaf in jax.tree.leaves(drive.rig))]
    logs = []
    for log in (drive.gnss, drive.odometry, drive.imu):
        logs += [] if log is None else [value for value in vars(log).values() if isinstance(value, np.ndarray)]
    return _digest(*rig, *logs)


def _of_masks(masks: MaskSource, frame: Frame) -> str:
    """Name, cameras, table, and what the masks of one frame show."""
    shown = [masks.segment(frame, camera) for camera in masks.cameras]
    return _digest(masks.name, masks.cameras, masks.table, *(np.ascontiguousarray(mask) for mask in shown))


def _of_map(semantic_map: SemanticMap) -> str:
    origin = None if semantic_map.origin is None else tuple(semantic_map.origin)
    if isinstance(semantic_map, StoredMap):  # not all of it is read
        return _digest(origin, semantic_map.num_elements, semantic_map.extent)
    elements = semantic_map.elements
    told = [(e.id, int(e.label), e.style, e.width_m, e.radius_m, e.height_m) for e in elements]
    return _digest(origin, told, *(e.points for e in elements))


def _digest(*parts: object) -> str:
    found = hashlib.sha256()
    for part in parts:
        found.update(part.tobytes() if isinstance(part, np.ndarray) else repr(part).encode())
        found.update(b"\0")
    return found.hexdigest()[:20]
