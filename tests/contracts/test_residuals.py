"""What the alignment residual promises with every camera model and with a mixed rig: one contract for all."""

from dataclasses import replace
from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.alignment.pose import AlignConfig, Prior, level_problem
from semloc_jax.alignment.problem import quadratic_model, residual
from semloc_jax.geometry import lie, rigid
from semloc_jax.residuals.alignment import alignment_residual, camera_views, points_in_camera
from semloc_jax.residuals.normal_equations import normal_equations
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.residuals.scoring import decimated, robust_cost
from tests.compiling import jit_quickly
from tests.contracts.ground_scene import RIGS, STRIDE, samples_of, scene

NUM = 400
OFF = np.array([0.12, -0.07, 0.015, 0.004, -0.003, 0.012])
"""A pose error that leaves most samples on their ramps."""
FAR = {
    "turned round": np.array([0.0, 0, 0, 0, 0, 3.1]),
    "all behind": np.array([200.0, 0, 0, 0, 0, 0]),
    "ten kilometres up": np.array([0.0, 0, 1e4, 0, 0, 0]),
    "rolled over": np.array([0.0, 0, 0, 1.5, 1.2, 0.3]),
}
TUKEY = LOSSES["tukey"]

world_of = cache(scene)
compiled_residual = eqx.filter_jit(alignment_residual)
compiled_normal_equations = eqx.filter_jit(normal_equations)
compiled_cost = eqx.filter_jit(robust_cost)


@jit_quickly
def compiled_jacobian(T_map_base, views, texture):
    def value(step):
        return alignment_residual(T_map_base @ lie.exp(step), views, texture)[0]

    return jax.jacfwd(value)(jnp.zeros(6, T_map_base.dtype))


@jit_quickly
def gradients(y, problem):
    """Cost and gradient of half the squared residual by reverse mode, and the fused model."""
    return jax.value_and_grad(lambda y: 0.5 * jnp.sum(residual(y, problem) ** 2))(y), quadratic_model(y, problem)


@pytest.fixture(params=RIGS, ids=str)
def rig_name(request):
    return request.param


def at(world, xi, level=1):
    """Residual and weight of the true pose moved by xi."""
    parts = compiled_residual(world.moved(xi), world.views, world.textures.level(level))
    return tuple(np.asarray(part) for part in parts)


def jacobian(world, xi):
    """d r / d xi [n 6] in the right tangent, by forward mode through every operation."""
    return np.asarray(compiled_jacobian(world.moved(xi), world.views, world.textures.level(1)))


def fused(world, xi, loss=TUKEY):
    return compiled_normal_equations(world.moved(xi), world.views, world.textures.level(1), loss)


def pixels(world, xi):
    """Pixels u, v of every sample in the order of the residual."""
    return np.asarray(compiled_pixels(world.moved(xi), world.views))


@jit_quickly
def compiled_pixels(T_map_base, views):
    parts = []
    for view in views:
        for k in range(len(view.index)):
            camera = jax.tree.map(lambda leaf, k=k: leaf[k], view.camera)
            p_cam = points_in_camera(view.T_cam_base[k], T_map_base, view.p_map[k])
            parts.append(jnp.stack(camera.project_xyz(*p_cam)[:2]))
    return jnp.concatenate(parts, axis=1)


def close(given, expected, rtol):
    """Equal to within rtol of the largest entry."""
    given, expected = np.asarray(given, np.float64), np.asarray(expected, np.float64)
    return np.abs(given - expected).max() <= rtol * np.abs(expected).max()


@pytest.mark.parametrize("level", [0, 1])
def test_zero_at_the_truth_and_not_beside_it(rig_name, level):
    """A texel is 1/127 of the ramp; curvature between texels adds to it where the view is flat."""
    world = world_of(rig_name)
    r, weight = at(world, np.zeros(6), level)
    assert np.quantile(np.abs(r[weight > 0]), 0.95) < 0.015
    assert np.abs(r[weight > 0]).max() < 0.05
    moved, _ = at(world, OFF, level)
    assert np.mean(np.abs(moved[weight > 0])) > 0.04


def test_derivative_is_a_central_difference(rig_name):
    world, step = world_of(rig_name), 1e-6
    moved = [[rigid.log(rigid.exp(OFF) @ rigid.exp(s * e)) for s in (step, -step)] for e in np.eye(6)]
    numeric = np.stack([(at(world, ahead)[0] - at(world, back)[0]) / (2 * step) for ahead, back in moved], axis=-1)
    exact = jacobian(world, OFF)
    # Between texels the bilinear surface has a kink: there are two derivatives, and differences see their mean.
    share = np.mod((pixels(world, OFF) + 0.5) / STRIDE[1] - 0.5, 1.0)
    smooth = np.all(np.abs(share - 0.5) < 0.49, axis=0)
    assert smooth.mean() > 0.9
    assert np.abs(numeric - exact)[smooth].max() < 1e-6 * np.abs(exact).max()


