"""The native kernels give the numbers of pure JAX: for every camera, batched, on several threads, skipped."""

import dataclasses
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax import native
from semloc_jax.alignment import pose as pose_module
from semloc_jax.alignment.pose import AlignConfig, Evidence, Prior, refine
from semloc_jax.cameras import (
    BevCamera,
    BrownConradyCamera,
    Camera,
    CylindricalCamera,
    KannalaBrandtCamera,
    PinholeCamera,
    Rig,
)
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import lie
from semloc_jax.residuals import native_kernels
from semloc_jax.residuals import texture as texture_module
from semloc_jax.residuals.alignment import CameraViews, Usable
from semloc_jax.residuals.chart import Chart
from semloc_jax.residuals.normal_equations import chart_equations
from semloc_jax.residuals.projection import projected
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.residuals.scoring import ramp_values, robust_cost, sums_by_index, sums_by_piece, visible_weight
from semloc_jax.residuals.texture import pack
from semloc_jax.residuals.view import ViewConfig, view
from semloc_jax.simulation.cameras import mounted
from semloc_jax.structs import CostMaps, MapSamples

pytestmark = pytest.mark.skipif(not native.is_available(), reason=f"native kernels {native.status().text}")

WIDTH, HEIGHT = 320, 240
PATHS = "analytic", "xla"
seen_by = jax.jit(view, static_argnames="config")
CAMERAS = {
    "pinhole": PinholeCamera(210.0, 205.0, 158.0, 121.0, WIDTH, HEIGHT),
    "radtan": BrownConradyCamera(210.0, 205.0, 158.0, 121.0, WIDTH, HEIGHT, -0.3, 0.1, 2e-3, -1e-3, -0.02),
    "fisheye": KannalaBrandtCamera(110.0, 108.0, 158.0, 121.0, WIDTH, HEIGHT, 0.02, -0.01, 0.003, -0.001),
    "cylinder": CylindricalCamera(90.0, 158.0, 121.0, WIDTH, HEIGHT, max_phi_rad=2.0),
    "top view": BevCamera(0.05, 158.0, 121.0, WIDTH, HEIGHT),
}


