"""Windows of inertial states at the begin of a drive of points, and what they are off by."""

import numpy as np

from semloc_jax.fusion.inertial_moment import InertialWindowConfig, first_sigma
from semloc_jax.fusion.inertial_prior import first_prior
from semloc_jax.fusion.inertial_states import AT, SIZES, STATE
from semloc_jax.fusion.inertial_window import InertialWindow
from semloc_jax.geometry import rigid
from tests.fusion.inertial_world import World, near

NUM = 6
CONFIG = InertialWindowConfig(num_states=NUM, num_landmarks=40)


def sigma_of(config, speed_sigma_mps=0.1):
    """Of a first state whose speed is known to 1 % or as well as stated."""
    pose = np.array([1e-3, 1e-3, 1e-3, 5e-3, 5e-3, 1e-4])
    return first_sigma(config, pose, speed_sigma_mps, np.repeat([2e-3, 0.05], 3), 0.02)


SIGMA = sigma_of(CONFIG)


def difference(state, truth, k):
    """What the truth is beyond an estimate, in the order of its covariance."""
    pose = rigid.log(rigid.inverse(state.T_map_base) @ truth["pose"][k])
    rest = [truth[name][k] - own for name, own in zip(SIZES, state, strict=True) if name != "pose"]
    return np.concatenate([pose, *rest])


def begun(seed, num, noise=1.0, world=None, config=CONFIG, speed_sigma_mps=0.1):
    """A window of the first times with a prior that is drawn around the truth, all times, the truth."""
    world = world or World(seed=seed, noise=noise, num_slots=40)
    moments, truth = world.moments(num)
    values = near(truth, NUM, noise, seed)
    sigma = sigma_of(config, speed_sigma_mps)
    drawn = noise * sigma * np.random.default_rng(seed + 7).normal(size=STATE)
    T = truth["pose"][0]
    values["pose"][0] = T @ rigid.exp(np.concatenate([drawn[:3], T[:3, :3].T @ drawn[3:6]]))
    for name in ("height", "bend", "velocity", "bias"):
        values[name][0] = truth[name][0] + drawn[AT[name]]
    values["scale"][:] = 1.0 + drawn[AT["scale"]]
    for name in ("mount", "delay"):
        values[name][:] = 0.0
    window = InertialWindow.of(moments[:NUM], values, first_prior(values, sigma, T[:3, :3]), config, world.sensor)
    for _ in range(2):
        window.solve()
    return window, moments, truth
