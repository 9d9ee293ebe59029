"""A merged map judged by the exact worlds that its drives went through (room: reports; host).

In: the map, its packed drives, a folder with the drives that were packed. Out: ChangeFigures, and in words.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import shapely

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import compare_maps
from semloc_jax.evaluation.changed_worlds import ChangeFigures, WorldThings, change_figures
from semloc_jax.evaluation.map_shapes import POSTS, thing_of
from semloc_jax.mapping.crowd.facing import passes_its_face
from semloc_jax.mapping.crowd.merged import origin_of
from semloc_jax.mapping.crowd.sights import Sights, sights_of
from semloc_jax.maps import BeliefMap, MapElement, read_map
from semloc_jax.maps.io.packed_drive import PackedDrive

WORLD = "map.geojson"


def worlds_of(drives: Sequence[PackedDrive], folder: Path) -> list[tuple[MapElement, ...]]:
    """The world of each drive, FOLDER/NAME/map.geojson, as `semloc simulate` writes it.

    Raises:
        SemlocError: that of a drive is missing.
    """
    missing = [drive.name for drive in drives if not (folder / drive.name / WORLD).is_file()]
    if missing:
        raise SemlocError(
            f"--worlds {folder}: has no {missing[0]}/{WORLD}; expected the folder of the simulated drives, each under "
            "the name that it was packed with"
        )
    return [read_map(folder / drive.name / WORLD).elements for drive in drives]


def judged_changes(
    made: Sequence[MapElement],
    removed: Sequence[MapElement],
    drives: Sequence[PackedDrive],
    before: BeliefMap | None,
    folder: Path,
) -> tuple[ChangeFigures, float]:
    """How well a map knows what has changed, and the length of the longest of its drives [m].

    Args:
        made: elements of the map.
        removed: what it says has gone.
        drives: all that were merged, in the order of time.
        before: the map before any drive, which is what was there then; None where there was none.
        folder: see `worlds_of`.
    """
    worlds, origin = worlds_of(drives, folder), origin_of(before, drives)
    things = WorldThings.of(worlds if before is None else [before.map.elements, *worlds])
    columns = [_looked(things, sights_of(d, origin), world) for d, world in zip(drives, worlds, strict=True)]
    if before is not None:
        columns.insert(0, np.zeros(len(things.elements), dtype=bool))
    T_world_made = compare_maps(made, worlds[-1], "se2").T_reference_made
    figures = change_figures(made, removed, things, np.stack(columns, axis=1), T_world_made)
    return figures, max(drive.length_m for drive in drives)


def _looked(things: WorldThings, sights: Sights, world: Sequence[MapElement]) -> np.ndarray:
    """Which things lie where a drive has looked: it is laid onto its own world."""
    seen = [*sights.things.elements, *(element for element, _ in sights.lines)]
    T = compare_maps(seen, world, "se2").T_reference_made
    back, centre = T[:2, :2], np.array([thing_of(e).centre for e in things.elements])
    xy = (centre - T[:2, 3]) @ back
    upright = np.array([e.label in POSTS for e in things.elements])
    inside = np.where(
        upright,
        shapely.contains_xy(sights.upright_area, xy[:, 0], xy[:, 1]),
        shapely.contains_xy(sights.area, xy[:, 0], xy[:, 1]),
    )
    faces = [np.zeros(2) if getattr(e, "normal", None) is None else e.normal[:2] for e in things.elements]
    return inside & passes_its_face(sights.way, xy, np.array(faces) @ back)
