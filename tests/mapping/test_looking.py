"""The road is looked at without gaps, however coarse the look."""

import numpy as np
import pytest

from semloc_jax import camera_from_K, mounted
from semloc_jax.datasets import open_drive
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.mapping.looking import Gatherer, Looker, RoadLookConfig
from semloc_jax.mapping.road_table import RoadTable


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


@pytest.mark.parametrize("step_m", [0.3, 1.8])
def test_a_place_ahead_is_looked_at_in_four_frames_at_any_speed(step_m):
    """400 x 120 px, 1.65 m above the road, which it shows from 6 m on: 4 px a metre end at 9.8 m."""
    camera = camera_from_K([[232.0, 0.0, 199.5], [0.0, 232.0, 56.0], [0.0, 0.0, 1.0]], (400, 120))
    table = RoadTable.of(camera, mounted((0.0, 0.0, 1.65)), 18.0, 0.05, step_m)
    ahead_m = table.xy_base[np.abs(table.xy_base[:, 1]) < 0.03, 0]
    assert np.ptp(ahead_m) >= max(4 * step_m, 3.5) - 0.5
    assert ahead_m.max() <= max(ahead_m.min() + 4 * step_m, 9.9) + 0.4
