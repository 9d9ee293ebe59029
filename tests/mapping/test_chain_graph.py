"""The way of a drive tied down: against dense least squares, false loops, fixes, covariances, a rendered drive.

Drives and numbers of loops are of one size, so that few programs are compiled.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from semloc_jax.datasets import read_drive
from semloc_jax.datasets.sensors import GnssTrack
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import lie, rigid
from semloc_jax.mapping.chain import Chain, drive_chain
from semloc_jax.mapping.chain_graph import NO_LOOPS, ChainGraphConfig, Loops, Start, chain_graph, solve_chain
from semloc_jax.solvers.levenberg_marquardt import SolveConfig
from semloc_jax.solvers.sparse import SparseProblem
from tests.compiling import jit_quickly

EXACT = ChainGraphConfig(solve=SolveConfig(tolerance=1e-9, max_steps=100))
SIGMA = np.array([0.02, 0.01, 0.01, 0.001, 0.001, 0.003])
LOOP_SIGMA = np.array([0.05, 0.03, 0.05, 0.005, 0.005, 0.003])
SCALE, TRAVEL = 1.02, 0.004
WANDER, MEMORY = 0.002, 5
"""What is left of the gyro bias turns each step by so much [rad], and stays the same for so many."""


def true_poses(num, lap):
    angle = np.arange(num) * 2 * np.pi / lap
    radius = 2.0 * lap / (2 * np.pi)
    rows = [(radius * np.sin(a), radius * (1 - np.cos(a)), a, 0.3 * np.sin(3 * a)) for a in angle]
    return np.array([rigid.planar_pose(*row) for row in rows])


NUM, LAP, LOOPS = 28, 10, [(k, k + 10) for k in range(12)]


def wander(num, seed):
    """A bias that wanders, in standard deviations."""
    rng, kept = np.random.default_rng([seed, 1]), np.exp(-1.0 / MEMORY)
    left = [rng.normal()]
    while len(left) < num:
        left.append(kept * left[-1] + np.sqrt(1.0 - kept**2) * rng.normal())
    return np.array(left)


def made_chain(num=NUM, lap=LAP, seed=0, scale=SCALE):
    """Rounds whose wheels are off by a scale and roll a little askew, and the true poses."""
    rng = np.random.default_rng(seed)
    poses = true_poses(num, lap)
    steps = rigid.inverse(poses[:-1]) @ poses[1:]
    jacobian = np.zeros((num - 1, 6, 3))
    jacobian[:, 0, 0], jacobian[:, 5, 1], jacobian[:, 1, 2] = 2.0, 2 * np.pi / lap, 2.0
    off = jacobian @ np.array([1.0 - scale, 0.0, -TRAVEL]) + SIGMA * rng.normal(size=(num - 1, 6))
    off[:, 5] += WANDER * wander(num - 1, seed)
    measured = steps @ rigid.exp(off)
    Ts = [poses[0]]
    for step in measured:
        Ts.append(Ts[-1] @ step)
    chain = Chain(
        times_s=0.2 * np.arange(num),
        Ts_odom_base=np.array(Ts),
        steps_covariance=np.tile(np.diag(SIGMA**2), (num - 1, 1, 1)),
        steps_jacobian=jacobian,
        steps_by_wander=np.tile([0.0, 0.0, 0.0, 0.0, 0.0, -WANDER], (num - 1, 1)),
        wander_memory_s=0.2 * MEMORY,
        calibration=np.array([1.0, 1.0, 0.0]),
        calibration_sigma=np.array([0.03, 1e-3, 0.01]),
        way_m=2.0 * np.arange(num),
        tilt_sigma_rad=np.full(num, 0.05),
        gyro_bias_radps=np.zeros((num, 3)),
    )
    return chain, poses


def measured_loops(poses, ends, seed=1):
    rng = np.random.default_rng(seed)
    a, b = np.array(ends).T
    Ts = rigid.inverse(poses[a]) @ poses[b] @ rigid.exp(LOOP_SIGMA * rng.normal(size=(len(a), 6)))
    return Loops(a, b, Ts, np.tile(np.diag(LOOP_SIGMA**2), (len(a), 1, 1)))


def dense_optimum(graph, values):
    """Poses, calibration and covariance by scipy over one vector of all tangents."""
    num = len(values["pose"])
    split = 6 * num

    def at(x, values):
        poses = lie.compose(values["pose"], lie.exp(x[:split].reshape(num, 6)))
        odometer, gnss = values["odometer"] + x[split : split + 3], values["gnss"] + x[split + 3 : split + 5]
        return {"pose": poses, "odometer": odometer, "gnss": gnss, "wander": values["wander"] + x[split + 5 :, None]}

    def residuals(x, values):
        values = at(x, values)
        return jnp.concatenate([factors.residuals(values).ravel() for factors in graph.factors])

    values_at, rows, slopes = jit_quickly(at), jit_quickly(residuals), jit_quickly(jax.jacfwd(residuals))
    for _ in range(2):  # the second time from the optimum: its tangents are those of the covariance
        found = least_squares(rows, np.zeros(split + 5 + num), slopes, x_scale="jac", xtol=1e-12, args=(values,))
        values = jax.tree.map(np.asarray, values_at(found.x, values))
    return values, np.linalg.inv(found.jac.T @ found.jac)


def test_poses_and_covariances_are_those_of_dense_least_squares():
    chain, poses = made_chain()
    loops = measured_loops(poses, LOOPS)
    start = Start(poses[0], np.diag(np.repeat([0.01, 0.001], 3) ** 2))
    found = solve_chain(chain, loops, start=start, config=EXACT)
    assert found.is_kept.all()
    graph, values = chain_graph(chain, chain.Ts_odom_base, start, loops, None, EXACT)
    best, covariance = dense_optimum(graph, values)
    np.testing.assert_allclose(found.Ts_map_base, best["pose"], atol=2e-6)
    np.testing.assert_allclose(found.calibration, best["odometer"][0], atol=1e-6)
    rows = np.r_[18:24, 54:60]
    sigma = np.sqrt(np.diag(covariance)[rows])
    by_sigma = found.covariance(np.array([3, 9])) / np.outer(sigma, sigma)
    # Gauss-Newton takes the derivative of the calibration to first order in its change, 2 %.
    np.testing.assert_allclose(by_sigma, covariance[np.ix_(rows, rows)] / np.outer(sigma, sigma), atol=1e-3)


def test_one_more_loop_rarely_makes_another_program():
    """It makes one where the room for blocks is another; of that an eighth at most is spare."""
    chain, poses = made_chain()
    start, rooms = Start(poses[0], np.diag(np.repeat([0.01, 0.001], 3) ** 2)), set()
    for num in range(1, 13):
        graph, _ = chain_graph(chain, poses, start, measured_loops(poses, LOOPS[:num]), None, EXACT)
        pattern = SparseProblem(graph).pattern
        rooms.add(pattern.num_entries)
        assert 1.0 <= pattern.num_entries / (pattern.matrix.data.max() + 1) <= 1.125
    assert len(rooms) <= 3


def test_a_relative_covariance_is_that_of_many_drives():
    """Sigmas of T_a_b by the graph of one drive against the scatter of what 200 noisy drives say of it."""
    a, b, off = 4, 12, []
    for seed in range(200):
        chain, poses = made_chain(seed=seed, scale=1.0)
        Ts = chain.Ts_odom_base
        off.append(rigid.log(rigid.inverse(rigid.inverse(poses[a]) @ poses[b]) @ rigid.inverse(Ts[a]) @ Ts[b]))
    known = chain._replace(calibration_sigma=np.full(3, 1e-6), tilt_sigma_rad=np.full(NUM, 10.0))
    said = np.sqrt(np.diagonal(solve_chain(known).relative_covariance([a], [b])[0]))
    np.testing.assert_allclose(np.std(off, axis=0) / said, 1.0, atol=0.2)


def test_scale_is_found_where_loops_and_a_known_place_tell_it():
    """Loops alone cannot tell the scale; fixes can."""
    chain, poses = made_chain()
    rng = np.random.default_rng(3)
    fixes = poses[:, :3, 3] + [3.0, -2.0, 5.0] + 0.1 * rng.normal(size=(NUM, 3))
    fixes[7] += [30.0, 10.0, 0.0]
    gnss = GnssTrack(chain.times_s, fixes + [1000.0, 2000.0, 0.0], np.full((NUM, 3), 0.1))
    config = ChainGraphConfig(gnss_memory_s=0.2, solve=EXACT.solve)
    found = solve_chain(chain, measured_loops(poses, LOOPS), gnss, config=config)
    assert found.calibration[0] == pytest.approx(SCALE, abs=0.003)
    off = found.Ts_map_base[:, :2, 3] + found.gnss_offset_m - (poses[:, :2, 3] + [1003.0, 1998.0])
    assert np.linalg.norm(off, axis=1).max() < 0.25
    turned = rigid.log(rigid.inverse(poses) @ found.Ts_map_base)[:, 5]
    assert np.degrees(np.abs(turned)).max() < 0.7


def test_false_loops_among_true_ones_are_let_go_of():
    """Four of twelve lead to a twin of the place, one bay further."""
    chain, poses = made_chain(scale=1.0)
    loops, is_false = measured_loops(poses, LOOPS), np.arange(12) % 3 == 1
    loops.Ts_a_b[is_false] = loops.Ts_a_b[is_false] @ rigid.exp(np.array([2.5, 0.0, 0.0, 0.0, 0.0, 0.0]))
    found = solve_chain(chain, loops, config=EXACT)
    np.testing.assert_array_equal(found.is_kept, ~is_false)
    assert found.loop_nats[is_false].min() > 8.4 > found.loop_nats[~is_false].max()
    loops.covariance[is_false] = 1e12 * np.eye(6)
    alone = solve_chain(chain, loops, config=EXACT)
    np.testing.assert_allclose(found.Ts_map_base, alone.Ts_map_base, atol=1e-5)
    open_end = np.linalg.norm((solve_chain(chain).Ts_map_base - poses)[:, :2, 3], axis=1).max()
    closed = np.linalg.norm((found.Ts_map_base - poses)[:, :2, 3], axis=1).max()
    assert closed < 0.5 * open_end


def test_without_anything_the_chain_is_as_it_was():
    chain, _ = made_chain()
    found = solve_chain(chain)
    np.testing.assert_allclose(found.Ts_map_base, chain.Ts_odom_base, atol=1e-6)
    assert len(found.is_kept) == 0


def test_wrong_input_is_named():
    chain, poses = made_chain()
    with pytest.raises(SemlocError, match=r"frames \[3, 40\] of a chain of 28"):
        solve_chain(chain, measured_loops(poses, [(3, 4)])._replace(b=np.array([40])))
    late = GnssTrack(chain.times_s + 1e4, np.zeros((NUM, 3)), np.ones((NUM, 3)))
    with pytest.raises(SemlocError, match="satellite fixes: 0 in the time"):
        solve_chain(chain, NO_LOOPS, late)


@pytest.mark.slow
def test_true_loops_and_fixes_of_a_rendered_road(data_dir):
    """Loops at true places of the second lap, and biased fixes alone, bound what a closed way can reach."""
    if not (data_dir / "loop_seed2").is_dir():
        pytest.skip(f"no drive loop_seed2 in {data_dir}")
    drive = read_drive(data_dir / "loop_seed2")
    chain = drive_chain(drive)
    poses = drive.truth.interpolate(chain.times_s)
    half = len(poses) // 2
    b = np.arange(half + 20, len(poses) - 1, 25)
    distance = np.linalg.norm(poses[b][:, None, :3, 3] - poses[None, : half - 20, :3, 3], axis=2)
    near = distance.min(axis=1) < 6.0
    loops = measured_loops(poses, np.column_stack([distance.argmin(axis=1)[near], b[near]]))
    start = Start(poses[0], np.diag(np.repeat([0.01, 0.002], 3) ** 2))
    closed = solve_chain(chain, loops, start=start)
    assert closed.is_kept.all()
    assert np.linalg.norm((closed.Ts_map_base - poses)[:, :2, 3], axis=1).mean() < 1.5
    tied = solve_chain(chain, loops, drive.gnss)
    off = tied.Ts_map_base[:, :2, 3] - poses[:, :2, 3]
    assert np.linalg.norm(off - off.mean(axis=0), axis=1).mean() < 0.5
    assert abs(tied.calibration[0] - 1.01478) < 0.002
