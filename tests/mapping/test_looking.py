"""The road is looked at without gaps, however coarse the look."""

import numpy as np
import pytest

from semloc_jax.datasets import open_drive
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.mapping.looking import Gatherer, Looker, RoadLookConfig


@pytest.mark.parametrize("spacing_m", [0.03, 0.05])
def test_one_frame_looks_at_the_cells_in_front_of_it(simulated_road, spacing_m):
    """Five of six cells, as rows of places and of cells are turned against each other; no more than twice any."""
    drive = open_drive(simulated_road)
    masks, frame = mask_source("sem", drive), drive.frames[0]
    looker = Looker(drive, masks, RoadLookConfig(range_m=10.0, spacing_m=spacing_m))
    gatherer = Gatherer(masks.table, looker.config.spacing_m)
    T_map_base = drive.truth_at(frame)
    for look in looker.looks(frame, 0, T_map_base[None]):
        gatherer.add(look)
    ahead_m, left_m = np.meshgrid(np.arange(5.0, 7.0, 0.5 * spacing_m), np.arange(-1.0, 1.0, 0.5 * spacing_m))
    places = np.stack([ahead_m.ravel(), left_m.ravel(), np.zeros(ahead_m.size), np.ones(ahead_m.size)])
    cells = np.unique(np.floor((T_map_base @ places)[:2].T / spacing_m).astype(int), axis=0)
    low, high = cells.min(axis=0), cells.max(axis=0) + 1
    looks = gatherer.paint.plane(1, low, high - low)[tuple((cells - low).T[::-1])]
    assert (looks > 0).mean() > 5 / 6
    assert looks.max() <= 2
