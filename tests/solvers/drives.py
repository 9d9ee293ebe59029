"""Drives with loops, landmarks and inertial states, as factor graphs and as gtsam's: scenes of the solver tests."""

import time

import numpy as np

from semloc_jax.geometry import rigid
from semloc_jax.residuals.motion import between_linearised, between_residual, pose_linearised, pose_residual
from semloc_jax.solvers.factors import POSE, Factors
from semloc_jax.solvers.graph import FactorGraph, Family

SIGMA = np.array([0.02, 0.01, 0.01, 0.002, 0.002, 0.001])
"""Of a measured motion [m, rad]."""
ANCHOR_SIGMA = 0.01
LAP = 250
"""Poses in one round."""


def true_poses(num, lap=LAP):
    """Rounds on a ring of 40 m radius that goes up and down."""
    angle = np.arange(num) * 2 * np.pi / lap
    poses = np.tile(np.eye(4), (num, 1, 1))
    c, s = np.cos(angle + np.pi / 2), np.sin(angle + np.pi / 2)
    poses[:, 0, 0], poses[:, 0, 1], poses[:, 1, 0], poses[:, 1, 1] = c, -s, s, c
    poses[:, :3, 3] = np.stack([40 * np.cos(angle), 40 * np.sin(angle), 0.3 * np.sin(3 * angle)], axis=1)
    return poses


def measured_ends(num, lap=LAP, every=10):
    """Which poses a measured motion connects: neighbours, and every tenth pose with the one a round before."""
    steps = np.stack([np.arange(num - 1), np.arange(1, num)], axis=1)
    loops = np.arange(0, num, every)
    loops = loops[loops >= lap]
    return steps, np.stack([loops - lap, loops], axis=1)


def measured_motion(poses, ends, rng):
    """T_from_to of every pair of poses with noise."""
    noise = np.array([rigid.exp(xi) for xi in rng.normal(size=(len(ends), 6)) * SIGMA])
    return np.linalg.inv(poses[ends[:, 0]]) @ poses[ends[:, 1]] @ noise


def driven(first, steps):
    """Poses by dead reckoning."""
    poses = [first]
    for step in steps:
        poses.append(poses[-1] @ step)
    return np.array(poses)


def anchor(T):
    """The first pose is known."""
    sqrt_info = np.eye(6)[None] / ANCHOR_SIGMA
    return Factors(pose_residual, ("pose",), (np.zeros(1, int),), (T[None],), sqrt_info, linearised=pose_linearised)


def motions(ends, Ts_from_to, sigma=SIGMA):
    """Measured motions as factors."""
    sqrt_info = np.tile(np.diag(1 / sigma), (len(ends), 1, 1))
    keys = (ends[:, 0], ends[:, 1])
    return Factors(between_residual, ("pose", "pose"), keys, (Ts_from_to,), sqrt_info, linearised=between_linearised)


def laps(num, seed=0, lap=LAP, every=10):
    """Graph of rounds with a loop at every so many poses after the first round, and start values."""
    rng = np.random.default_rng(seed)
    poses = true_poses(num, lap)
    steps, loops = measured_ends(num, lap, every)
    T_steps, T_loops = measured_motion(poses, steps, rng), measured_motion(poses, loops, rng)
    graph = FactorGraph(
        (Family("pose", POSE, num),), (anchor(poses[0]), motions(steps, T_steps), motions(loops, T_loops))
    )
    return graph, {"pose": driven(poses[0], T_steps)}


def gtsam_optimum(graph, start):
    """Poses of gtsam's Levenberg-Marquardt on the same graph, its graph and values, and its CPU seconds."""
    import gtsam

    # gtsam's tangent of a pose is (rotation, translation).
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.concatenate([SIGMA[3:], SIGMA[:3]]))
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    first = gtsam.noiseModel.Isotropic.Sigma(6, ANCHOR_SIGMA)
    factors.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(graph.factors[0].data[0][0]), first))
    for family in graph.factors[1:]:
        for a, b, T in zip(*family.keys, family.data[0], strict=True):
            factors.add(gtsam.BetweenFactorPose3(int(a), int(b), gtsam.Pose3(T), noise))
    for k, T in enumerate(start["pose"]):
        values.insert(k, gtsam.Pose3(T))
    limits = gtsam.LevenbergMarquardtParams()
    limits.setRelativeErrorTol(1e-14)
    limits.setAbsoluteErrorTol(1e-14)
    began_s = time.process_time()
    best = gtsam.LevenbergMarquardtOptimizer(factors, values, limits).optimize()
    took_s = time.process_time() - began_s
    return np.array([best.atPose3(k).matrix() for k in range(len(start["pose"]))]), factors, best, took_s
