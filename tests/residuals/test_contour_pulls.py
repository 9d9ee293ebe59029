"""Pulls of elements across their contours: = autodiff = finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.alignment.frame_localizer import FrameLocalizer, sample_within
from semloc_jax.alignment.implicit import smooth_scene
from semloc_jax.alignment.pose import AlignConfig
from semloc_jax.alignment.single_frame import evidence_from, frame_input
from semloc_jax.datasets import open_drive
from semloc_jax.geometry import lie, rigid
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.maps import read_map
from semloc_jax.perception.cost_maps import CostMapConfig, cost_maps
from semloc_jax.residuals.alignment import points_in_camera
from semloc_jax.residuals.contour_pulls import contour_pulls
from semloc_jax.residuals.contour_rows import contour_rows
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.residuals.smooth import cubic_value, distance_patch, reach_and_gain, seen_share
from semloc_jax.residuals.view import ViewConfig
from tests.compiling import jit_quickly


@pytest.fixture(scope="module")
def seen(simulated_road):
    """A frame 5 cm and 0.2 deg off, as a scene, and where the vehicle is."""
    drive = open_drive(simulated_road)
    frame, source = drive.frames[1], mask_source("sem_net", drive)
    localizer = FrameLocalizer(read_map(drive.map_path), source.table)
    T = drive.truth_at(frame) @ rigid.exp(np.array([0.04, 0.03, 0.0, 0.0, 0.0, np.deg2rad(0.2)]))
    local_map = localizer.map.query(T[:3, 3], 25.0)
    samples = sample_within(local_map, 0.1, localizer.config.sample_capacity)
    maps = cost_maps(source.masks(frame), localizer.shown, CostMapConfig(ramp_px=(8.0,), stride=(1,)), quantised=True)
    rig = source.seen_by(frame.rig.select(source.cameras))
    inputs = frame_input(samples, maps, rig, localizer.channel_of_label)
    T_local = local_map.frame.from_map(T, np.float32)
    evidence = evidence_from(T_local, inputs, ViewConfig(max_range_m=20.0))
    scene = smooth_scene(evidence, maps, AlignConfig())
    return scene, jnp.asarray(T_local)


def held_cost(T_map_base, scene, seen_from):
    """The cost where every sample moves across its contour alone, as it lies from `seen_from`, with weights held."""
    total = jnp.zeros(())
    for views in scene.views:
        for k in range(views.p_map.shape[0]):
            view = jax.tree.map(lambda leaf, k=k: leaf[k], views)
            geometry = (view.T_cam_base, view.camera, view.p_map, view.tangent_map)
            _, uv, normal = contour_rows(seen_from, *geometry)
            now = jnp.stack(view.camera.project_xyz(*points_in_camera(view.T_cam_base, T_map_base, view.p_map))[:2])
            u, v = uv + normal * jnp.sum(normal * (now - uv), axis=0)
            reach_px, gain = reach_and_gain(view.channel, scene.model)
            weight = scene.nats_per_px * view.weight * seen_share(*uv, view, scene.usable, scene.border)[0]
            ratio = cubic_value(distance_patch(u, v, view, scene.maps)) / reach_px
            total += jnp.sum(jnp.where(weight > 0, weight * gain * LOSSES["tukey"].rho(ratio), 0.0))
    return total


def test_force_is_the_derivative_of_the_cost_across_contours(seen):
    scene, T = seen
    none = jnp.zeros(1)
    holder = tuple(jnp.zeros(view.weight.shape, int) for view in scene.views)
    force = np.asarray(contour_pulls(T, scene, holder, none).force[0])

    def cost(xi, T, scene):
        return held_cost(T @ lie.exp(xi), scene, T)

    automatic = np.asarray(jit_quickly(jax.grad(cost))(jnp.zeros(6), T, scene))
    np.testing.assert_allclose(force, automatic, rtol=1e-3, atol=1e-3 * np.abs(automatic).max())
    with jax.enable_x64(True):
        exact = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64) if leaf.dtype == jnp.float32 else leaf, scene)
        steps = 1e-5 * jnp.concatenate([jnp.eye(6), -jnp.eye(6)])
        costs = jit_quickly(jax.vmap(cost, in_axes=(0, None, None)))(steps, jnp.asarray(T, jnp.float64), exact)
        by_hand = np.asarray(costs[:6] - costs[6:]) / 2e-5
    np.testing.assert_allclose(force, by_hand, rtol=0.01, atol=0.01 * np.abs(by_hand).max())
