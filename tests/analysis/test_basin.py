"""Basins: starts fill their window on the road, the closed form of best-of-many equals counting, and the true pose of a
simulated drive is found from metres away."""

from itertools import combinations

import numpy as np
import pytest

from semloc_jax.analysis.basin import Basin, BasinConfig, BasinWindow, basin_table, basins_of, draw_starts
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import pose_errors
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.maps import read_map
from semloc_jax.simulation import SimulationConfig, simulate

NEAR, FAR = BasinWindow(1.0, 1.0, 2.0), BasinWindow(5.0, 3.0, 10.0)


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive")
    return simulate("road", 4, folder, SimulationConfig(2, 1.0, width_px=640, height_px=400, has_images=False))


@pytest.fixture(scope="module")
def basins(drive):
    source = mask_source("sem", drive, offset_px=(0.0, 0.0))
    config = BasinConfig(num_starts=16)
    return basins_of(drive, read_map(drive.map_path), source, (NEAR, FAR), slice(None), config)


def _made_up(success, score) -> Basin:
    nothing = np.zeros((*success.shape, 3))
    return Basin(NEAR, nothing, nothing, score, success)


def test_starts_fill_the_window_and_stand_on_the_road(drive):
    semantic_map, T_true = read_map(drive.map_path), drive.truth.T_map_base[0]
    starts = draw_starts(T_true, FAR, semantic_map, 400, 0)
    errors = pose_errors(starts, np.broadcast_to(T_true, starts.shape))
    for key, half_width in (("longitudinal_m", 5.0), ("lateral_m", 3.0), ("heading_deg", 10.0)):
        size = np.abs(errors[key])
        # Pitch and roll of the road move the projections by parts of a thousand.
        assert size.max() < 1.01 * half_width
        assert size.mean() == pytest.approx(half_width / 2, rel=0.1)
    assert np.abs(errors["height_m"]).max() < 0.5
    assert np.array_equal(starts, draw_starts(T_true, FAR, semantic_map, 400, 0))


def test_best_of_many_is_the_mean_over_all_choices():
    rng = np.random.default_rng(1)
    success, score = rng.random((3, 7)) < 0.4, rng.random((3, 7))
    made_up = _made_up(success, score)
    for count in range(1, 8):
        picks = [
            success[frame, min(choice, key=lambda start: score[frame, start])]
            for frame in range(3)
            for choice in combinations(range(7), count)
        ]
        assert made_up.best_of(count) == pytest.approx(np.mean(picks))
    assert made_up.best_of(1) == pytest.approx(made_up.single)
    with pytest.raises(SemlocError, match=r"best of 8 starts: expected 1 \.\.\. 7"):
        made_up.best_of(8)


def test_the_true_pose_is_found_from_metres_away(basins):
    near, far = basins
    assert near.single >= 0.95
    assert far.single >= 0.5
    assert near.best_of(16) == far.best_of(16) == 1.0
    # What counts as found is far more exact than the limit of 0.2 m and 0.2 deg.
    assert np.median(np.hypot(*near.end_error[near.success][:, :2].T)) < 0.03


def test_the_score_tells_found_from_lost_without_the_truth(basins):
    _, far = basins
    for score, success in zip(far.score, far.success, strict=True):
        assert success[np.argmin(score)]
        lost = score[~success]
        assert not len(lost) or score[success].max() < np.median(lost)


def test_table(basins):
    lines = basin_table(basins, counts=(4,)).splitlines()
    assert lines[0] == "| starts drawn from | one start | best of 4 |"
    assert lines[2].startswith("| ±1 m, ±2° | ")
    assert lines[3].startswith("| ±3 m lateral, ±5 m longitudinal, ±10° | ")


def test_no_frames_are_refused(drive):
    with pytest.raises(SemlocError, match="no frames or no windows"):
        basins_of(drive, read_map(drive.map_path), "sem", frames=slice(0, 0))
