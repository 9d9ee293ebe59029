"""Solves of many starts: each through cameras of its own, as it would be alone; which of them are solved to the end."""

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from semloc_jax.alignment.candidates import apart, planar
from semloc_jax.alignment.complete_modes import beside_and_apart
from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.cameras.other_lenses import longer
from tests.alignment.test_along_road import RIG, SIGMA_M, TABLE, X_TRUE, across, drawn, street


@pytest.mark.slow
def test_starts_through_several_rigs_at_once_end_as_through_each_alone():
    """A stop line ahead tells the way along the road: through a lens that is longer it seems farther away."""
    semantic_map = street(across(12.0, 0.4))
    localizer = FrameLocalizer(semantic_map, TABLE)
    mask, prior = drawn(semantic_map), PosePrior(X_TRUE, 0.0, 0.0, SIGMA_M, np.radians(2.0))
    with jax.enable_x64(False):
        T_map_prior = prior.on_road(semantic_map)
        inputs, local_map = localizer.prepare([mask], RIG, T_map_prior)
        steps = localizer.mode_finder([mask], inputs, prior, T_map_prior, local_map.frame)
        rigs = [longer(RIG, share) for share in (0.0, 0.03, -0.03)]
        starts = steps.T_prior @ planar(np.array([0.0, 0.1]), np.zeros(2), 0.0)
        lens = np.repeat(np.arange(3), 2)
        together = steps.solved_with_few(np.tile(starts, (3, 1, 1)), 1e3, rigs=rigs, lens=lens)
        for number, rig in enumerate(rigs):
            alone = steps.solved_with_few(starts, 1e3, rigs=[rig])
            np.testing.assert_array_equal(together.estimates.T_local_base[lens == number], alone.estimates.T_local_base)
            np.testing.assert_array_equal(together.score[lens == number], alone.score)
    stated_m, longer_m, shorter_m = together.estimates.T_local_base[::2, 0, 3] - steps.T_prior[0, 3]
    assert abs(stated_m) < 0.08  # few samples
    assert longer_m < stated_m - 0.1 and shorter_m > stated_m + 0.1


def test_another_optimum_of_the_best_place_is_solved_to_the_end():
    """A real frame: four poses beside one that is a stud off weighed more than the right one, 0.6 m and 1.3 deg away,
    before they were solved to the end."""
    along_m, turn_deg = np.array([0.0, -0.75, -0.18, -0.9, -0.55, 0.61]), np.array([1.7, 1.4, 1.5, 1.7, 1.2, 0.4])
    Ts = np.tile(np.eye(4), (6, 1, 1))
    Ts[:, :3, :3] = Rotation.from_euler("z", turn_deg[:, None], degrees=True).as_matrix()
    Ts[:, 0, 3] = along_m
    log_weight = np.array([0.0, -0.5, -0.7, -0.9, -1.1, -1.7])
    assert 5 not in apart(Ts, log_weight, 4, 0.3)
    assert {0, 1, 5} <= set(beside_and_apart(Ts, log_weight, 4).tolist())
