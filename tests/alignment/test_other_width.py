"""A road that is wider than in the map: both sides move apart, what lies in the way of the vehicle stays."""

import jax
import jax.numpy as jnp
import numpy as np

from semloc_jax.alignment.other_width import with_other_width
from semloc_jax.structs import MapSamples

T_NORTH = np.array([[0.0, -1.0, 0.0, 10.0], [1.0, 0.0, 0.0, 20.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""A vehicle that looks along y: its left is -x."""


def samples(p_map: np.ndarray) -> MapSamples:
    num = len(p_map)
    p, zero, index = jnp.asarray(p_map), jnp.zeros(num), jnp.zeros(num, int)
    turned = jnp.tile(jnp.array([0.0, 1.0, 0.0]), (num, 1))
    return MapSamples(p, turned, zero, zero, index, index, index, p + 1.0, jnp.zeros((num, 3)), jnp.ones(num, bool))


def test_both_sides_move_apart_by_half_and_the_middle_stays():
    """Left, right, half a metre to the left (half as far), ahead, and a post at a height."""
    p = np.array([[7.0, 30.0, 0.0], [13.0, 25.0, 0.0], [9.5, 22.0, 0.0], [10.0, 28.0, 0.0], [4.0, 30.0, 3.0]])
    given = samples(p)
    wider = with_other_width(given, jnp.asarray(T_NORTH), jnp.asarray(0.4))
    shift = np.zeros((5, 3))
    shift[:, 0] = [-0.2, 0.2, -0.1, 0.0, -0.2]
    np.testing.assert_allclose(wider.p_map - p, shift, atol=1e-6)
    np.testing.assert_allclose(wider.center_map - given.center_map, shift, atol=1e-6)
    np.testing.assert_array_equal(wider.tangent_map, given.tangent_map)
    np.testing.assert_array_equal(with_other_width(given, jnp.asarray(T_NORTH), jnp.asarray(0.0)).p_map, given.p_map)
    slope = jax.jacfwd(lambda w: with_other_width(given, jnp.asarray(T_NORTH), w).p_map)(0.4)
    np.testing.assert_allclose(slope, shift / 0.4, atol=1e-6)