def assert_fused_is_dense(name, loss):
    world = world_of(name)
    r, weight = at(world, OFF)
    J = jacobian(world, OFF)
    w, rho = jax.tree.map(np.asarray, jit_quickly(lambda r: (loss.weight(r), loss.rho(r)))(r))
    w = weight * w
    given = fused(world, OFF, loss)
    assert close(given.hessian, J.T @ (w[:, None] * J), 1e-9)
    assert close(given.gradient, J.T @ (w * r), 1e-9)
    assert float(given.cost) == pytest.approx(float(weight @ rho), rel=1e-12)


def test_fused_normal_equations_are_the_dense_ones(rig_name):
    assert_fused_is_dense(rig_name, TUKEY)


@pytest.mark.parametrize("loss", sorted(set(LOSSES) - {"tukey"}))
def test_fused_normal_equations_with_every_loss(loss):
    assert_fused_is_dense("radtan", LOSSES[loss])


def test_fused_normal_equations_in_float32(rig_name):
    short, exact = fused(world_of(rig_name, NUM, np.float32), OFF), fused(world_of(rig_name), OFF)
    assert short.hessian.dtype == np.float32
    # A sample that rounds to the next texel takes its slope; that moves sums of hundreds by parts in ten thousand.
    assert close(short.hessian, exact.hessian, 2e-3)
    assert close(short.gradient, exact.gradient, 2e-3)
    assert float(short.cost) == pytest.approx(float(exact.cost), rel=1e-4)


@pytest.mark.parametrize(("name", "loss"), [("radtan", "tukey"), ("radtan", "huber"), ("mixed", "tukey")])
def test_quadratic_model_has_the_gradient_of_the_residual(name, loss):
    """The fused gradient is that of half the squared residual, away from the origin of the chart too."""
    world = world_of(name)
    prior = world.prior(-0.5 * OFF)
    problem = level_problem(world.moved(OFF), world.views, 1, world.evidence, prior, AlignConfig(loss=loss))
    (cost, gradient), model = gradients(jnp.array([0.05, -0.1, 0.2, 0.3, -0.2, 0.1]), problem)
    assert float(model.cost) == pytest.approx(float(cost), rel=1e-10)
    assert close(model.gradient, gradient, 1e-8)
    assert np.linalg.eigvalsh(model.hessian).min() > 0.999  # the prior alone is 1


def test_what_padding_holds_changes_nothing(rig_name):
    """Samples of weight 0 anywhere, behind the cameras too, add nothing to cost, gradient or Hessian."""
    samples = samples_of(rig_name)
    anywhere = np.random.default_rng(3).uniform(-60, 60, samples.p_map.shape)
    is_padding = np.asarray(samples.weight == 0)
    assert 0.05 < is_padding.mean() < 0.2
    p_map = np.where(is_padding[:, None, :], anywhere, samples.p_map)
    other = scene(rig_name, samples=eqx.tree_at(lambda s: s.p_map, samples, jnp.asarray(p_map)))
    for given, expected in zip(fused(other, OFF), fused(world_of(rig_name), OFF), strict=True):
        assert close(given, expected, 1e-12)


def test_order_of_samples_changes_nothing(rig_name):
    samples = samples_of(rig_name)
    order = np.random.default_rng(4).permutation(NUM)
    plain, mixed_up = world_of(rig_name), scene(rig_name, samples=jax.tree.map(lambda leaf: leaf[..., order], samples))
    for given, expected in zip(fused(mixed_up, OFF), fused(plain, OFF), strict=True):
        assert close(given, expected, 1e-12)
    # The residual lists camera after camera.
    assert np.array_equal(at(mixed_up, OFF)[0].reshape(-1, NUM), at(plain, OFF)[0].reshape(-1, NUM)[:, order])


def test_float32_is_close_to_float64(rig_name):
    short, _ = at(world_of(rig_name, NUM, np.float32), OFF)
    exact, _ = at(world_of(rig_name), OFF)
    assert short.dtype == np.float32
    # 30 m from the local origin a float32 coordinate is good to 2 um; a hundredth of a pixel is 0.002 of the ramp.
    assert np.abs(short - exact).max() < 2e-3
    assert np.abs(short - exact).mean() < 5e-5