def scene(camera: Camera, seed: int = 0, num: int = 700):
    """One camera, points all around it (also behind), smooth cost maps of two channels on two levels."""
    rng = np.random.default_rng(seed)
    p_cam = rng.normal(size=(3, num)) * np.array([[4.0], [2.0], [6.0]]) + np.array([[0.0], [0.5], [5.0]])
    p_cam[2] *= 0.05 if isinstance(camera, BevCamera) else 1.0
    view = CameraViews(
        camera=jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32)[None], camera),
        T_cam_base=lie.exp(jnp.asarray(rng.normal(size=6) * 0.3, jnp.float32))[None],
        p_map=jnp.asarray(p_cam, jnp.float32)[None],
        tangent_map=jnp.zeros((1, 3, num), jnp.float32),
        channel=jnp.asarray(rng.integers(0, 2, (1, num)), jnp.int32),
        weight=jnp.asarray(rng.uniform(0.5, 2.0, (1, num)), jnp.float32),
        edge=jnp.zeros((1, num), jnp.int32),
        index=jnp.zeros(1, jnp.int32),
    )
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    wave = np.stack([np.sin(columns / 17 + rows / 23), np.cos(columns / 29 - rows / 13)]).astype(np.float32)
    usable = jnp.asarray(rng.uniform(size=(1, HEIGHT // 2, WIDTH // 2)) > 0.2)
    wave = jnp.asarray(wave)[None]
    maps = CostMaps((wave[..., ::2, ::2], wave), (8.0, 3.0), (2, 1), usable, 2)
    return (view,), jax.jit(pack)(maps), Usable(usable, 2)


@partial(jax.jit, static_argnames="path")
def equations(path: str, chart: Chart, views, texture):
    return chart_equations(chart, views, texture, LOSSES["tukey"], path)


@partial(jax.jit, static_argnames="path")
def batched_equations(path: str, chart: Chart, views, texture):
    return jax.vmap(lambda y: equations(path, chart._replace(y=y), views, texture))(chart.y)


def evaluate(path: str, chart: Chart, views, textures, level: int):
    """Normal equations of one chart or of a batch of charts by y."""
    function = batched_equations if chart.y.ndim == 2 else equations
    return function(path, chart, views, textures.level(level))


def chart_at(y: np.ndarray) -> Chart:
    sigma = jnp.asarray([1.0, 0.7, 0.1, 0.02, 0.02, 0.1], jnp.float32)
    return Chart(
        lie.exp(jnp.asarray([0.3, -0.2, 0.1, 0.02, 0.01, 0.2], jnp.float32)), sigma, jnp.asarray(y, jnp.float32)
    )


def assert_same(found, expected, tolerance: float) -> None:
    for one, other in zip(found, expected, strict=True):
        scale = np.abs(np.asarray(other)).max()
        np.testing.assert_allclose(one / scale, other / scale, atol=tolerance)


@pytest.mark.parametrize("path", ["analytic", "autodiff"])
@pytest.mark.parametrize("name", CAMERAS)
def test_normal_equations_are_those_of_jax(name, path):
    views, textures, _ = scene(CAMERAS[name])
    ys = np.random.default_rng(1).normal(size=(6, 6)) * 0.4
    for level in (0, 1):
        expected = evaluate("xla", chart_at(ys), views, textures, level)
        assert np.abs(np.asarray(expected.gradient)).max() > 1.0
        # A pixel that rounding moves across the border of a texel changes the slope of one point of 700.
        assert_same(evaluate(path, chart_at(ys), views, textures, level), expected, 3e-4)


@pytest.mark.parametrize("name", CAMERAS)
def test_visibility_and_cost_are_those_of_jax(name):
    views, textures, usable = scene(CAMERAS[name])
    T = chart_at(np.zeros(6)).pose()
    texture, tukey = textures.level(1), LOSSES["tukey"]
    weigh = jax.jit(visible_weight, static_argnames=("border_px", "path"))
    seen = {path: weigh(T, views[0], usable, border_px=2.0, path=path) for path in ("analytic", "xla")}
    assert 0.02 < np.mean(np.asarray(seen["xla"]) > 0) < 0.9
    assert np.sum(np.asarray(seen["analytic"]) != np.asarray(seen["xla"])) <= 1
    cost = jax.jit(lambda texture, path: robust_cost(T, views, texture, usable, tukey, 2.0, path), static_argnums=1)
    costs = [cost(texture, path) for path in ("analytic", "xla")]
    np.testing.assert_allclose(costs[0], costs[1], rtol=5e-3)
    values = [jax.jit(ramp_values, static_argnames="path")(T, views, texture, path)[0] for path in ("analytic", "xla")]
    np.testing.assert_allclose(*values, atol=2e-3)  # where the slope of the lens is 1e3, rounding is a texel


@pytest.mark.parametrize("name", CAMERAS)
def test_pixels_and_their_derivatives_are_those_of_jax(name):
    (points,), _, _ = scene(CAMERAS[name])
    camera = CAMERAS[name].astype(jnp.float32)
    found, expected = (jax.jit(projected, static_argnames="path")(camera, points.p_map[0], path) for path in PATHS)
    assert np.sum(np.asarray(found.valid) != np.asarray(expected.valid)) == 0
    for one, other in zip((found.u, found.v, found.du, found.dv), expected[:2] + expected[3:], strict=True):
        np.testing.assert_allclose(one, other, rtol=2e-4, atol=2e-3)


def test_packed_cost_maps_are_those_of_jax(monkeypatch):
    rng = np.random.default_rng(4)
    ramps = tuple(jnp.asarray(rng.uniform(-1.2, 1.2, (2, 3, *shape)), jnp.float32) for shape in ((33, 47), (240, 320)))
    maps = CostMaps(ramps, (8.0, 3.0), (4, 1), jnp.ones((2, 33, 47), bool), 4)
    found = jax.jit(pack)(maps).texels
    monkeypatch.setattr(texture_module, "_is_native", lambda maps: False)
    np.testing.assert_array_equal(found, jax.jit(lambda maps: pack(maps))(maps).texels)


def test_a_batch_on_all_threads_is_one_after_another():
    views, textures, _ = scene(CAMERAS["radtan"])
    ys = np.random.default_rng(2).normal(size=(257, 6)) * 0.4
    together = evaluate("analytic", chart_at(ys), views, textures, 1)
    for k in (0, 100, 256):
        alone = evaluate("analytic", chart_at(ys[k]), views, textures, 1)
        for batched, single in zip(together, alone, strict=True):
            np.testing.assert_array_equal(batched[k], single)


def test_what_is_skipped_is_zero_and_the_rest_is_not():
    views, textures, _ = scene(CAMERAS["pinhole"])
    chart = chart_at(np.zeros(6))

    def one(skip):
        return chart_equations(chart, views, textures.level(0), LOSSES["tukey"], "analytic", skip)

    found = jax.jit(jax.vmap(one))(jnp.asarray([True, False]))
    assert all(np.all(np.asarray(part[0]) == 0) for part in found)
    assert all(np.any(np.asarray(part[1]) != 0) for part in found)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e30])
def test_no_pose_reads_outside_the_cost_maps(bad):
    views, textures, usable = scene(CAMERAS["fisheye"])
    broken = chart_at(np.zeros(6))._replace(T_start=jnp.full((4, 4), bad, jnp.float32))
    for path in ("analytic", "autodiff"):
        jax.block_until_ready(evaluate(path, broken, views, textures, 1))
    assert np.all(np.asarray(visible_weight(broken.T_start, views[0], usable, 2.0, "analytic")) == 0)


def test_a_path_that_is_not_possible_is_refused_in_words():
    class OwnCamera(PinholeCamera):
        pass

    camera, tukey = OwnCamera(1.0, 1.0, 0.0, 0.0, 1, 1), LOSSES["tukey"]
    assert native_kernels.use("auto", camera, tukey, jnp.float32) == "autodiff"
    assert native_kernels.use("auto", camera, LOSSES["huber"], jnp.float32) == "xla"
    with pytest.raises(SemlocError, match="no kernel for OwnCamera"):
        native_kernels.use("analytic", camera, tukey, jnp.float32)
    with pytest.raises(SemlocError, match="float32, not float64"):
        native_kernels.use("autodiff", camera, tukey, jnp.float64)


def test_damped_step_solves_the_system():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(20, 6, 6))
    H, g = (A @ A.transpose(0, 2, 1)).astype(np.float32), rng.normal(size=(20, 6)).astype(np.float32)
    size = rng.uniform(0.1, 10, 20).astype(np.float32)
    found = jax.jit(jax.vmap(native_kernels.damped_step))(H, g, size)
    expected = np.linalg.solve(H + np.eye(6) / size[:, None, None], -g[..., None])[..., 0]
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=2e-4)
    assert dataclasses.is_dataclass(native.status())


