"""Along the road through a place that was found every other place that fits is found, too."""

import jax
import numpy as np
import pytest

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.alignment.walk import LONGEST_WALK_M, best_along
from tests.alignment.test_along_road import RIG, TABLE, X_TRUE, across, drawn, street


def test_the_best_places_are_better_than_both_neighbours_and_no_end_is_one():
    log_masks = np.array([9.0, 3.0, 5.0, 4.0, 4.0, 6.0, -np.inf, 2.0, 1.0, 7.0])
    assert best_along(log_masks, num=3).tolist() == [5, 2, 7]
    assert best_along(log_masks, num=1).tolist() == [5]


@pytest.mark.parametrize(("log_masks", "best"), [(np.arange(5.0), 4), (np.full(5, -np.inf), 0), (np.zeros(5), 0)])
def test_a_slope_has_its_best_end_and_nothing_has_one_place(log_masks, best):
    assert best_along(log_masks, num=3).tolist() == [best]


@pytest.mark.slow
@pytest.mark.parametrize("off_m", [-7.0, 9.0])
def test_a_place_metres_away_is_walked_to(off_m):
    """A stop line ahead is seen once: from beside it nothing tells where it is but the walk along both lines."""
    semantic_map = street(across(12.0, 0.4))
    localizer = FrameLocalizer(semantic_map, TABLE)
    mask = drawn(semantic_map)
    with jax.enable_x64(False):
        found = {}
        for sigma_m in (1.0, 5.0):
            prior = PosePrior(X_TRUE + off_m, 0.0, 0.0, sigma_m, np.radians(2.0))
            T_map_prior = prior.on_road(semantic_map)
            inputs, local_map = localizer.prepare([mask], RIG, T_map_prior)
            finder = localizer.mode_finder([mask], inputs, prior, T_map_prior, local_map.frame)
            walked = finder.walked(finder.T_prior)
            found[sigma_m] = local_map.frame.to_map(walked)[:, 0, 3] if len(walked) else np.zeros(0)
    assert len(found[1.0]) == 0, "four times the sigma of this prior is what the search looks at anyway"
    assert np.abs(found[5.0] - X_TRUE).min() < 0.2
    assert np.abs(found[5.0] - X_TRUE - off_m).max() <= LONGEST_WALK_M