@pytest.mark.parametrize(("dtype", "num"), [(np.float64, 16385), (np.float32, 32769)])
def test_compiled_is_right_beyond_the_sizes_that_have_failed(dtype, num):
    """jax 0.10.2 computes wrong values above 16384 (float64) and 32768 (float32) rows."""
    world = scene("mixed", num, dtype)
    # Against parts of the size of all other tests here, which share their programs.
    parts = list(parts_of(world, num, NUM))
    by_parts = np.concatenate([at(part, OFF)[0].reshape(-1, NUM) for part in parts], axis=1)[:, :num]
    tolerance = 1e-9 if dtype == np.float64 else 2e-3
    assert np.abs(at(world, OFF)[0].reshape(-1, num) - by_parts).max() < tolerance
    # The sums, against those of the parts.
    sums = [fused(part, OFF) for part in parts]
    for given, *expected in zip(fused(world, OFF), *sums, strict=True):
        # 2e4 additions in float32 round to some 1e-5; the fault that is looked for loses whole blocks of rows.
        assert close(given, np.sum(np.asarray(expected, np.float64), axis=0), 1e-10 if dtype == np.float64 else 1e-4)


def parts_of(world, num, size):
    """The scene with `size` samples of each camera at a time, the last part padded."""
    for start in range(0, num, size):
        views = []
        for view in world.views:
            parts = {}
            for name in ("p_map", "tangent_map", "channel", "weight", "edge"):
                part = np.asarray(getattr(view, name))[..., start : start + size]
                wanting = [(0, 0)] * (part.ndim - 1) + [(0, size - part.shape[-1])]
                parts[name] = jnp.asarray(np.pad(part, wanting))
            views.append(replace(view, **parts))
        yield eqx.tree_at(lambda s: s.views, world, tuple(views))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("place", FAR)
def test_value_and_derivatives_are_finite_anywhere(rig_name, place, dtype):
    world = world_of(rig_name, NUM, dtype)
    r, _ = at(world, FAR[place])
    assert np.isfinite(r).all() and np.abs(r).max() <= 1.0 + 1e-6
    assert all(np.isfinite(part).all() for part in fused(world, FAR[place]))
    if dtype == np.float64:
        assert np.isfinite(jacobian(world, FAR[place])).all()


@pytest.mark.parametrize("name", ["radtan", "mixed"])
def test_a_pose_without_rotation_has_a_derivative(name):
    """The logarithm and the chart at the identity are where naive code divides zero by zero."""
    world = world_of(name)
    problem = level_problem(
        jnp.eye(4), world.views, 1, world.evidence, Prior(jnp.eye(4), world.sigma), AlignConfig(loss="tukey")
    )
    (cost, gradient), model = gradients(jnp.zeros(6), problem)
    assert np.isfinite(cost) and np.isfinite(gradient).all()
    assert np.isfinite(model.gradient).all() and np.isfinite(model.hessian).all()


def test_the_score_is_the_loss_over_what_is_visible(rig_name):
    world = world_of(rig_name)
    texture = world.textures.level(1)

    def cost_of(views):
        return compiled_cost(world.moved(OFF), views, texture, world.usable, TUKEY, 2.0)

    cost = cost_of(world.views)
    r, weight = at(world, OFF)
    u, v = pixels(world, OFF)
    size = [np.repeat(np.asarray([v.camera.width, v.camera.height]), NUM, axis=1) for v in world.views]
    width, height = np.concatenate(size, axis=1)
    inside = (u >= 1.5) & (v >= 1.5) & (u <= width - 2.5) & (v <= height - 2.5)
    rho = np.asarray(jit_quickly(TUKEY.rho)(r))
    assert float(cost.visible) == pytest.approx(weight[inside].sum(), rel=1e-9)
    assert float(cost.summed) == pytest.approx(6 * (weight * rho)[inside].sum(), rel=1e-9)


def test_every_other_sample_scores_about_the_same():
    world = world_of("mixed")
    texture = world.textures.level(1)
    whole, half = (
        compiled_cost(world.moved(OFF), decimated(world.views, k), texture, world.usable, TUKEY, 2.0) for k in (1, 2)
    )
    assert float(half.visible) == pytest.approx(float(whole.visible), rel=0.05)
    assert float(half.summed) == pytest.approx(float(whole.summed), rel=0.1)


def test_views_group_the_mixed_rig_by_model_and_keep_its_places():
    views = camera_views(RIGS["mixed"], samples_of("mixed", 50))
    assert [type(view.camera).__name__ for view in views] == ["BrownConradyCamera", "KannalaBrandtCamera", "BevCamera"]
    assert [int(view.index[0]) for view in views] == [0, 1, 2]
