"""Small scenes drawn at random, each with noise that no pose explains: what derivatives of a solution are tried on.

The distance map is that of lines known in closed form, seen by every pixel, plus waves of a pixel: the residuals at the
optimum are far from zero, so that the curvature of the kernel and of the boundary matters.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from semloc_jax.alignment.pose import Prior
from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.geometry import rigid
from semloc_jax.residuals.alignment import Usable, camera_views
from semloc_jax.residuals.smooth import ChannelModel, DistanceMaps, SmoothScene
from semloc_jax.simulation.cameras import mounted
from semloc_jax.structs import ViewSamples

WIDTH, HEIGHT, STRIDE, RAMP_PX, NUM = 96, 64, 2, 10.0, 90
RIG = Rig([PinholeCamera(70.0, 70.5, 47.0, 24.0, WIDTH, HEIGHT)], mounted((1.6, 0.1, 1.45), 0.6, 9.0, 0.8)[None], ["f"])
SIGMA = np.array([0.6, 0.4, 0.04, 0.01, 0.01, 0.03])


class Trial(eqx.Module):
    """A scene with its true pose and its prior."""

    scene: SmoothScene
    prior: Prior
    T_true: jax.Array


def _inside(x, y, rng_values):
    """Signed value of both channels, negative inside: a wavy lane and a blob."""
    offset, swing, phase, cx, cy = rng_values
    lane = np.abs(y - offset - swing * np.sin(0.4 * x + phase)) - 1.7
    blob = np.hypot((x - cx) / 1.6, (y - cy) / 1.1) - 1
    return lane, blob


def _contour(rng, rng_values):
    offset, swing, phase, cx, cy = rng_values
    a = rng.uniform(3.0, 22.0, 40)
    side = np.where(np.arange(40) % 2, 1.7, -1.7)
    lane = np.stack([a, offset + swing * np.sin(0.4 * a + phase) + side])
    turn = rng.uniform(0, 2 * np.pi, NUM - 40)
    blob = np.stack([cx + 1.6 * np.cos(turn), cy + 1.1 * np.sin(turn)])
    xy = np.concatenate([lane, blob], axis=1)
    return np.concatenate([xy, np.zeros((1, NUM))]), np.repeat([0, 1], [40, NUM - 40])


def _distances(T_map_cam, rng, rng_values):
    u, v = np.meshgrid(np.arange(WIDTH // STRIDE), np.arange(HEIGHT // STRIDE))
    uv = (np.stack([u, v], axis=-1) + 0.5) * STRIDE - 0.5
    ray = np.asarray(RIG.cameras[0].unproject(uv)[0]) @ T_map_cam[:3, :3].T
    reach = T_map_cam[2, 3] / np.maximum(-ray[..., 2], 1e-3)
    ground = T_map_cam[:3, 3] + reach[..., None] * ray
    maps = []
    for value in _inside(ground[..., 0], ground[..., 1], rng_values):
        dv, du = np.gradient(value)
        wave = rng.normal(size=2) @ np.sin(
            rng.normal(0, 0.25, (2, 2)) @ uv.reshape(-1, 2).T + rng.uniform(0, 6, (2, 1))
        )
        distance = STRIDE * value / np.maximum(np.hypot(du, dv), 1e-9) + wave.reshape(value.shape)
        maps.append(np.where(reach < 60.0, np.clip(distance, -RAMP_PX, RAMP_PX), RAMP_PX))
    return np.stack(maps)[None]


def random_trial(seed, dtype=np.float64):
    """One scene; the pose of the truth is where the lines were drawn from, near the origin."""
    rng = np.random.default_rng(seed)
    rng_values = (rng.uniform(-0.6, 0.6), rng.uniform(0.1, 0.6), *rng.uniform((0, 6.0, -2.0), (6, 12.0, 2.0)))
    T_true = rigid.exp(rng.normal(size=6) * [0.5, 0.5, 0.02, 0.005, 0.005, 0.05])
    p_map, channel = _contour(rng, rng_values)
    samples = ViewSamples(
        jnp.asarray(p_map[None], dtype),
        jnp.zeros((1, 3, NUM), dtype),
        jnp.asarray(channel[None], jnp.int32),
        jnp.asarray(rng.uniform(4.0, 12.0, (1, NUM)), dtype),
        jnp.zeros((1, NUM), jnp.int32),
        jnp.zeros((1, NUM), jnp.int32),
    )
    distance_px = _distances(T_true @ RIG.T_base_cam[0], rng, rng_values)
    usable = np.ones((1, HEIGHT // 2, WIDTH // 2), bool)
    usable[:, 24:, 10 : 10 + rng.integers(4, 12)] = False
    model = ChannelModel(*(jnp.asarray(rng.uniform(low, high, 2), dtype) for low, high in
                           ((0.7, 1.3), (6.0, 9.0), (0.8, 1.0), (1.5, 2.5))))  # fmt: skip
    scene = SmoothScene(
        camera_views(RIG, samples),
        DistanceMaps(jnp.asarray(distance_px, dtype), STRIDE),
        Usable(jnp.asarray(usable), 2),
        model,
        jnp.asarray(1 / 60.0, dtype),
    )
    T_prior = T_true @ rigid.exp(rng.normal(size=6) * SIGMA * 0.5)
    return Trial(scene, Prior(jnp.asarray(T_prior, dtype), jnp.asarray(SIGMA, dtype)), jnp.asarray(T_true, dtype))
