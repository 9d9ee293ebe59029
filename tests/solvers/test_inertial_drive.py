"""A drive by inertial samples: poses, velocities and a bias in one graph, solved in every structure."""

from functools import partial

import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.fusion.pose_factors import measured_poses
from semloc_jax.geometry import rigid
from semloc_jax.residuals.preintegration import preintegrate
from semloc_jax.solvers.factors import POSE, Factors
from semloc_jax.solvers.front import Arrow, Dense, Sparse, solve, structured
from semloc_jax.solvers.graph import FactorGraph, Family
from semloc_jax.solvers.levenberg_marquardt import SolveConfig
from tests.compiling import jit_quickly
from tests.contracts.test_factors import GRAVITY, KINDS, RNG, SAMPLES, STEP_S, inertial, near, samples, stacked


def inertial_drive(num=12):
    """Poses, velocities and one bias by inertial samples and measured poses; the truth, and a start that is off."""
    bias = np.array([0.004, -0.003, 0.002, 0.05, -0.04, 0.03])
    T, v = [np.asarray(near(0.1))], [np.array([8.0, 0.5, 0.0])]
    parts = []
    for k in range(num - 1):
        gyro, accel, dt = samples(k)
        free = preintegrate(gyro, accel, dt, jnp.zeros(6))
        parts.append(preintegrate(gyro + bias[:3], accel + bias[3:], dt, jnp.zeros(6)))
        R, seconds = T[-1][:3, :3], SAMPLES * STEP_S
        moved = np.eye(4)
        moved[:3, :3] = R @ np.asarray(free.rotation)
        fall = np.asarray(GRAVITY) * seconds
        moved[:3, 3] = T[-1][:3, 3] + v[-1] * seconds + 0.5 * fall * seconds + R @ np.asarray(free.position)
        v.append(v[-1] + fall + R @ np.asarray(free.velocity))
        T.append(moved)
    T, v, keys = np.array(T), np.array(v), np.arange(num - 1)
    sqrt_info = np.tile(np.diag(np.repeat([1e4, 1e3, 1e3], 3)), (num - 1, 1, 1))
    on = ("pose", "velocity", "bias", "pose", "velocity")
    moves = Factors(inertial, on, (keys, keys, 0 * keys, keys + 1, keys + 1), (stacked(parts),), sqrt_info)
    measured = measured_poses(T, np.tile(np.eye(6) * 100.0, (num, 1, 1)), 1e6)
    families = Family("pose", POSE, num), Family("velocity", KINDS["velocity"], num), Family("bias", KINDS["bias"], 1)
    off = np.array([rigid.exp(xi) for xi in RNG.normal(size=(num, 6)) * 0.02])
    start = {"pose": T @ off, "velocity": v + 0.3 * RNG.normal(size=v.shape), "bias": np.zeros((1, 6))}
    return FactorGraph(families, (measured, moves)), start, {"pose": T, "velocity": v, "bias": bias[None]}


def assert_found(solution, true):
    """The truth within the first order of the bias."""
    assert bool(solution.converged)
    np.testing.assert_allclose(solution.value["bias"], true["bias"], atol=2e-3)
    np.testing.assert_allclose(solution.value["velocity"], true["velocity"], atol=5e-3)


def test_velocities_and_bias_of_an_inertial_drive_are_found():
    graph, start, true = inertial_drive()
    assert_found(solve(graph, start, SolveConfig(1e-8, 40), Arrow(("pose", "velocity"))), true)


@pytest.mark.slow
def test_every_structure_finds_the_same():
    graph, start, true = inertial_drive()
    config = SolveConfig(1e-8, 40)
    found = [solve(graph, start, config, s) for s in (Dense(), Arrow(("pose", "velocity")), Sparse(("bias",)))]
    for solution in found:
        assert_found(solution, true)
        for name in true:
            np.testing.assert_allclose(solution.value[name], found[0].value[name], atol=1e-7)
    damping = jnp.asarray(1e-4)
    values = {name: jnp.asarray(value) for name, value in start.items()}

    def first_step(structure, values):
        problem = structured(graph, structure)
        return problem.step(problem.linearise(values, jnp.asarray(False)), damping).tangent

    dense = jit_quickly(partial(first_step, Dense()))(values)
    arrow = jit_quickly(partial(first_step, Arrow(("pose", "velocity"))))(values)
    for mine in (arrow, first_step(Sparse(), values)):
        for name in true:
            np.testing.assert_allclose(mine[name], dense[name], atol=1e-7)
