"""Textures: the packed bilinear lookup against scipy's, at every stride, camera and channel."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from semloc_jax.residuals.texture import RampTexture, lookup, pack
from semloc_jax.structs import CostMaps

STRIDES, RAMPS = (4, 2, 1), (40.0, 14.0, 3.0)
HEIGHT, WIDTH = 37, 53
HALF_STEP = 0.5 / 127
"""Quantisation moves a value by at most this."""


def random_maps(num_cameras=2, num_channels=3):
    rng = np.random.default_rng(0)
    shapes = [(num_cameras, num_channels, -(-HEIGHT // s), -(-WIDTH // s)) for s in STRIDES]
    ramps = tuple(jnp.asarray(rng.uniform(-1, 1, shape)) for shape in shapes)
    return CostMaps(ramps, RAMPS, STRIDES, jnp.ones((num_cameras, HEIGHT, WIDTH), bool), 1)


MAPS = random_maps()


def value_at(texture: RampTexture, camera, channel, u, v):
    index = texture.image_index(jnp.asarray(camera), jnp.full(np.shape(u), channel))
    return lookup(texture, index, jnp.asarray(u), jnp.asarray(v))


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize(("camera", "channel"), [(0, 0), (1, 2), (0, 1)])
def test_lookup_is_scipys_linear_interpolation(level, camera, channel):
    texture = pack(MAPS, jnp.float64).level(level)
    rng = np.random.default_rng(level)
    u, v = rng.uniform(-6, WIDTH + 5, 500), rng.uniform(-6, HEIGHT + 5, 500)
    places = np.stack([(v + 0.5) / STRIDES[level] - 0.5, (u + 0.5) / STRIDES[level] - 0.5])
    image = np.round((np.asarray(MAPS.ramps[level][camera, channel]) + 1) * 127) / 127 - 1
    expected = map_coordinates(image, places, order=1, mode="nearest")
    given = np.asarray(value_at(texture, camera, channel, u, v))
    # The right tap must exist, so the last thousandth of the last texel is not used.
    outside = (places[0] > image.shape[0] - 1.001) | (places[1] > image.shape[1] - 1.001)
    np.testing.assert_allclose(given[~outside], expected[~outside], atol=1e-12)
    assert np.abs(given - expected)[outside].max() < 3e-3
    assert np.abs(image - np.asarray(MAPS.ramps[level][camera, channel])).max() <= HALF_STEP + 1e-12


def test_zero_and_the_ends_of_the_ramp_are_exact():
    ramp = jnp.asarray([[[[-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]]]])
    texture = pack(CostMaps((ramp,), (3.0,), (1,), jnp.ones((1, 2, 3), bool), 1), jnp.float64).level(0)
    value = value_at(texture, 0, 0, np.array([0.0, 1.0, 1.9999]), np.zeros(3))
    np.testing.assert_allclose(value, [-1.0, 0.0, 0.999], atol=1e-9)


def test_slope_is_that_of_the_bilinear_surface():
    texture = pack(MAPS, jnp.float64).level(1)
    rng = np.random.default_rng(5)
    column, row = rng.integers(1, 24, 200), rng.integers(1, 16, 200)
    share = rng.uniform(0.05, 0.95, (2, 200))
    u, v = (jnp.asarray((k + f + 0.5) * 2 - 0.5) for k, f in zip((column, row), share, strict=True))
    du, dv = jax.grad(lambda u, v: jnp.sum(value_at(texture, 1, 1, u, v)), argnums=(0, 1))(u, v)
    step = 1e-5
    for exact, (su, sv) in ((du, (step, 0.0)), (dv, (0.0, step))):
        numeric = (value_at(texture, 1, 1, u + su, v + sv) - value_at(texture, 1, 1, u - su, v - sv)) / (2 * step)
        np.testing.assert_allclose(exact, numeric, atol=1e-8)


def test_the_level_is_data_so_one_compilation_serves_all():
    textures = pack(MAPS)
    count = []

    @jax.jit
    def value(level, u, v):
        count.append(1)
        return value_at(textures.level(level), 0, 2, u, v)

    u, v = jnp.linspace(3.0, 40.0, 30, dtype=jnp.float32), jnp.linspace(2.0, 30.0, 30, dtype=jnp.float32)
    for level in range(3):
        expected = value_at(textures.level(level), 0, 2, u, v)
        np.testing.assert_allclose(value(jnp.asarray(level), u, v), expected, atol=1e-6)
    assert len(count) == 1


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30, -1e30])
def test_pixels_that_are_no_numbers_read_the_border_and_stay_finite(bad):
    texture = pack(MAPS).level(2)
    u, v = jnp.asarray([bad, 5.0], jnp.float32), jnp.asarray([4.0, bad], jnp.float32)
    value = value_at(texture, 0, 0, u, v)
    slope = jax.grad(lambda u: jnp.sum(value_at(texture, 0, 0, u, v)))(u)
    assert np.isfinite(value).all() and np.abs(value).max() <= 1.0
    assert np.isfinite(slope).all()
