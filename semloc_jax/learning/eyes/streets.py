"""Random streets with exact masks as something to learn from (room: learning; host).

In: seeds. Out: labelled images, kept on disk, and a manifest of the scenes: which teach, which are held out.
"""

import json
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from semloc_jax.errors import SemlocError
from semloc_jax.learning.eyes.batches import CropConfig, LabelledImage
from semloc_jax.learning.eyes.labels import EXACT_SIGMA_PX, cell_distances
from semloc_jax.learning.training import TrainingConfig
from semloc_jax.perception.class_table import ClassTable, load_class_table
from semloc_jax.perception.networks.eyes import num_told
from semloc_jax.simulation.streets.views import FINER, StreetView, street_views
from semloc_jax.storage import npz_arrays, write_npz, write_text

MANIFEST = "manifest.json"
TEACHES, HELD_OUT = "teaches", "held out"
_MOST_BYTES = 2**28


@dataclass(frozen=True)
class StreetsConfig:
    """How many random scenes are drawn. All values are ours."""

    num_streets: int = 28
    num_garages: int = 20
    """Seen by fisheyes."""
    views: int = 7
    """Of each scene, each by another camera."""
    looks: int = 3
    """Of each view: other light, weather, surfaces, lens."""
    size_px: tuple[int, int] = (320, 224)
    """Width and height of a picture, in pixels of the network's image."""
    held_out: int = 4
    """So many of the streets, and a quarter as many of the garages, judge."""
    training: TrainingConfig = field(default_factory=lambda: TrainingConfig(num_steps=4500, rate=3e-3))
    crops: CropConfig = field(default_factory=lambda: CropConfig(crop_px=(224, 192)))

    def __post_init__(self) -> None:
        least = min(self.num_streets, self.views, self.looks, self.held_out)
        if least < 1 or self.num_garages < 0 or self.held_out >= self.num_streets:
            raise SemlocError(
                f"streets: {self}; expected counts of at least 1 and fewer streets held out than there are"
            )
        if any(side < 32 or side % 32 for side in self.size_px):
            raise SemlocError(f"streets: pictures of {self.size_px} px; expected multiples of 32")


class SceneEntry(NamedTuple):
    """One scene of the manifest."""

    number: int
    is_garage: bool
    part: str
    """Whether it teaches or is held out."""


def scenes(config: StreetsConfig) -> list[SceneEntry]:
    """All scenes; the last ones of each kind are held out."""
    held_garages = -(-config.held_out // 4) if config.num_garages > 1 else 0
    counts = (config.num_streets, config.held_out, False), (config.num_garages, held_garages, True)
    parts = [
        (is_garage, HELD_OUT if k >= num - held else TEACHES) for num, held, is_garage in counts for k in range(num)
    ]
    return [SceneEntry(number, *part) for number, part in enumerate(parts)]


def drawn_scenes(config: StreetsConfig, seed: int, folder: Path) -> Iterator[tuple[SceneEntry, list[StreetView]]]:
    """Every scene with its views; what lies in the folder already is not drawn again. Scene k follows from (seed, k).

    Args:
        config: how many.
        seed: of all of them.
        folder: keeps one file a scene, and the manifest.
    """
    folder.mkdir(parents=True, exist_ok=True)
    listed, stated = scenes(config), {"seed": seed, "views": config.views, "looks": config.looks}
    stated |= {"size_px": list(config.size_px), "finer": FINER}
    _check(folder / MANIFEST, stated)
    sums = {}
    for entry in listed:
        path = folder / f"scene_{seed}_{entry.number:04d}.npz"
        if not path.is_file():
            rng = np.random.default_rng((seed, entry.number))
            views = street_views(rng, config.views, config.size_px, config.looks, entry.is_garage)
            pictures, ids = (np.stack(part) for part in zip(*views, strict=True))
            write_npz(path, {"pictures": pictures, "ids": ids})
        stored = npz_arrays(path, f"scene {path}", _MOST_BYTES)
        sums[entry.number] = zlib.crc32(stored["pictures"].tobytes())
        yield entry, [StreetView(tuple(p), ids) for p, ids in zip(stored["pictures"], stored["ids"], strict=True)]
    rows = [entry._asdict() | {"crc32": sums[entry.number]} for entry in listed]
    write_text(folder / MANIFEST, json.dumps(stated | {"scenes": rows}, indent=1) + "\n")


def _check(path: Path, stated: dict) -> None:
    """Refuse a folder whose scenes were drawn otherwise.

    Raises:
        SemlocError: they were.
    """
    if path.is_file():
        found = json.loads(path.read_text(encoding="utf-8"))
        if {key: found.get(key) for key in stated} != stated:
            raise SemlocError(f"{path}: its scenes were drawn with other settings than {stated}; give another folder")


def labelled(view: StreetView, table: ClassTable) -> list[LabelledImage]:
    """What a network with this table is to say of each picture of a view."""
    told = _told_of_ids(table)[view.class_id]
    planes = [cell_distances(np.where(told == k, np.uint8(255), np.uint8(0))) for k in range(num_told(table))]
    signed = np.stack(planes)
    # Exact and known everywhere: one number stands for all cells.
    sigma, kept = (np.broadcast_to(value, signed.shape) for value in (np.float16(EXACT_SIGMA_PX), False))
    labels = signed.astype(np.float16), sigma, np.broadcast_to(True, signed.shape[1:]), kept
    return [LabelledImage(np.ascontiguousarray(one[..., ::-1]), *labels) for one in view.pictures]


def _told_of_ids(table: ClassTable) -> Int[np.ndarray, "256"]:
    """Which of the classes that a network tells each class id of a scene is, -1 for none."""
    drive, told = load_class_table("drive"), np.full(256, -1)
    for k, channel in enumerate(table.channels):
        for own in drive.channels:
            if set(own.classes) & set(channel.classes):
                told[list(own.mask_ids)] = k
    if table.dynamic_ids:
        told[[*drive.dynamic_ids, *drive.ego_ids]] = len(table.channels)
    return told
