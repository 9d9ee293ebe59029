"""Looks of rendered views: noise that repeats, pictures that a seed makes, marks that stay where they are."""

from functools import lru_cache

import numpy as np
import pytest

from semloc_jax.cameras import BrownConradyCamera, mounted
from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.simulation.looks.floor import polished
from semloc_jax.simulation.looks.light import DAY, INDOORS, NIGHT, ceiling, drawn_light, lit
from semloc_jax.simulation.looks.look import random_picture
from semloc_jax.simulation.looks.materials import PAINT, YELLOW, Materials, Pixels
from semloc_jax.simulation.looks.noise import noise, texture
from semloc_jax.simulation.render import PixelRays, render
from semloc_jax.simulation.road import build_road
from semloc_jax.simulation.solids import Box

CAMERA = BrownConradyCamera(130.0, 130.0, 79.5, 40.0, 160, 96)


@lru_cache
def seen():
    """A view of a road, its camera pose, the ground."""
    world = build_road(np.random.default_rng(5), 30.0, 10.0, 0.0)
    T_map_base = world.surface.stand(world.path.at(np.array([3.0])), world.path.heading_at(np.array([3.0])))[0]
    T_map_cam = T_map_base @ mounted((1.6, 0.0, 1.4), 0.0, 4.0, 0.0)
    return render(world.scene(), PixelRays(CAMERA), T_map_cam, (), 0.0), T_map_cam, world.surface


def look(seed):
    view, T_map_cam, surface = seen()
    return random_picture(view, T_map_cam, CAMERA, surface, np.random.default_rng(seed))


@pytest.mark.parametrize("kind", ["grain", "rough", "cloud"])
def test_noise_has_no_mean_and_repeats_without_a_seam(kind):
    plane = texture(kind)
    assert abs(plane.mean()) < 1e-4 and plane.std() == pytest.approx(1.0, abs=1e-4)
    rows = np.array([3.0, 3.5, 511.75])
    np.testing.assert_allclose(noise(kind, rows, rows), noise(kind, rows + 512.0, rows - 512.0), atol=1e-3)
    assert noise(kind, np.array([7.0]), np.array([9.0]))[0] == pytest.approx(plane[9, 7])


def test_a_picture_follows_from_its_seed():
    one, again, other = look(1), look(1), look(2)
    assert one.shape == (96, 160, 3) and one.dtype == np.uint8
    np.testing.assert_array_equal(one, again)
    assert np.abs(one.astype(float) - other).mean() > 5.0


def test_paint_stays_where_it_is_and_is_brighter_than_the_road():
    """In nearly all looks; what makes a picture may not move it: one pixel aside the marks stand out less."""
    view, _, _ = seen()
    is_paint = np.isin(view.class_id, PAINT)
    is_near = is_paint | (view.class_id == CLASS_IDS["road"])

    def contrast(grey, shift):
        moved = np.roll(is_paint, shift, axis=1) & is_near
        return grey[moved].mean() - grey[is_near & ~moved].mean()

    found = []
    for seed in range(12):
        grey = look(seed).astype(float).mean(axis=2)
        found.append([contrast(grey, shift) for shift in (-1, 0, 1)])
    found = np.array(found)
    assert np.mean(found[:, 1] > 3.0) > 0.7
    mean = found[found[:, 1] > 3.0].mean(axis=0)
    assert mean[1] > 1.02 * max(mean[0], mean[2])


def test_yellow_paint_is_yellow():
    places = np.random.default_rng(0).uniform(0.0, 5.0, (200, 3)).astype(np.float32)
    up, nothing = np.tile([0.0, 0.0, 1.0], (200, 1)), np.full((200, 3), np.nan)
    materials = Materials(np.random.default_rng(3))
    pixels = Pixels(places, up, np.zeros(200), nothing, YELLOW)
    blue, green, red = materials.albedo(CLASS_IDS["lane_solid"], pixels).mean(axis=0)
    assert red > green > 1.5 * blue


