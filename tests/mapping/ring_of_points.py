"""Two rounds of a ring whose road is covered with short lines of two classes: what baselines that match points see."""

import numpy as np

from semloc_jax.alignment.class_icp import ClassPoints
from semloc_jax.geometry import rigid
from semloc_jax.mapping.literature.point_maps import PointMapConfig, PointMaps, frames_by_way
from semloc_jax.structs import ElementClass
from tests.mapping.test_chain_graph import made_chain

NUM, LAP = 90, 40
CLASSES = (ElementClass.SLOT_LINE, ElementClass.ROAD_MARK)


def ring_world(poses, num_lines=160, seed=0):
    """Points every 10 cm on lines of 2 m beside the way of the first round."""
    rng = np.random.default_rng(seed)
    parts = []
    for k in range(num_lines):
        T = poses[rng.integers(LAP)] @ rigid.planar_pose(*rng.uniform(-4.0, 4.0, 2), rng.uniform(0, np.pi))
        along = np.arange(-1.0, 1.0, 0.1)
        line = np.column_stack([along, np.zeros_like(along)])
        parts.append(ClassPoints.of(line, np.full(len(along), int(CLASSES[k % 2]))).moved(T))
    return ClassPoints.joined(parts)


def ring_maps(seed=0, noise_m=0.02, reach_m=8.0, **chain_options):
    """PointMaps of a drive of two rounds, its true poses, its chain."""
    chain, poses = made_chain(NUM, LAP, seed, **chain_options)
    world, rng = ring_world(poses), np.random.default_rng(seed + 1)
    frames = frames_by_way(chain.way_m, 2.0)
    points = []
    for k in frames:
        seen = world.moved(rigid.inverse(poses[k]))
        near = np.linalg.norm(seen.xy, axis=1) < reach_m
        xy = seen.xy[near] + noise_m * rng.normal(size=(int(near.sum()), 2))
        points.append(ClassPoints.of(xy, seen.label[near]))
    return PointMaps(chain, frames, points, PointMapConfig()), poses, chain
