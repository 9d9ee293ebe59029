"""One rule for the same pose, and for the level that holds."""

import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.alignment.level_choice import finest_held, holds
from semloc_jax.alignment.same_pose import ONE_OPTIMUM, ONE_PLACE, ONE_TRACK, units_apart
from semloc_jax.geometry import rigid


def pose(x=0.0, y=0.0, heading_deg=0.0, pitch_deg=0.0):
    return rigid.exp(np.array([0.0, 0, 0, 0, 0, np.deg2rad(heading_deg)])) @ rigid.exp(
        np.array([0.0, 0, 0, 0, np.deg2rad(pitch_deg), 0])
    ) + np.array([[0, 0, 0, x], [0, 0, 0, y], [0, 0, 0, 0], [0, 0, 0, 0]])


@pytest.mark.parametrize(
    ("other", "units"),
    [
        (pose(x=0.5), 1.0),
        (pose(y=-0.5), 1.0),
        (pose(heading_deg=1.0), 1.0),
        (pose(x=0.3, y=0.4, heading_deg=1.0), np.sqrt(2.0)),
    ],
)
def test_half_a_metre_or_a_degree_is_one_unit(other, units):
    assert units_apart(pose(), other) == pytest.approx(units)
    assert units_apart(other, pose()) == pytest.approx(units)


def test_heading_wraps_around():
    assert units_apart(pose(heading_deg=179.5), pose(heading_deg=-179.5)) == pytest.approx(1.0)


def test_pitch_is_left_to_the_road():
    assert units_apart(pose(), pose(pitch_deg=3.0)) == pytest.approx(0.0, abs=1e-9)


def test_a_centimetre_counts_far_from_the_origin():
    far = 4.0e6
    assert units_apart(pose(x=far), pose(x=far + 0.01)) == pytest.approx(0.02, rel=1e-3)


def test_stacks_broadcast_and_jax_agrees():
    stack = np.stack([pose(x=0.1 * k, heading_deg=0.3 * k) for k in range(5)])
    host = units_apart(stack, pose())
    assert host.shape == (5,)
    assert np.asarray(units_apart(jnp.asarray(stack), jnp.asarray(pose()))) == pytest.approx(host, abs=1e-6)


def test_one_optimum_lies_within_one_track_within_one_place():
    assert ONE_OPTIMUM < ONE_TRACK < ONE_PLACE


@pytest.mark.parametrize(
    ("ratio", "level"), [([0.9, 0.8, 0.6], 2), ([0.9, 0.8, 0.4], 1), ([0.9, 0.4, 0.6], 2), ([0.1, 0.2, 0.3], 0)]
)
def test_the_finest_level_with_enough_inliers_holds(ratio, level):
    assert finest_held(np.array(ratio), 0.5) == level
    assert int(finest_held(jnp.array(ratio), 0.5)) == level
    assert holds(0.5, 0.5) and not holds(0.49, 0.5)