def test_light_by_the_time_of_day():
    """By day the same everywhere but for shadows; headlights fall off, and signs throw more of them back."""
    places = np.array([[5.0, 0.0, -1.4], [40.0, 0.0, -1.4], [40.0, 0.0, -1.4]])
    facing, retro = np.tile([-1.0, 0.0, 0.0], (3, 1)), np.array([False, False, True])
    rng = np.random.default_rng(0)
    night = drawn_light(rng, NIGHT)
    near, far, back = lit(night, places, facing, retro).mean(axis=1)
    assert near > 3.0 * far
    assert (back > far) == (night.retro > 1.0)
    for time in (DAY, INDOORS):
        assert np.all(np.isfinite(lit(drawn_light(rng, time), places, facing, retro)))


def test_a_smooth_floor_mirrors_what_stands_on_it():
    """A red pillar 5.7 m ahead of a camera 1 m above a level floor: its image in the floor begins at its foot, reaches
    towards the camera, and lies straight below it."""
    u, v = np.meshgrid(np.arange(640) - 319.5, np.arange(384) - 80.0)
    ray = np.stack([np.full(u.shape, 400.0), -u, -v], axis=-1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    is_ground = ray[..., 2] < -0.005
    away = np.where(is_ground, -1.0 / np.minimum(ray[..., 2], -0.005), 0.0)[..., None] * ray
    pillar = Box(0, (0.0, 0.0, 1.0), np.array([6.0, 0.0, 1.4]), (0.6, 0.6, 2.8), np.eye(3))
    light, black = drawn_light(np.random.default_rng(1), INDOORS), np.zeros((*is_ground.shape, 3), np.float32)
    changed = np.zeros(is_ground.shape)
    for seed in range(4):
        spots = black, is_ground, ray, away, np.array([0.0, 0.0, 1.0])
        shown = [polished(*spots, solids, light, np.random.default_rng(seed)) for solids in ((pillar,), ())]
        changed += np.abs(shown[0] - shown[1]).sum(axis=-1)
    foot = 80 + round(400.0 / 5.7)
    columns = changed[foot:].sum(axis=0)
    assert columns[260:380].sum() > 0.8 * columns.sum() and abs(np.average(u[0], weights=columns)) < 4.0
    assert changed[foot + 30 : foot + 60].mean() > 5.0 * changed[84 : foot - 40].mean()


def test_a_smooth_floor_mirrors_lamps_as_bright_as_paint():
    """Where one looks down at 45 deg and more: some floors throw back more light of a lamp than white paint, most less;
    between lamps it is a tenth of that. A ceiling shows as much of them as is asked for."""
    rows, columns = 160, 240
    v, u = np.mgrid[0:rows, 0:columns]
    ray = np.stack([np.ones(u.shape), (119.5 - u) / 120.0, -1.0 - v / 80.0], axis=-1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    away, floor = ray / -ray[..., 2:], np.ones(u.shape, bool)
    light = drawn_light(np.random.default_rng(1), INDOORS)
    black, above = np.zeros((rows, columns, 3), np.float32), np.array([0.0, 0.0, 1.0])
    shown = [polished(black, floor, ray, away, above, (), light, np.random.default_rng(seed)) for seed in range(40)]
    white = 0.9 * float(light.ambient_bgr.mean())
    brightest = np.array([np.percentile(one.mean(axis=-1), 99.5) for one in shown])
    usual = np.array([np.median(one.mean(axis=-1)) for one in shown])
    assert 3 <= (brightest > white).sum() <= 20
    assert np.all(usual <= 0.1 * white)
    up = ray * [1.0, 1.0, -1.0]
    dim, bright = (ceiling(light, up.reshape(-1, 3), lamp) for lamp in (2.5, 25.0))
    assert bright.max() == pytest.approx(25.3 / 2.8 * dim.max(), rel=0.1) and np.median(bright / dim) == 1.0
