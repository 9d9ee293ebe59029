"""Contours known in closed form on a flat ground, seen by any rig: ramps, samples and poses without a renderer.

The oracle is the line of sight of every pixel, cut with the ground: its signed distance to the contour divided by its
slope in the image is the ramp. Nothing of the residual is used to make it.
"""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from semloc_jax.alignment.pose import Evidence, Prior
from semloc_jax.cameras import (
    BevCamera,
    BrownConradyCamera,
    CylindricalCamera,
    KannalaBrandtCamera,
    PinholeCamera,
    Rig,
)
from semloc_jax.cameras.bev import T_base_bev
from semloc_jax.geometry import rigid
from semloc_jax.residuals.alignment import CameraViews, Usable, camera_views
from semloc_jax.residuals.texture import RampTextures, pack
from semloc_jax.simulation.cameras import mounted
from semloc_jax.structs import CostMaps, ViewSamples
from tests.compiling import jit_quickly

FRONT = (186.0, 186.4, 118.7, 72.9, 240, 150)
SIDE = (98.0, 98.1, 159.1, 120.4, 320, 240)
IN_FRONT = mounted((1.6, 0.1, 1.45), 0.6, 9.0, 0.8)
RIGS = {
    "pinhole": Rig([PinholeCamera(*FRONT)], IN_FRONT[None], ["front"]),
    "radtan": Rig([BrownConradyCamera(*FRONT, -0.118, 0.042, 0.0006, -0.0004)], IN_FRONT[None], ["front"]),
    "fisheye": Rig(
        [KannalaBrandtCamera(*SIDE, -0.013, -0.0042, 0.0011, -0.0002)],
        mounted((1.9, 1.0, 1.0), 70.0, 38.0, 0.6)[None],
        ["left"],
    ),
    "cylinder": Rig(
        [CylindricalCamera(60.0, 199.5, 20.0, 400, 110)], mounted((1.0, 0.0, 1.9), 3.0, 0.0, 0.0)[None], ["all"]
    ),
    "bev": Rig([BevCamera.covering(12.0, 4.0, 7.0, 7.0, 0.05)], T_base_bev()[None], ["top"]),
    "mixed": Rig(
        [
            BrownConradyCamera(*FRONT, -0.118, 0.042, 0.0006, -0.0004),
            KannalaBrandtCamera(*SIDE, -0.013, -0.0042, 0.0011, -0.0002),
            BevCamera.covering(12.0, 4.0, 7.0, 7.0, 0.05),
        ],
        np.stack([IN_FRONT, mounted((1.9, -1.0, 1.0), -75.0, 37.0, 0.3), T_base_bev()]),
        ["front", "right", "top"],
    ),
}
T_TRUE = rigid.exp(np.array([31.0, -12.0, 0.02, 0.012, -0.009, 0.7]))
SIGMA = np.array([0.8, 0.6, 0.05, 0.01, 0.01, 0.04])
RAMP_PX, STRIDE = (20.0, 6.0), (2, 1)
_HEADING = 0.7
_CENTER = np.array([33.5, -3.6])


def _local(x, y):
    """Coordinates along and across the drive, origin near the vehicle."""
    c, s = np.cos(_HEADING), np.sin(_HEADING)
    dx, dy = x - T_TRUE[0, 3], y - T_TRUE[1, 3]
    return c * dx + s * dy, -s * dx + c * dy


def _to_map(a, b):
    c, s = np.cos(_HEADING), np.sin(_HEADING)
    return np.stack([c * a - s * b + T_TRUE[0, 3], s * a + c * b + T_TRUE[1, 3], np.zeros_like(a)], axis=-1)


def _contours():
    """For each channel: a function that is negative inside the paint, and points on its zero line."""
    a = np.linspace(-8.0, 22.0, 900)
    wave = _to_map(a, -1.5 + 0.5 * np.sin(0.9 * a))
    turn = np.linspace(0.0, 2 * np.pi, 500)
    spots = [
        _to_map(at[0] + 1.3 * np.cos(turn), at[1] + 0.9 * np.sin(turn)) for at in ((6.0, 2.0), (2.0, -4.0), (3, 4))
    ]

    def beside_wave(x, y):
        along, across = _local(x, y)
        return across - (-1.5 + 0.5 * np.sin(0.9 * along))

    def in_spot(x, y):
        along, across = _local(x, y)
        places = ((6.0, 2.0), (2.0, -4.0), (3.0, 4.0))
        return np.min([np.hypot((along - p) / 1.3, (across - q) / 0.9) - 1 for p, q in places], axis=0)

    return [(beside_wave, wave), (in_spot, np.concatenate(spots))]


