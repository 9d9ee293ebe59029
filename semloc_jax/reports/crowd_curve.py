"""How the error of a crowd map falls with the number of its drives (room: reports; host).

In: packed drives, a base, a reference map. Out: curve.csv, error.png.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from tqdm import tqdm

from semloc_jax.evaluation import MapComparison, compare_maps
from semloc_jax.mapping.crowd.merged import merged
from semloc_jax.maps import BeliefMap, MapElement, SemanticMap
from semloc_jax.maps.io.packed_drive import PackedDrive
from semloc_jax.reports.tables import write_csv
from semloc_jax.viz import error_against_drives, save

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
