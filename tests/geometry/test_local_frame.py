"""The frame near the vehicle: exact at UTM coordinates in float32, there and back, from one frame to another."""

import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid
from semloc_jax.geometry.local_frame import LocalFrame

UTM_M = np.array([448_251.0, 5_411_932.0, 117.0])
"""A place in zone 32: float32 has steps of 0.5 m at this northing."""


def poses(num=50, seed=0):
    """Poses within 80 m of a place at UTM coordinates."""
    rng = np.random.default_rng(seed)
    Ts = rigid.exp(rng.uniform(-1, 1, (num, 6)) * [80, 80, 5, 1, 1, 3])
    Ts[:, :3, 3] += UTM_M
    return Ts


def test_float32_keeps_a_hundredth_of_a_millimetre_at_utm_coordinates():
    Ts_map, frame = poses(), LocalFrame(UTM_M)
    Ts_local = frame.from_map(Ts_map)
    assert Ts_local.dtype == np.float32
    back = frame.to_map(Ts_local)
    assert back.dtype == np.float64
    np.testing.assert_allclose(back[:, :3, 3], Ts_map[:, :3, 3], rtol=0, atol=1e-5)
    # The same numbers without the frame are decimetres off.
    assert np.abs(Ts_map.astype(np.float32)[:, :3, 3] - Ts_map[:, :3, 3]).max() > 0.2


@pytest.mark.parametrize("dim", [2, 3])
def test_points_return_and_agree_with_poses(dim):
    Ts_map, frame = poses(), LocalFrame(UTM_M)
    p_map = Ts_map[:, :dim, 3]
    p_local = frame.from_map(p_map, np.float64)
    np.testing.assert_array_equal(p_local, frame.from_map(Ts_map, np.float64)[:, :dim, 3])
    np.testing.assert_allclose(frame.to_map(p_local), p_map, rtol=0, atol=1e-9)
    assert np.abs(p_local).max() < 100.0


def test_rotations_and_tangents_are_those_of_the_map():
    """Hence covariances of the vehicle's tangent and sigmas of priors need no conversion."""
    Ts_map, frame = poses(), LocalFrame(UTM_M)
    Ts_local = frame.from_map(Ts_map, np.float64)
    np.testing.assert_array_equal(Ts_local[:, :3, :3], Ts_map[:, :3, :3])
    steps_map = rigid.log(rigid.inverse(Ts_map[:-1]) @ Ts_map[1:])
    steps_local = rigid.log(rigid.inverse(Ts_local[:-1]) @ Ts_local[1:])
    np.testing.assert_allclose(steps_local, steps_map, rtol=0, atol=1e-8)


def test_composition_from_one_frame_to_another():
    """By way of the map, or by the place of one origin in the other frame."""
    first, second = LocalFrame(UTM_M), LocalFrame(UTM_M + [60.0, -45.0, 2.0])
    p_first = np.random.default_rng(1).uniform(-80, 80, (20, 3))
    by_map = second.from_map(first.to_map(p_first), np.float64)
    by_origin = p_first + second.from_map(first.origin_map, np.float64)
    np.testing.assert_allclose(by_map, by_origin, rtol=0, atol=1e-8)


def test_what_is_given_stays_as_it_is():
    Ts_map = poses()
    kept = Ts_map.copy()
    LocalFrame(UTM_M).from_map(Ts_map)
    np.testing.assert_array_equal(Ts_map, kept)
    with pytest.raises(ValueError, match="read-only"):
        LocalFrame(UTM_M).origin_map[0] = 0.0


def test_other_shapes_are_refused():
    with pytest.raises(SemlocError, match="three finite coordinates"):
        LocalFrame(np.array([0.0, np.nan, 0.0]))
    with pytest.raises(SemlocError, match=r"expected poses \[\* 4 4\] or points"):
        LocalFrame(UTM_M).to_map(np.zeros(6))