def _ground_of_pixels(camera, T_map_cam, stride):
    """x, y [h w] where the line of sight of every pixel of a level meets the ground of the map; NaN for the sky."""
    width, height = camera.resolution
    u, v = np.meshgrid(np.arange(0, -(-width // stride)), np.arange(0, -(-height // stride)))
    uv = (np.stack([u, v], axis=-1) + 0.5) * stride - 0.5
    ray, valid = (np.asarray(part) for part in camera.unproject(uv))
    start, sight = (ray, np.array([0.0, 0.0, 1.0])) if isinstance(camera, BevCamera) else (np.zeros(3), ray)
    start = start @ T_map_cam[:3, :3].T + T_map_cam[:3, 3]
    sight = np.broadcast_to(sight @ T_map_cam[:3, :3].T, ray.shape)
    reach = -start[..., 2] / np.where(np.abs(sight[..., 2]) < 1e-3, np.nan, sight[..., 2])
    point = start + reach[..., None] * sight
    seen = valid & (isinstance(camera, BevCamera) | ((reach > 0) & (reach < 60.0)))
    return np.where(seen, point[..., 0], np.nan), np.where(seen, point[..., 1], np.nan)


def _ramp(camera, T_map_cam, inside, stride, ramp_px, shape):
    value = inside(*_ground_of_pixels(camera, T_map_cam, stride))
    dv, du = np.gradient(value)
    distance_px = stride * value / np.hypot(du, dv)
    ramp = np.ones(shape)
    ramp[: value.shape[0], : value.shape[1]] = np.nan_to_num(np.clip(distance_px / ramp_px, -1, 1), nan=1.0)
    return ramp


@cache
def cost_maps_of(name):
    """Analytic cost maps of a rig at the true pose; channel 0 a wavy edge, channel 1 three ellipses."""
    rig = RIGS[name]
    width, height = np.max([camera.resolution for camera in rig.cameras], axis=0)
    ramps = []
    for ramp_px, stride in zip(RAMP_PX, STRIDE, strict=True):
        shape = (-(-height // stride), -(-width // stride))
        ramps.append(
            np.array(
                [
                    [_ramp(camera, T_TRUE @ T, inside, stride, ramp_px, shape) for inside, _ in _contours()]
                    for camera, T in zip(rig.cameras, rig.T_base_cam, strict=True)
                ]
            )
        )
    usable = jnp.asarray(np.ones((len(rig), -(-height // 2), -(-width // 2)), bool))
    return CostMaps(tuple(map(jnp.asarray, ramps)), RAMP_PX, STRIDE, usable, 2)


def samples_of(name, num=400, seed=0, dtype=np.float64):
    """Contour points for each camera, those in view with weight 1 .. 2, padding with weight 0; num a camera."""
    rng = np.random.default_rng(seed)
    rig = RIGS[name]
    points = np.concatenate([line for _, line in _contours()])
    channel = np.concatenate([np.full(len(line), k) for k, (_, line) in enumerate(_contours())])
    p_map, channels, weights = np.zeros((len(rig), 3, num)), np.zeros((len(rig), num), int), np.zeros((len(rig), num))
    for k, (camera, T_base_cam) in enumerate(zip(rig.cameras, rig.T_base_cam, strict=True)):
        T_cam_map = rigid.inverse(T_TRUE @ T_base_cam)
        p_cam = (points @ T_cam_map[:3, :3].T) + T_cam_map[:3, 3]
        uv, valid = (np.asarray(part) for part in camera.project(p_cam))
        seen = np.asarray(camera.in_image(uv[:, 0], uv[:, 1], 6.0)) & valid
        seen &= np.linalg.norm(points - T_TRUE[:3, 3], axis=1) < 14.0
        # Within 100 deg of the axis: the pixels around the last ones of a fisheye have no line of sight.
        if isinstance(camera, KannalaBrandtCamera):
            seen &= p_cam[:, 2] > np.cos(np.radians(100.0)) * np.linalg.norm(p_cam, axis=1)
        chosen = rng.choice(np.flatnonzero(seen), num)
        p_map[k], channels[k] = points[chosen].T, channel[chosen]
        weights[k] = rng.uniform(1.0, 2.0, num) * (np.arange(num) < 0.9 * num)
    return ViewSamples(
        *(jnp.asarray(part.astype(dtype)) for part in (p_map, np.zeros_like(p_map))),
        jnp.asarray(channels.astype(np.int32)),
        jnp.asarray(weights.astype(dtype)),
        *(jnp.asarray(np.zeros(channels.shape, np.int32)) for _ in range(2)),
    )


class Scene(eqx.Module):
    """Everything the bridge and the solvers need, in one float type."""

    views: tuple[CameraViews, ...]
    textures: RampTextures
    usable: Usable
    T_true: jax.Array
    sigma: jax.Array

    @property
    def evidence(self):
        return Evidence(self.views, self.textures, self.usable)

    def prior(self, xi=(0.0,) * 6, sigma=None):
        """Prior whose centre is off the truth by a right tangent xi."""
        sigma = self.sigma if sigma is None else jnp.asarray(sigma, self.sigma.dtype)
        return Prior(self.moved(xi), sigma)

    def moved(self, xi):
        """The true pose moved by a right tangent [m, rad]."""
        return jnp.asarray(
            (np.asarray(self.T_true, float) @ rigid.exp(np.asarray(xi, float))).astype(self.T_true.dtype)
        )


@cache
def _assemble(name):
    """Views and textures of a rig, given samples and cost maps, as one program."""
    return jit_quickly(lambda samples, maps: (camera_views(RIGS[name], samples), pack(maps, samples.p_map.dtype)))


def scene(name, num=400, dtype=np.float64, samples=None):
    """The scene of one rig."""
    maps = cost_maps_of(name)
    samples = samples_of(name, num, dtype=dtype) if samples is None else samples
    return Scene(
        *_assemble(name)(samples, maps),
        Usable(maps.usable, maps.usable_stride),
        jnp.asarray(T_TRUE.astype(dtype)),
        jnp.asarray(SIGMA.astype(dtype)),
    )
