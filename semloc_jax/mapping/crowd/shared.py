"""How far the map of many drives is off as a whole around each place (room: mapping; host).

In: the joint solve of drives and world. Out: WaySigmas. What lies around a place hangs on the drives that passed there:
it is as sure as they are laid out together, however many elements there are. Beside that the scale is known by wheels
and satellite fixes alone, and how well these know it, the drives tell by how much they differ.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from semloc_jax.mapping.crowd.correction import SCALE, Correction
from semloc_jax.mapping.crowd.joint import JointSolve
from semloc_jax.mapping.way_sigmas import WaySigmas, planar_sigmas

_CELL_M = 25.0
"""Places of which it is told are so far apart: what drives are off walks from node to node of as many metres."""
_SCALE, _WORTH = 0.005, 2.0
"""What the scale of one drive is off by wheels and fixes, and how many drives this belief is worth; ours."""


def shared_sigmas(solve: JointSolve) -> WaySigmas:
    """The sigmas around places of the ways of all drives that count; which frame the map lies in is no error."""
    own = [k for k, drive in enumerate(solve.drives) if not drive.sights.is_base and solve.weights[k] >= 1.0]
    taken: set[tuple[int, ...]] = set()
    places, rows = [], []
    for k in own:
        drive = solve.drives[k]
        cells = [tuple(cell) for cell in np.floor(drive.sights.way / _CELL_M).astype(int).tolist()]
        new = [row for row, cell in enumerate(cells) if cell not in taken and cells.index(cell) == row]
        taken.update(cells)
        if not new:
            continue
        xy = drive.sights.way[new]
        by_unknowns = np.concatenate([drive.rows(xy), drive.turn_rows(xy)[:, None]], axis=1)
        places.append(drive.moved(xy))
        rows.append((k, by_unknowns.reshape(-1, drive.size)))
    xy = np.concatenate([np.zeros((0, 2)), *places])
    if len(xy) < 2:
        return WaySigmas(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    larger = np.column_stack([xy - xy.mean(axis=0), np.zeros(len(xy))]).ravel()
    found = planar_sigmas(xy, solve.covariance(rows) + _scale_variance(solve) * np.outer(larger, larger))
    place_m, turn_rad = _of_base(solve.drives[0], xy)
    return WaySigmas(xy, np.hypot(found.place_m, place_m), np.hypot(found.turn_rad, turn_rad))


def _scale_variance(solve: JointSolve) -> float:
    """Variance of the scale of all: that of one drive by how much they differ, over their number.

    Nothing under a base map: its scale is held, or what it is off is stated in its elements.
    """
    own = [drive for drive, weight in zip(solve.drives, solve.weights, strict=True) if weight >= 1.0]
    if any(drive.sights.is_base for drive in own):
        return 0.0
    off = np.array([drive.value[SCALE] - (drive.sights.scale - 1.0) for drive in own])
    return (_WORTH * _SCALE**2 + float(off @ off)) / (_WORTH + len(own) - 1.0) / len(own)


def _of_base(first: Correction, xy: Float[np.ndarray, "n 2"]) -> tuple[np.ndarray, np.ndarray]:
    """What a base map says that it may be off around places, if it is one: drives lie in it as it lies."""
    things = first.sights.things
    if not first.sights.is_base or not len(things):
        return np.zeros(len(xy)), np.zeros(len(xy))
    near = [things.beliefs[k] for k in cKDTree(things.centre).query(xy)[1].tolist()]
    return np.array([b.sigma_place_m for b in near]), np.array([b.sigma_turn_rad for b in near])
