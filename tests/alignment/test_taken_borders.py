"""A half of the map that ends on the paint of a neighbour says nothing of where the map lies."""

import jax
import jax.numpy as jnp
import numpy as np

from semloc_jax.alignment.agreement import scattered
from semloc_jax.alignment.candidates import planar
from semloc_jax.alignment.seen_samples import SeenSamples
from semloc_jax.alignment.taken_borders import without_taken
from semloc_jax.structs import MapSamples

NUM, FAR_PX = 40, 60.0


def two_lines(gap_m: float) -> MapSamples:
    """Two lines along x, `gap_m` apart."""
    x = np.linspace(0.0, 20.0, NUM)
    p_map = np.stack([np.tile(x, 2), np.repeat([0.0, gap_m], NUM), np.zeros(2 * NUM)], axis=1)
    zero, none = np.zeros(2 * NUM), np.zeros(2 * NUM, int)
    tangent = np.tile([1.0, 0.0, 0.0], (2 * NUM, 1))
    element = np.repeat([0, 1], NUM)
    columns = p_map, tangent, zero, zero + 0.5, none, none, element, p_map, np.zeros_like(p_map), zero == 0.0
    return jax.tree.map(np.asarray, MapSamples(*map(jnp.asarray, columns)))


def seen_by_the_first(num_poses: int) -> SeenSamples:
    """All samples of the first line, as seen from every pose, on a border."""
    pose, sample = np.repeat(np.arange(num_poses), NUM), np.tile(np.arange(NUM), num_poses)
    zero = np.zeros(len(pose))
    return SeenSamples(num_poses, 1, pose, zero.astype(int), sample, zero, zero + 5.0, zero.astype(int), zero + 10.0)


def test_only_samples_on_the_paint_of_the_other_half_are_taken():
    samples, channel = two_lines(0.4), np.zeros(2 * NUM, int)
    parts = np.tile(np.arange(2 * NUM) < NUM, (3, 1))
    # The vehicle stands 0.4 m to the right: the first line appears where the second one is. Then 0.2 m, then none.
    Ts = planar(np.zeros(3), np.array([-0.4, -0.2, 0.0]), 0.0)
    seen = without_taken(seen_by_the_first(3), np.eye(4), Ts, parts, samples, channel, FAR_PX)
    taken = (seen.signed_px == FAR_PX).reshape(3, NUM)
    assert taken[0].all() and not taken[1:].any()


def test_what_is_of_another_class_is_not_taken():
    samples, channel = two_lines(0.4), np.repeat([0, 1], NUM)
    parts = (np.arange(2 * NUM) < NUM)[None]
    T = planar(np.zeros(1), np.array([-0.4]), 0.0)
    seen = without_taken(seen_by_the_first(1), np.eye(4), T, parts, samples, channel, FAR_PX)
    assert not (seen.signed_px == FAR_PX).any()


def test_halves_within_what_residuals_promise_are_not_looked_at():
    Ts = planar(np.array([0.0, 0.3, 0.0]), np.array([0.05, 0.0, 0.11]), 0.0)
    assert scattered(np.eye(4), Ts, np.array([0.2, 0.05, 0.01]) ** 2).tolist() == [False, False, True]
