"""A merged map judged by exact worlds, and how its error falls with the number of drives (room: reports; host).

In: packed drives, a base, a reference map or a folder with the drives. Out: ChangeFigures, curve.csv, error.png.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import shapely
from tqdm import tqdm

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import MapComparison, compare_maps
from semloc_jax.evaluation.changed_worlds import ChangeFigures, WorldThings, change_figures
from semloc_jax.evaluation.map_shapes import POSTS, thing_of
from semloc_jax.mapping.crowd.facing import passes_its_face
from semloc_jax.mapping.crowd.merged import merged, origin_of
from semloc_jax.mapping.crowd.sights import Sights, sights_of
from semloc_jax.maps import BeliefMap, MapElement, SemanticMap, read_map
from semloc_jax.maps.io.packed_drive import PackedDrive
from semloc_jax.reports.tables import write_csv
from semloc_jax.viz import error_against_drives, save

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


_MOST_SUBSETS = 4


class CurvePoint(NamedTuple):
    """Root mean square errors of the maps of so many drives [m]."""

    num_drives: int
    num_maps: int
    absolute_m: float
    """How far a map lies off as a whole."""
    across_m: float
    """Of dashes and lines, after one motion in the plane."""
    along_m: float
    """Of the ends of dashes, after the same."""


def write_curve(
    base: BeliefMap | None, drives: Sequence[PackedDrive], reference: SemanticMap, folder: Path
) -> list[CurvePoint]:
    """Merges 1, 2, 4 ... drives, up to four disjoint groups of each number, and writes what their maps are off."""
    nums = [n for n in (2**k for k in range(12)) if n < len(drives)] + [len(drives)]
    points = []
    for num in tqdm(nums, desc="curve"):
        groups = [drives[k : k + num] for k in range(0, len(drives) - num + 1, num)][:_MOST_SUBSETS]
        found = [_errors(merged(base, group).beliefs.map, reference.elements) for group in groups]
        rms = np.sqrt(np.nanmean(np.square(found), axis=0))
        points.append(CurvePoint(num, len(groups), *(float(v) for v in rms)))
    rows = [(p.num_drives, p.num_maps, *(round(v, 4) for v in p[2:])) for p in points]
    write_csv(folder / "curve.csv", CurvePoint._fields, rows)
    save(error_against_drives(points), folder / "error.png")
    return points


def _errors(made: SemanticMap, reference: Sequence[MapElement]) -> tuple[float, float, float]:
    """How far a map is off as a whole, across and along."""
    comparison = compare_maps(made.elements, reference, "se2")
    T = comparison.T_reference_made
    middle = np.array([e.points[:, :2].mean(axis=0) for e in made.elements]).mean(axis=0)
    absolute_m = float(np.linalg.norm(T[:2, :2] @ middle + T[:2, 3] - middle))
    return absolute_m, _rms(comparison, ("dash", "line"), "across_m"), _rms(comparison, ("dash",), "along_m")


def _rms(comparison: MapComparison, names: Sequence[str], which: str) -> float:
    parts = [getattr(comparison.classes[name], which) for name in names if name in comparison.classes]
    values = np.concatenate([np.zeros(0), *parts])
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