def test_sums_by_index_are_those_of_jax():
    rng = np.random.default_rng(6)
    values, index = jnp.asarray(rng.normal(size=(4, 3, 500)), jnp.float32), jnp.asarray(rng.integers(-2, 60, 500))
    summed = jax.jit(jax.vmap(sums_by_index, (0, None, None, None)), static_argnums=(2, 3))
    found, expected = (summed(values, index, 50, path) for path in PATHS)
    assert found.shape == (4, 3, 50)
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("name", CAMERAS)
def test_views_are_those_of_jax(name):
    rng = np.random.default_rng(3)
    num, capacity = 1500, 256
    p_map = rng.uniform((-5, -8, -1), (30, 8, 3), (num, 3))
    tangent = np.repeat(rng.normal(size=(num // 10, 3)), 10, axis=0)
    columns = {
        "p_map": p_map,
        "tangent_map": tangent / np.linalg.norm(tangent, axis=1, keepdims=True),
        "offset_m": np.full(num, 0.1),
        "length_m": rng.uniform(0.05, 0.3, num),
        "center_map": p_map + rng.normal(size=(num, 3)),
        "height_sigma": rng.uniform(0, 0.03, (num, 3)),
    }
    numbers = {
        "label": rng.integers(0, 9, num),
        "kind": rng.integers(0, 3, num),
        "element": np.repeat(np.arange(num // 20), 20),
    }
    samples = MapSamples(
        valid=jnp.asarray(rng.uniform(size=num) > 0.1),
        **{key: jnp.asarray(value, jnp.float32) for key, value in columns.items()},
        **{key: jnp.asarray(value, jnp.int32) for key, value in numbers.items()},
    )
    T_base_cam = mounted((1.0, 0.0, 1.5), 5.0, 3.0, 0.0) if name != "top view" else np.eye(4)
    rig = Rig([CAMERAS[name]], T_base_cam[None], ["one"])
    channel = jnp.asarray([0, 1, -1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12], jnp.int32)
    weights = tuple(np.linspace(0.5, 2.0, 14))
    config = ViewConfig(capacity, margin_share=0.1, most_alone=3.0, metric_exponent=0.3, class_weight=weights)
    T = lie.exp(jnp.asarray([0.3, -0.2, 0.1, 0.02, 0.01, 0.2], jnp.float32))
    found, expected = (
        jax.tree.map(
            lambda leaf: np.asarray(leaf)[0], seen_by(samples, T, rig, channel, replace(config, path=path), 1.2)
        )
        for path in PATHS
    )
    filled = expected.weight > 0
    assert filled.sum() > 50
    np.testing.assert_array_equal(found.weight > 0, filled)
    np.testing.assert_allclose(found.weight, expected.weight, rtol=1e-4)
    np.testing.assert_allclose(found.p_map[:, filled], expected.p_map[:, filled], atol=1e-4)
    for column in ("channel", "element", "edge", "tangent_map"):
        np.testing.assert_array_equal(getattr(found, column)[..., filled], getattr(expected, column)[..., filled])


def two_cameras(name: str):
    """Two cameras of one model that see points of their own in the same cost maps."""
    parts = [scene(CAMERAS[name], seed) for seed in (0, 5)]
    views = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *(part[0][0] for part in parts))
    return (views,), *parts[0][1:]


@pytest.mark.parametrize("name", CAMERAS)
def test_a_solve_in_one_call_takes_the_steps_of_the_solver(name, monkeypatch):
    views, textures, usable = two_cameras(name)
    T = chart_at(np.zeros(6)).pose()
    evidence = Evidence(views, textures, usable, jnp.float32(0.8))
    sigma = jnp.asarray([0.5, 0.0, 0.05, 0.02, 0.02, 0.05], jnp.float32)  # one direction is locked
    prior = Prior(T @ lie.exp(jnp.asarray([0.1, 0.0, 0.02, 0.01, 0.0, 0.02], jnp.float32)), sigma)
    config = AlignConfig(levels=(0, 1), max_steps=6)
    starts = T @ lie.exp(jnp.asarray([[x, 0.0, 0.0, 0.0, 0.0, 0.0] for x in (0.0, 0.3, -0.2)], jnp.float32))

    def solved():
        return jax.jit(jax.vmap(lambda start: refine(start, evidence, prior, config)))(starts)

    found = solved()
    monkeypatch.setattr(pose_module, "_is_in_one_call", lambda *_: False)
    expected = solved()
    np.testing.assert_allclose(found[0], expected[0], atol=2e-4)
    assert np.abs(np.asarray(expected[0][:, -1] - starts)).max() > 1e-2  # the solver went somewhere
    np.testing.assert_array_equal(found[1], expected[1])
    np.testing.assert_array_equal(found[2], expected[2])


@pytest.mark.parametrize("name", CAMERAS)
def test_sums_by_piece_are_those_of_jax(name):
    views, textures, usable = two_cameras(name)
    num = views[0].weight.shape[1]
    piece_of = jnp.asarray(np.concatenate([np.arange(num) // 30, num + np.arange(num) // 17]), jnp.int32)
    known = textures.level(1), usable, LOSSES["tukey"], 2.0
    T = chart_at(np.zeros(6)).pose()
    summed = jax.jit(lambda path: sums_by_piece(T, views, piece_of, *known, path), static_argnums=0)
    found, expected = (np.asarray(summed(path)) for path in PATHS)
    assert (expected[0] > 0).sum() > 10
    np.testing.assert_allclose(found, expected, atol=5e-3 * expected.max())
