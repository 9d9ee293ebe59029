"""Inertial samples read at image times: the trapezoid against a motion that is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.datasets import Imu
from semloc_jax.errors import SemlocError
from semloc_jax.fusion.inertial_samples import capacity_for, rotation_between, steps_between
from semloc_jax.residuals.preintegration import preintegrate
from tests.fusion.inertial_world import World

WORLD = World(seed=3, noise=0.0)
IMU, _ = WORLD.imu(3.0, np.random.default_rng(0))


RUN = jax.jit(preintegrate)


def velocity_after(gyro, accel, step_s, from_s):
    moved = RUN(jnp.asarray(gyro), jnp.asarray(accel), jnp.asarray(step_s), jnp.zeros(6))
    dt, R = float(jnp.sum(jnp.asarray(step_s))), WORLD.pose(from_s)[:3, :3]
    return WORLD.velocity(from_s) + [0.0, 0.0, -9.81 * dt] + R @ np.asarray(moved.velocity)


def test_a_tenth_of_a_second_without_noise_is_a_third_of_a_millimetre_a_second():
    """Image times lie between samples, the vehicle turns, brakes and pitches; held samples are worse ten times."""
    errors, held = [], []
    for from_s in np.arange(0.103, 2.5, 0.2):
        steps = steps_between(IMU, from_s, from_s + 0.1, 16)
        assert steps.step_s.sum() == pytest.approx(0.1) and (steps.step_s > 0).sum() == 11
        truth = WORLD.velocity(from_s + 0.1)
        errors.append(velocity_after(*steps, from_s) - truth)
        first = np.searchsorted(IMU.time_s, from_s)
        rows = slice(first, first + 16)
        held.append(
            velocity_after(IMU.gyro_radps[rows], IMU.accel_mps2[rows], np.repeat([0.01, 0.0], [10, 6]), from_s) - truth
        )
    assert np.abs(errors).max() < 3e-4
    assert np.sqrt(np.mean(np.square(held))) > 10 * np.sqrt(np.mean(np.square(errors)))


def test_the_rotation_is_that_of_the_motion():
    steps = steps_between(IMU, 0.5, 0.7, 24)
    expected = WORLD.pose(0.5)[:3, :3].T @ WORLD.pose(0.7)[:3, :3]
    np.testing.assert_allclose(rotation_between(steps, np.zeros(3)), expected, atol=5e-6)


def test_gaps_and_lengths():
    assert capacity_for(IMU, np.arange(0.0, 3.0, 0.1)) == 16
    gone = slice(100, 140)
    gap = Imu(*(np.delete(column, gone, axis=0) for column in (IMU.time_s, IMU.gyro_radps, IMU.accel_mps2)))
    with pytest.raises(SemlocError, match="no samples within 0.2 s"):
        steps_between(gap, 0.9, 1.0, 64)
    with pytest.raises(SemlocError, match="expected at most 8"):
        steps_between(IMU, 0.5, 0.7, 8)
    with pytest.raises(SemlocError, match="no samples within"):
        steps_between(IMU, 2.9, 9.0, 1024)
