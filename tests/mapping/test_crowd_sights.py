"""Drives through the changing world of crowd_seed3 as exact sights: what one more drive tells cars, what is known.

`pytest -m slow tests/mapping/test_crowd_sights.py -s` prints the rows of notebooks/figures/crowd.md that say *sights*.
"""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial import cKDTree

from semloc_jax.evaluation import compare_maps, read_trajectory
from semloc_jax.mapping.crowd.kept_cells import KeptCells
from semloc_jax.mapping.crowd.ledger import Ledger
from semloc_jax.mapping.crowd.whole import merge_whole
from semloc_jax.maps import read_map
from semloc_jax.maps.io.packed_drive import packed_bytes
from semloc_jax.maps.versions.difference import difference
from semloc_jax.maps.versions.sdiff import sdiff_bytes
from semloc_jax.maps.versions.state import MapState
from semloc_jax.reports.crowd_curve import judged_changes
from tests.mapping.crowd_sights import SightNoise, sights_of_world

DRIVES = [*(f"e0d{k}" for k in range(8)), *(f"e1d{k}" for k in (8, 9, 10)), *(f"e2d{k}" for k in (11, 12, 13))]


@pytest.fixture
def worlds(data_dir):
    """The folder of the drives and their exact worlds."""
    folder = data_dir / "crowd_seed3"
    if not folder.is_dir():
        pytest.skip(f"no crowd_seed3 in {data_dir}")
    return folder


def crowd(folder, seed=1, epochs=True):
    """The packed drives in the order of time; without epochs all go through the first world."""
    found = []
    for k, name in enumerate(DRIVES):
        world = read_map(folder / (name if epochs else DRIVES[0]) / "map.geojson")
        Ts_map_base = read_trajectory(folder / name / "poses_body.tum").T_map_base
        found.append(sights_of_world(world, Ts_map_base, name, [seed, k]))
    return found


def versions(drives, nums, path):
    """The map of the first so many drives each, and what the last merge found."""
    kept, states, found = KeptCells(path), [], None
    for num in nums:
        ledger = Ledger(None, {}).joined([packed_bytes(drive) for drive in drives[:num]])
        found = merge_whole(ledger, kept=kept)
        states.append(MapState(ledger.written(found.beliefs), num, num, found.datum))
    return states, found


def told(before, after):
    """The step from one version to the next, and its share of the later one as a file of the same kind."""
    step, nothing = difference(before, after), MapState(after.map.with_elements([]), 1, 0)
    size, whole = len(sdiff_bytes(step, before)), len(sdiff_bytes(difference(nothing, after), nothing))
    print(f"\n{before.num_drives} to {after.num_drives}: {step.counts}; {size} of {whole} bytes, {size / whole:.1%}")
    return step, size / whole


def test_sights_lie_as_far_off_as_is_said(worlds):
    """One drive without an error of its way: a thing is off by its own error and nothing else."""
    name = DRIVES[0]
    world, Ts = read_map(worlds / name / "map.geojson"), read_trajectory(worlds / name / "poses_body.tum").T_map_base
    noise = SightNoise(gnss_m=0.0, turn_rad=0.0, scale=0.0, bend_rad=0.0, detected=1.0, parted=0.0)
    drive = sights_of_world(world, Ts, name, [1, 0], noise)
    x, y, _, heading = drive.place
    c, si = np.cos(heading), np.sin(heading)
    dashes = [e.points[:, :2].mean(axis=0) for e in drive.beliefs.map.elements if e.style == "dashed"]
    true = cKDTree([e.points[:, :2].mean(axis=0) for e in world.elements if e.style == "dashed"])
    off_m = true.query(np.array(dashes) @ np.array([[c, si], [-si, c]]) + [x, y])[0]
    assert len(dashes) > 30 and np.sqrt(np.mean(off_m**2)) == pytest.approx(np.hypot(0.03, 0.09), rel=0.3)


@pytest.mark.slow
def test_changes_are_known_and_one_more_drive_tells_them_and_little_else(worlds, tmp_path):
    drives = crowd(worlds)
    states, found = versions(drives, (11, 12, 13, 14), tmp_path / "map.gpkg")
    steps = [told(*pair) for pair in pairwise(states)]
    # The first drive of an epoch, and two more that make it sure; what has not changed is hardly told at all.
    assert [share < most for (_, share), most in zip(steps, (0.07, 0.08, 0.06), strict=True)] == [True] * 3
    assert all(len(step.modified) < 12 for step, _ in steps)
    reference = read_map(worlds / DRIVES[-1] / "map.geojson").elements
    print(compare_maps(states[-1].map.elements, reference, "se2").to_text())
    gone = [change.element for change in found.changes if change.change == "removed"]
    figures, length_m = judged_changes(states[-1].map.elements, gone, drives, None, worlds)
    print(figures.to_text(length_m))
    gone_known, came_known = (looked[looked[:, 0] >= 5, 1].mean() for looked in (figures.gone, figures.came))
    assert gone_known >= 0.9 and came_known >= 0.9  # as asked: 20 of 20 and 18 of 19
    assert figures.deleted <= 0.01 * figures.num_there and figures.num_invented - figures.num_old <= 1


@pytest.mark.slow
def test_where_nothing_changes_hardly_anything_is_told(worlds, tmp_path):
    states, _ = versions(crowd(worlds, 2, epochs=False), (12, 13, 14), tmp_path / "map.gpkg")
    for pair in pairwise(states):
        step, share = told(*pair)
        assert share < 0.07 and len(step.modified) < 12
