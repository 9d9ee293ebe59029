"""A term beside the masks holds what they leave open, and the pose can be differentiated by what was measured."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import semloc_jax as sj
from tests.contracts.test_pose_terms import range_residual, ranges

pytestmark = pytest.mark.usefixtures("single_precision")


CLASSES = {10: "lane_marking"}
BEACON_MAP = np.array([[32.0, 5.0, 3.0]])


@pytest.fixture(scope="module")
def two_lines():
    """Two lines that leave the way along the road open: what `align` is given, and a range of 5 cm to a beacon."""
    lines = [("lane_marking", [[0, 2, 0], [80, 2, 0]]), ("lane_marking", [[0, -2, 0], [80, -2, 0]])]
    street = sj.map_from_arrays(lines)
    camera = sj.camera_from_K([[400, 0, 319.5], [0, 400, 199.5], [0, 0, 1]], (640, 400))
    rig = sj.Rig([camera], [sj.mounted((1.6, 0.0, 1.4), down_deg=4.0)], ["front"])
    T_true = sj.planar_pose(20.0, 0.1, 0.01)
    given = sj.render_masks(street, rig, T_true)[0], rig, street, sj.planar_pose(20.8, -0.2)
    return given, ranges(T_true, BEACON_MAP)


def assert_held(estimate):
    assert abs(estimate.T_map_base[0, 3] - 20.0) < 0.1
    assert 0.03 < np.sqrt(estimate.covariance[0, 0]) < 0.1


@pytest.mark.slow
def test_align_is_held_along_the_road_by_a_beacon(two_lines):
    given, term = two_lines
    assert_held(sj.align(*given, classes=CLASSES, terms=(term,)))


@pytest.mark.slow
def test_the_place_along_the_road_has_the_derivative_of_the_range(two_lines):
    given, term = two_lines

    def along_m(range_m):
        own = sj.pose_term(range_residual, (BEACON_MAP, range_m), np.array([20.0]))
        estimate = sj.align(*given, classes=CLASSES, terms=(own,), differentiable=True)
        return estimate.T_map_base[0, 3], estimate

    slope, exact = jax.grad(along_m, has_aux=True)(jnp.asarray(term.data[1], jnp.float32))
    assert_held(exact)
    assert float(slope[0]) == pytest.approx(-13.4 / 12.0, rel=0.1)  # a longer range is a place further back
