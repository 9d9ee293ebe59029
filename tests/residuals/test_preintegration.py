"""Preintegrated inertial samples against gtsam, a continuous motion and finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.geometry import lie, rigid
from semloc_jax.residuals.preintegration import InertialState, imu_residual, preintegrate
from semloc_jax.structs import InertialNoise

GRAVITY = jnp.array([0.0, 0.0, -9.81])
NOISE = InertialNoise()
RUN = jax.jit(lambda gyro, accel, dt, bias: preintegrate(gyro, accel, dt, bias, NOISE))
BIAS = jnp.array([0.01, -0.02, 0.015, 0.1, -0.05, 0.2])


def samples(num=100, seed=0):
    rng = np.random.default_rng(seed)
    gyro = 0.3 * np.sin(np.linspace(0, 3, num))[:, None] * [0.2, -0.3, 1.0] + 0.05 * rng.normal(size=(num, 3))
    accel = np.array([0.5, 0.8, 9.8]) + 0.3 * rng.normal(size=(num, 3))
    return gyro, accel, np.full(num, 0.01)


def test_motion_covariance_and_bias_derivatives_are_those_of_gtsam():
    gtsam = pytest.importorskip("gtsam")
    gyro, accel, dt = samples()
    params = gtsam.PreintegrationParams.MakeSharedU(9.81)
    params.setGyroscopeCovariance(NOISE.gyro_density**2 * np.eye(3))
    params.setAccelerometerCovariance(NOISE.accel_density**2 * np.eye(3))
    params.setIntegrationCovariance(np.zeros((3, 3)))
    theirs = gtsam.PreintegratedImuMeasurements(
        params, gtsam.imuBias.ConstantBias(np.array(BIAS[3:]), np.array(BIAS[:3]))
    )
    for w, a, step in zip(gyro, accel, dt, strict=True):
        theirs.integrateMeasurement(a, w, step)
    mine = RUN(*map(jnp.asarray, (gyro, accel, dt)), BIAS)
    assert np.allclose(mine.rotation, theirs.deltaRij().matrix(), atol=1e-9)
    assert np.allclose(mine.position, theirs.deltaPij(), atol=1e-4)
    assert np.allclose(mine.velocity, theirs.deltaVij(), atol=1e-4)
    mine_sigma, their_sigma = np.sqrt(np.diag(mine.covariance)), np.sqrt(np.diag(theirs.preintMeasCov()))
    assert np.allclose(mine_sigma, their_sigma, rtol=0.02)
    # Another bias, to first order: both agree with each other and with integrating anew.
    other = BIAS + jnp.array([1e-3, 2e-3, -1e-3, 0.01, 0.02, -0.01])
    R, p, v = mine.corrected(other)
    anew = RUN(*map(jnp.asarray, (gyro, accel, dt)), other)
    assert np.allclose(R, anew.rotation, atol=5e-6)
    assert np.allclose(p, anew.position, atol=2e-5) and np.allclose(v, anew.velocity, atol=5e-5)


def test_bias_derivatives_are_those_of_finite_differences():
    inputs = tuple(map(jnp.asarray, samples()))
    mine, step = RUN(*inputs, BIAS), 1e-5
    for k in range(6):
        plus, minus = (RUN(*inputs, BIAS + sign * step * jnp.eye(6)[k]) for sign in (1.0, -1.0))
        turned = np.asarray(lie.so3_log(minus.rotation.T @ plus.rotation))
        change = np.concatenate([turned, plus.position - minus.position, plus.velocity - minus.velocity]) / (2 * step)
        assert np.allclose(mine.by_bias[:, k], change, atol=1e-6)


def test_covariance_is_the_scatter_of_noisy_samples():
    gyro, accel, dt = samples()
    rng = np.random.default_rng(1)
    many = jax.jit(jax.vmap(lambda g, a: preintegrate(g, a, jnp.asarray(dt), BIAS, NOISE)))
    found = many(
        jnp.asarray(gyro + NOISE.gyro_density / 0.1 * rng.normal(size=(3000, 100, 3))),
        jnp.asarray(accel + NOISE.accel_density / 0.1 * rng.normal(size=(3000, 100, 3))),
    )
    mine = RUN(jnp.asarray(gyro), jnp.asarray(accel), jnp.asarray(dt), BIAS)
    turned = np.asarray(lie.so3_log(mine.rotation.T @ found.rotation))
    spread = np.concatenate([turned, found.position, found.velocity], axis=1).std(axis=0)
    assert np.allclose(spread, np.sqrt(np.diag(mine.covariance)), rtol=0.06)


def drive(t):
    """A vehicle on a banked curve: pose and its derivatives by central differences of a closed form."""
    yaw, x, y = 0.3 * t + 0.05 * t**2, 10 * t + 0.5 * t**2, 0.8 * t**2
    T = np.eye(4)
    T[:3, 3] = x, y, 0.1 * np.sin(t)
    T[:3, :3] = (
        rigid.exp(np.array([0, 0, 0, 0.0, 0.0, yaw]))[:3, :3]
        @ rigid.exp(np.array([0, 0, 0, 0.1, 0.03 * t, 0.0]))[:3, :3]
    )
    return T


def state(t, h=1e-4):
    velocity = (drive(t + h)[:3, 3] - drive(t - h)[:3, 3]) / (2 * h)
    return InertialState(jnp.asarray(drive(t)), jnp.asarray(velocity))


def test_residual_is_zero_on_a_true_motion_and_counts_in_sigmas():
    """Samples of a known motion at 400 Hz: 1 s later within a millimetre; half a degree of turn is found again."""
    num, h = 400, 1e-3
    t = (np.arange(num) + 0.5) / num
    gyro, accel = [], []
    for s in t:
        T, before, after = drive(s), drive(s - h), drive(s + h)
        gyro.append(rigid.log(rigid.inverse(before) @ after)[3:] / (2 * h))
        acceleration = (before[:3, 3] - 2 * T[:3, 3] + after[:3, 3]) / h**2
        accel.append(T[:3, :3].T @ (acceleration - np.array(GRAVITY)))
    factor = RUN(
        jnp.asarray(np.array(gyro)) + BIAS[:3], jnp.asarray(np.array(accel)) + BIAS[3:], jnp.full(num, 1 / num), BIAS
    )
    exact = imu_residual(state(0.0), state(1.0), BIAS, GRAVITY, factor, jnp.eye(9))
    assert np.linalg.norm(exact[:3]) < 1e-5 and np.linalg.norm(exact[3:6]) < 1e-3 and np.linalg.norm(exact[6:]) < 1e-3
    turned = state(1.0).T_map_base @ jnp.asarray(rigid.exp(np.array([0, 0, 0, 0.0, 0.0, np.radians(0.5)])))
    off = imu_residual(state(0.0), InertialState(turned, state(1.0).velocity_map), BIAS, GRAVITY, factor, jnp.eye(9))
    assert np.degrees(off[2]) == pytest.approx(0.5, abs=1e-3)


def test_padding_changes_nothing_and_float32_is_enough():
    gyro, accel, dt = samples(60)
    pad = 40
    whole = RUN(
        jnp.asarray(np.pad(gyro, ((0, pad), (0, 0)), constant_values=7.0)),
        jnp.asarray(np.pad(accel, ((0, pad), (0, 0)), constant_values=7.0)),
        jnp.asarray(np.pad(dt, (0, pad))),
        BIAS,
    )
    short = preintegrate(jnp.asarray(gyro), jnp.asarray(accel), jnp.asarray(dt), BIAS, NOISE)
    single = preintegrate(*(jnp.asarray(v, jnp.float32) for v in (gyro, accel, dt, BIAS)), NOISE)
    for name in ("rotation", "position", "velocity", "covariance", "by_bias"):
        assert np.allclose(getattr(whole, name), getattr(short, name), atol=1e-12)
        assert getattr(single, name).dtype == jnp.float32
        assert np.allclose(getattr(single, name), getattr(short, name), rtol=1e-4, atol=1e-5)
