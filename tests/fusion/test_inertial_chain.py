"""Normal equations of neighbours at once are those of every factor alone; intervals hold where they are taken."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.fusion.inertial_chain import chain_equations
from semloc_jax.fusion.inertial_graph import frame_graph, left_by_oldest
from semloc_jax.fusion.inertial_intervals import InertialInterval, stacked
from semloc_jax.fusion.inertial_states import SIZES, unknowns_of
from semloc_jax.fusion.landmark_pool import LandmarkPool
from semloc_jax.geometry import rigid
from semloc_jax.solvers.dense import dense_hessian, marginal
from tests.compiling import jit_quickly
from tests.fusion.inertial_windows import NUM, begun

_EDGES, _STATES = ("inertial", "walk", "still"), ("rolling", "wheels", "standing", "measured")


@pytest.fixture(scope="module")
def window():
    """A window that has gone on by a state, with wheels, a measured pose and a stop at its end."""
    found, moments, _ = begun(1, NUM + 1)
    found.add(moments[NUM])
    T = found.values["pose"][-1] @ rigid.exp(np.array([0.2, 0.1, -0.1, 0.01, 0.0, 0.02]))
    for k in (-2, -1):
        found.moments[k] = found.moments[k]._replace(speed_mps=9.0, is_standing=True)
    found.moments[-1] = found.moments[-1]._replace(T_measured=T, information=np.diag([3.0, 2, 1, 40, 50, 60]))
    return found


def moved(values, scale, seed):
    """The states somewhere beside."""
    rng = np.random.default_rng(seed)
    beside = {name: array + scale * rng.normal(size=array.shape) for name, array in values.items()}
    return beside | {"pose": values["pose"] @ rigid.exp(scale * rng.normal(size=(NUM, 6)))}


def both(factors, value, at):
    """Equations of a window by neighbours, and by every family of factors alone."""
    value, at = jax.tree.map(jnp.asarray, (value, at))
    graph = frame_graph(factors)
    local = graph.local(value, at)
    g = graph.gradients(local)
    gradient = jnp.concatenate([g[family.name].ravel() for family in graph.families])
    cost = sum(jnp.sum(part.cost) for part in local)
    return chain_equations(graph, value, at, NUM), (cost, gradient, dense_hessian(graph, local, graph.families))


def test_rows_of_neighbours_squared_at_once_are_the_sums_of_all_factors(window):
    _, problem, values = window._problem()
    with jax.enable_x64(True):
        values = {name: np.asarray(values[name], float) for name in SIZES}
        value, at = (moved(values, 1e-3, seed) for seed in (0, 1))
        found, (cost, g, H) = jit_quickly(both)(problem.factors, value, at)
    np.testing.assert_allclose(found.cost, cost, rtol=1e-12)
    np.testing.assert_allclose(found.gradient, g, rtol=1e-9, atol=1e-12 * np.abs(g).max())
    size = np.sqrt(np.diag(H))
    np.testing.assert_allclose(found.information / size / size[:, None], H / size / size[:, None], atol=1e-11)


@pytest.mark.parametrize("num_gone", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_what_the_oldest_leave_is_what_their_factors_and_landmarks_say(window, num_gone):
    """The same equations of the whole window, everything that binds others alone switched off."""
    _, problem, values = window._problem(solved_only=True)
    factors, views = problem.factors, problem.views

    def masked(sqrt_info):
        is_gone = np.arange(len(sqrt_info)) < num_gone
        return np.where(is_gone.reshape(-1, *(1,) * (sqrt_info.ndim - 1)), sqrt_info, 0.0)

    own = factors._replace(**{name: masked(getattr(factors, name)) for name in (*_EDGES, *_STATES)})
    is_gone = views.anchor < num_gone
    seen = views._replace(
        sqrt_info=np.where(is_gone[:, None], views.sqrt_info, 0.0), on_road=np.where(is_gone, views.on_road, 0.0)
    )
    alone = type(problem)(own, seen, problem.prior, problem.threshold)
    gone, kept = unknowns_of(np.arange(num_gone), NUM), unknowns_of(np.arange(num_gone, NUM), NUM)
    with jax.enable_x64(True):
        values = {name: jnp.asarray(array, jnp.float64) for name, array in values.items()}
        found = jit_quickly(lambda p, v: left_by_oldest(p, v, num_gone))(problem, values)
        whole = jit_quickly(lambda p, v: p.linearise(v, jnp.asarray(False)).reduced())(alone, values)
        expected = marginal(whole, gone, kept)
    size = np.abs(np.asarray(expected.information)).max()
    assert size > 1e3
    np.testing.assert_allclose(found.information, expected.information, atol=1e-9 * size)
    np.testing.assert_allclose(found.gradient, expected.gradient, atol=1e-9 * np.abs(expected.gradient).max())


def test_what_leaves_is_taken_from_the_last_solve_less_the_landmarks_let_go():
    """The problem that is not put together again is the one that would be."""
    window, moments, _ = begun(1, NUM + 1)
    step_px = window.step_px
    window.add(moments[NUM])
    window.step_px = step_px  # that of the solve, not what it has taught since
    gone = window._last[0][:2]
    window.pool.keep(gone, window.pool.value[gone] + [0.0, 0.0, np.nan], np.zeros(2, bool))
    rows, problem, values = window._solved_problem()
    window._last = None
    again, other, other_values = window._problem(solved_only=True)
    assert set(rows) == set(again) and not set(rows) & set(gone) and len(rows) > 5
    assert np.isfinite(values["landmark"]).all()
    with jax.enable_x64(True):
        left = jit_quickly(lambda p, v: left_by_oldest(p, v, 1))
        found, expected = left(problem, values), left(other, other_values)
    size = np.abs(np.asarray(expected.information)).max()
    np.testing.assert_allclose(found.information, expected.information, atol=1e-6 * size)
    # Gradients differ by that of the bend alone, whose share left follows the way as it was before the solve.


def test_a_full_pool_takes_as_many_tracks_as_it_has_rows():
    _, moments, _ = begun(1, NUM + 1)
    tracks, pool = moments[0].tracks, LandmarkPool(7, NUM)
    pool.add(tracks, 0)
    assert pool.seen[:, 0].all() and set(pool.id) < set(tracks.id)
    held = np.isin(tracks.id, pool.id)
    pool.add(tracks, 1)
    assert pool.seen[:, 1].all(), "those that are there go on"
    np.testing.assert_array_equal(pool.ray_cam[np.argsort(pool.id), 1], tracks.sight.ray_cam[held])


def test_an_interval_holds_at_biases_a_little_off_and_is_made_anew_beyond(window):
    """Taken at other biases it says what one made there says, to less than a thousandth of what noise does."""
    steps, noise = window.moments[-1].steps, window.noise
    first = InertialInterval.of(steps, np.zeros(6), noise)
    near, far = np.repeat([4.9e-4, 0.049], 3), np.repeat([6e-4, 0.0], 3)
    assert first.holds(steps, near) and not first.holds(steps, far) and not first.holds(window.moments[-2].steps, near)
    there = InertialInterval.of(steps, near, noise)
    with jax.enable_x64(True):
        corrected = jit_quickly(lambda moved: moved.corrected(jnp.asarray(near)))
        (R, *rest), (R_there, *rest_there) = (corrected(one.moved) for one in (first, there))
        T = np.eye(4)
        T[:3, :3] = np.asarray(R).T @ np.asarray(R_there)
    off = np.concatenate([rigid.log(T)[3:], *(np.asarray(a - b) for a, b in zip(rest, rest_there, strict=True))])
    assert np.abs(there.root @ off).max() < 1e-3
    # What is left out would show if it were not corrected at all.
    assert np.abs(there.root @ (np.asarray(first.moved.by_bias) @ near)).max() > 0.1


def test_intervals_of_a_solve_are_those_of_the_one_before(window):
    window._problem()
    before = list(window._intervals.values())
    window._problem()
    assert all(a is b for a, b in zip(before, window._intervals.values(), strict=True))
    assert stacked(before)[1].shape == (NUM - 1, 9, 9)
