"""A solve of the window ends, and where scipy ends on the same cost, though states are held at first estimates."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from semloc_jax.fusion.inertial_graph import WindowProblem, frame_graph
from semloc_jax.fusion.inertial_prior import WindowPrior, first_prior
from semloc_jax.fusion.inertial_sights import step_residuals
from semloc_jax.fusion.inertial_states import KINDS, SIZES, families_of
from semloc_jax.fusion.inertial_window import InertialWindow
from semloc_jax.geometry import rigid
from semloc_jax.residuals.motion import cauchy_cost
from semloc_jax.solvers.graph import split
from tests.fusion.inertial_windows import CONFIG, NUM, difference, sigma_of
from tests.fusion.inertial_world import World, near

_HELD = 4
_GONE_M = np.array([0.6, 0.3, 0.1])


def window_that_goes_somewhere() -> InertialWindow:
    """A solved window, of whose place only a pose now tells, 0.7 m away; held states have turned by some milliradians
    since they were first estimated, as they do on drives."""
    moments, truth = World(seed=3, num_slots=40).moments(NUM)
    values, sigma = near(truth, NUM, 0.2, 3), sigma_of(CONFIG)
    sigma[:3] = 1.0
    values["scale"][:], values["mount"][:], values["delay"][:] = 1.0, 0.0, 0.0
    window = InertialWindow.of(moments, values, first_prior(values, sigma, values["pose"][0, :3, :3]), CONFIG)
    for _ in range(3):
        window.solve()
    T = window.values["pose"][-1].copy()
    T[:3, 3] += _GONE_M
    information = np.diag(np.repeat([0.3, 0.1], 3) ** -2.0)
    window.moments[-1] = moments[-1]._replace(T_measured=T, information=information)
    turned, prior = np.zeros((NUM, 6)), window.prior
    turned[:_HELD, 3:] = 3e-3 * np.random.default_rng(0).normal(size=(_HELD, 3))
    first = prior.first | {"pose": window.values["pose"] @ rigid.exp(turned)}
    window.prior = WindowPrior(first, prior.touched, np.arange(NUM) < _HELD, prior.gradient, prior.information)
    return window


def beside(start: dict, x: jax.Array) -> dict:
    """The values after a step `x` of all unknowns, each along its own axes."""
    num = NUM * sum(SIZES.values())
    steps = split(x[:num], families_of(NUM))
    moved = {name: kind.retract(start[name], steps[name]) for name, kind in KINDS.items()}
    return moved | {"landmark": start["landmark"] + x[num:].reshape(-1, 3)}


def bent(r: jax.Array, cost: jax.Array) -> jax.Array:
    """The residual, so long that half its square is its robust cost."""
    square = jnp.sum(r * r)
    is_there = square > 1e-20
    return r * jnp.where(is_there, jnp.sqrt(2.0 * cost / jnp.where(is_there, square, 1.0)), 1.0)


def residuals_of(problem: WindowProblem, start: dict, x: jax.Array) -> jax.Array:
    """Whitened residuals, half whose square is the cost of the window, of all unknowns `x` beside `start`."""
    value = beside(start, x)
    H = problem.prior.information
    parts = [jnp.linalg.cholesky(H + 1e-9 * jnp.eye(len(H))).T @ problem.prior.deviation(value)]
    for factors in frame_graph(problem.factors).factors:
        parts.append(jax.vmap(bent)(factors.residuals(value), factors.costs(value)).ravel())
    steps = step_residuals(problem.views, value).reshape(-1, 2)
    parts.append(jax.vmap(lambda r: bent(r, cauchy_cost(r + 1e-12, problem.threshold)[0]))(steps).ravel())
    return jnp.concatenate(parts)


@pytest.mark.slow
def test_a_window_that_goes_somewhere_as_a_whole_gets_there_and_ends():
    """Steps that tear it were refused to the limit, and it stayed where it was."""
    window = window_that_goes_somewhere()
    before = window.state(-1).T_map_base[:3, 3]
    estimate = window.solve()
    assert estimate.num_steps <= 5 < CONFIG.max_steps
    assert np.linalg.norm(estimate.state.T_map_base[:3, 3] - before) > 0.5


@pytest.mark.slow
def test_a_solve_ends_where_scipy_ends_on_the_same_cost():
    window = window_that_goes_somewhere()
    _, problem, values = window._problem()
    estimate = window.solve()
    with jax.enable_x64(True):
        start = {name: jnp.asarray(array, jnp.float64) for name, array in values.items()}
        residuals = jax.jit(lambda x: residuals_of(problem, start, x))
        slopes = jax.jit(jax.jacfwd(lambda x: residuals_of(problem, start, x)))
        zero = np.zeros(NUM * sum(SIZES.values()) + values["landmark"].size)
        found = least_squares(residuals, zero, slopes, x_scale="jac", max_nfev=60)
        best = jax.device_get(beside(start, jnp.asarray(found.x)))
    assert found.success
    assert estimate.cost < found.cost + 0.5, "nats above the least"
    off = difference(estimate.state, best, NUM - 1)
    seen = np.diag(estimate.covariance) > 1e-9
    assert np.abs(off[seen] / np.sqrt(np.diag(estimate.covariance)[seen])).max() < 0.3


@pytest.mark.slow
def test_a_step_of_the_whole_window_tears_nothing_apart():
    """Held states go along the axes in which their derivatives were taken: what the inertial sensor says stays."""
    window = window_that_goes_somewhere()
    _, problem, values = window._problem()
    with jax.enable_x64(True):
        value = {name: jnp.asarray(array, jnp.float64) for name, array in values.items()}
        at = problem.prior.slopes_at(value)
        tangent = {name: jnp.zeros((NUM, size)) for name, size in SIZES.items()}
        tangent["pose"] = tangent["pose"].at[:, :3].set(jnp.einsum("fji,j->fi", at["pose"][:, :3, :3], _GONE_M))
        moved = problem.retract(value, tangent | {"landmark": jnp.zeros_like(value["landmark"])})
        inertial = frame_graph(problem.factors).factors[0]
        np.testing.assert_allclose(moved["pose"][:, :3, 3], value["pose"][:, :3, 3] + _GONE_M, atol=1e-12)
        np.testing.assert_allclose(inertial.residuals(moved), inertial.residuals(value), atol=1e-6)
