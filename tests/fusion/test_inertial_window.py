"""The window of inertial states: exact without noise, honest with it, blind to yaw and position; as in gtsam."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.evaluation.integrity import nees, normalised_squares
from semloc_jax.fusion.inertial_moment import InertialWindowConfig
from semloc_jax.fusion.inertial_prior import WindowPrior, first_prior
from semloc_jax.fusion.inertial_start import InertialStartConfig, started
from semloc_jax.fusion.inertial_states import AT, SIZES, STATE, unknowns_of
from semloc_jax.fusion.inertial_window import InertialWindow
from semloc_jax.fusion.landmark_pool import RoadBeliefs, _road_weights
from semloc_jax.fusion.seen_velocity import seen_velocity
from semloc_jax.geometry import rigid
from semloc_jax.residuals.inverse_depth import on_road_residual
from semloc_jax.structs import InertialNoise
from tests.fusion.inertial_windows import CONFIG, NUM, SIGMA, begun, difference
from tests.fusion.inertial_world import World


@jax.jit
def reduced(problem, values):
    """Information on the states with all landmarks eliminated, and where its derivatives were taken."""
    values = jax.tree.map(jnp.asarray, values)
    left = problem.linearise(values, jnp.asarray(False)).reduced()
    return left.information, problem.prior.slopes_at(values)


def information(window):
    """`reduced` of a window as it is."""
    _, problem, values = window._problem()
    return jax.device_get(reduced(problem, values))


def gauge(at):
    """Directions that no camera and no inertial sensor can see: yaw and position of the whole, [unknowns 4]."""
    up, N = np.array([0.0, 0.0, 1.0]), np.zeros((STATE * NUM, 4))
    for k in range(NUM):
        own = unknowns_of(np.array([k]), NUM)
        T, v = np.asarray(at["pose"][k]), np.asarray(at["velocity"][k])
        N[own[:3], 0], N[own[3:6], 0] = T[:3, :3].T @ np.cross(up, T[:3, 3]), T[:3, :3].T @ up
        N[own[AT["velocity"]], 0] = np.cross(up, v)
        N[own[:3], 1:] = T[:3, :3].T
    return N


def test_without_noise_the_way_is_exact():
    window, moments, truth = begun(0, NUM + 5, noise=0.0)
    for k in range(NUM, NUM + 5):
        estimate = window.add(moments[k])
        off = difference(estimate.state, truth, k)
        assert np.abs(off[:3]).max() < 5e-3 and np.rad2deg(np.abs(off[3:6])).max() < 0.01
        assert np.abs(off[AT["velocity"]]).max() < 0.01 and estimate.num_landmarks > 10


def test_yaw_and_position_gain_no_information_before_and_after_marginalisation():
    """Without a prior on the first pose: H N = 0 though states move between their first and later estimates."""
    window, moments, _ = begun(1, NUM + 3)
    prior = window.prior
    window.prior = WindowPrior(
        prior.first, np.zeros(NUM, bool), np.zeros(NUM, bool), 0.0 * prior.gradient, 0.0 * prior.information
    )
    for k in range(3):
        H, at = information(window)
        scale = np.sqrt(np.diag(H))
        N = gauge(at)
        leak = np.abs((H @ N) / scale[:, None]).max() / np.abs(H / scale[:, None]).max()
        assert leak < 1e-9, f"{leak:.1e} after {k} states left"
        assert (window.prior.touched.sum() > 0) == (k > 0)
        window.slide()
        window.moments.append(moments[NUM + k])
        # The next state somewhere near, and all others moved: what a solve would do.
        rng = np.random.default_rng(k)
        for name in SIZES:
            window.values[name] = np.array(window.values[name])
        window.values["pose"] = window.values["pose"] @ rigid.exp(rng.normal(size=(NUM, 6)) * [0.02] * 6)
        window.values["velocity"] += 0.1 * rng.normal(size=(NUM, 3))
        window.pool.add(moments[NUM + k].tracks, NUM - 1)
        window.pool.is_solved[:] = True


@pytest.mark.slow
def test_a_vehicle_that_moves_starts_at_its_speed_and_shrinks_to_the_window():
    moments, truth = World(seed=2, num_slots=40).moments(31)
    rules = InertialStartConfig(slowest_mps=6.0, fastest_mps=15.0)
    start = started(moments, InertialWindowConfig(num_states=NUM, num_landmarks=40), rules)
    assert start.reason == "" and len(start.window.moments) == 31
    speed = np.linalg.norm(start.estimate.state.velocity_map)
    true_speed = np.linalg.norm(truth["velocity"][30])
    sigma = np.sqrt(np.trace(start.estimate.covariance[AT["velocity"], AT["velocity"]]))
    assert abs(speed - true_speed) < 3 * sigma < 0.3 * true_speed
    moved = rigid.inverse(truth["pose"][0]) @ truth["pose"][30]
    found = rigid.inverse(start.window.state(0).T_map_base) @ start.estimate.state.T_map_base
    assert np.rad2deg(np.linalg.norm(rigid.log(rigid.inverse(moved) @ found)[3:])) < 0.1
    # The frame: z up within the tilt of the first pose.
    up = start.window.state(0).T_map_base[2, :3]
    assert np.rad2deg(np.arccos(up @ truth["pose"][0][2, :3])) < 1.0
    small = start.window.shrunk(NUM)
    again = small.solve()
    shift = rigid.log(rigid.inverse(start.estimate.state.T_map_base) @ again.state.T_map_base)
    assert (np.abs(shift) < 0.5 * np.sqrt(np.diag(start.estimate.covariance))[:6]).all()
    ratio = np.sqrt(np.diag(again.covariance) / np.diag(start.estimate.covariance))
    assert (0.8 < ratio[: AT["bias"].start]).all() and (ratio[: AT["bias"].start] < 1.3).all()


def test_a_standing_vehicle_starts_at_rest_and_an_even_straight_is_refused():
    moments, _ = World(seed=4, num_slots=40).moments(NUM)
    force = np.array([0.3, -0.2, 9.80])
    rate = np.array([0.004, -0.002, 0.003])
    still = []
    for moment in moments:
        steps = moment.steps
        if steps is not None:
            used = (steps.step_s > 0)[:, None]
            steps = steps._replace(gyro_radps=np.where(used, rate, 0.0), accel_mps2=np.where(used, force, 0.0))
        tracks = moments[0].tracks
        still.append(moment._replace(steps=steps, tracks=tracks, is_standing=steps is not None, speed_mps=None))
    still[0] = still[0]._replace(is_standing=True)
    config = InertialWindowConfig(num_states=NUM, num_landmarks=40)
    start = started(still, config, InertialStartConfig())
    assert start.reason == ""
    state = start.estimate.state
    assert np.linalg.norm(state.velocity_map) < 1e-3
    np.testing.assert_allclose(state.bias[:3], rate, atol=2e-4)
    tilt = np.rad2deg(np.arccos(state.T_map_base[2, :3] @ force / np.linalg.norm(force)))
    assert tilt < 0.5
    few = [moment._replace(tracks=moment.tracks._replace(id=np.full(40, -1))) for moment in moments]
    refused = started(few, config, InertialStartConfig(slowest_mps=6.0, fastest_mps=9.0))
    assert refused.window is None and "corners are followed" in refused.reason


def test_inertial_sensor_and_a_measured_pose_give_what_gtsam_gives():
    """A batch without images: prior, five intervals, a pose of the last state; poses, velocities, biases, sigmas."""
    gtsam = pytest.importorskip("gtsam")
    window, moments, truth = begun(5, NUM)
    prior, values = window.prior, {name: np.array(truth[name][:NUM]) for name in SIZES}
    empty = [m._replace(tracks=m.tracks._replace(id=np.full(40, -1))) for m in moments[:NUM]]
    T_measured = truth["pose"][NUM - 1] @ rigid.exp(0.1 * np.array([0.03, -0.02, 0.01, 2e-3, -1e-3, 3e-3]))
    pose_sigma = np.array([0.02, 0.02, 0.05, 2e-3, 2e-3, 1e-3])
    empty[-1] = empty[-1]._replace(T_measured=T_measured, information=np.diag(pose_sigma**-2.0))
    config = InertialWindowConfig(num_states=NUM, num_landmarks=40, side_sigma_mps=0.0)
    mine = InertialWindow.of(empty, values, first_prior(values, SIGMA, truth["pose"][0][:3, :3]), config)
    for _ in range(3):
        estimate = mine.solve()
    theirs, covariance = gtsam_batch(gtsam, empty, truth, config, T_measured, pose_sigma)
    off = rigid.log(rigid.inverse(theirs["pose"]) @ estimate.state.T_map_base)
    sigma = np.sqrt(np.diag(estimate.covariance))
    assert (np.abs(off) < 0.05 * sigma[:6]).all()
    assert (np.abs(estimate.state.velocity_map - theirs["velocity"]) < 0.05 * sigma[AT["velocity"]]).all()
    assert (np.abs(estimate.state.bias - theirs["bias"]) < 0.05 * sigma[AT["bias"]]).all()
    np.testing.assert_allclose(np.concatenate([sigma[:6], sigma[AT["velocity"]]]), covariance, rtol=0.03)
    assert prior is not None


def gtsam_batch(gtsam, moments, truth, config, T_measured, pose_sigma):
    """The same problem in gtsam: the newest state, and the standard deviations of its pose and velocity."""
    from gtsam.symbol_shorthand import B, V, X

    params = gtsam.PreintegrationCombinedParams.MakeSharedU(9.81)
    params.setGyroscopeCovariance(InertialNoise().gyro_density ** 2 * np.eye(3))
    params.setAccelerometerCovariance(InertialNoise().accel_density ** 2 * np.eye(3))
    params.setIntegrationCovariance(1e-14 * np.eye(3))
    params.setBiasOmegaCovariance(InertialNoise().gyro_walk ** 2 * np.eye(3))
    params.setBiasAccCovariance(InertialNoise().accel_walk ** 2 * np.eye(3))
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()

    def pose(T):
        return gtsam.Pose3(gtsam.Rot3(T[:3, :3]), T[:3, 3])

    def noise(sigma):
        return gtsam.noiseModel.Diagonal.Sigmas(np.asarray(sigma, float))

    # Theirs is ordered rotation first; accelerometer bias first.
    T0, R0 = truth["pose"][0], truth["pose"][0][:3, :3]
    of_pose = np.zeros((6, 6))
    of_pose[:3, :3] = R0.T @ np.diag(SIGMA[3:6] ** 2) @ R0
    of_pose[3:, 3:] = np.diag(SIGMA[:3] ** 2)
    graph.add(gtsam.PriorFactorPose3(X(0), pose(T0), gtsam.noiseModel.Gaussian.Covariance(of_pose)))
    graph.add(gtsam.PriorFactorVector(V(0), truth["velocity"][0], noise(SIGMA[AT["velocity"]])))
    bias = gtsam.imuBias.ConstantBias(truth["bias"][0][3:], truth["bias"][0][:3])
    bias_sigma = np.roll(SIGMA[AT["bias"]], 3)
    graph.add(gtsam.PriorFactorConstantBias(B(0), bias, noise(bias_sigma)))
    for k, moment in enumerate(moments):
        start.insert(X(k), pose(truth["pose"][k]))
        start.insert(V(k), truth["velocity"][k])
        start.insert(B(k), bias)
        if k:
            steps = gtsam.PreintegratedCombinedMeasurements(params, bias)
            for w, a, dt in zip(*moment.steps, strict=True):
                if dt > 1e-9:
                    steps.integrateMeasurement(a, w, dt)
            graph.add(gtsam.CombinedImuFactor(X(k - 1), V(k - 1), X(k), V(k), B(k - 1), B(k), steps))
    last = len(moments) - 1
    order = np.concatenate([pose_sigma[3:], pose_sigma[:3]])
    graph.add(gtsam.PriorFactorPose3(X(last), pose(T_measured), noise(order)))
    found = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize()
    marginals = gtsam.Marginals(graph, found)
    sigma = np.sqrt(np.diag(marginals.marginalCovariance(X(last))))
    speed = np.sqrt(np.diag(marginals.marginalCovariance(V(last))))
    b = found.atConstantBias(B(last))
    state = {
        "pose": found.atPose3(X(last)).matrix(),
        "velocity": found.atVector(V(last)),
        "bias": np.concatenate([b.gyroscope(), b.accelerometer()]),
    }
    return state, np.concatenate([sigma[3:], sigma[:3], speed])


@pytest.mark.parametrize("bend_per_m", [-8e-4, 0.0, 8e-4])
def test_points_of_a_road_that_bends_lie_on_it(bend_per_m):
    """A dip of 1.25 km radius is 4 cm in 10 m: taken for a plane the way would be 3 % too long."""
    for away_m in (4.0, 10.0, 15.0):
        point = np.array([away_m, 0.0, 0.5 * bend_per_m * away_m**2 - 1.4])
        ray = point / np.linalg.norm(point)
        axes = np.stack([np.cross([0.0, 1.0, 0.0], ray), [0.0, 1.0, 0.0], ray], axis=1)
        landmark, up = jnp.array([0.0, 0.0, 1.0 / np.linalg.norm(point)]), jnp.asarray(axes[2])
        known = landmark, up, jnp.asarray(1.4), jnp.asarray(away_m), jnp.ones(1)
        off = on_road_residual(jnp.zeros(1), jnp.array([bend_per_m]), *known)[0] * np.linalg.norm(point)
        flat = on_road_residual(jnp.zeros(1), jnp.zeros(1), *known)[0] * np.linalg.norm(point)
        assert abs(off) < 1e-5 and abs(flat - 0.5 * bend_per_m * away_m**2) < 1e-5, "metres of height"


def test_first_estimates_go_along_with_the_size_of_the_way():
    """All states 5 % farther apart: derivatives are taken there, and the prior calls it 5 % of the way."""
    window, _, _ = begun(1, NUM + 1)
    window.slide()
    prior, first = window.prior, window.prior.first
    held = np.flatnonzero(prior.held)
    value = {name: np.array(first[name]) for name in SIZES}
    centre = first["pose"][held, :3, 3].mean(axis=0)
    value["pose"][:, :3, 3] = centre + 1.05 * (first["pose"][:, :3, 3] - centre) + [3.0, -2.0, 0.5]
    value["velocity"] *= 1.05
    with jax.enable_x64(True):
        at, d = jax.device_get((prior.slopes_at(value), prior.deviation(value)))
    # What a window of half a second holds to one size against the size of its way: some percent of the change.
    np.testing.assert_allclose(at["pose"], value["pose"], atol=0.05)
    np.testing.assert_allclose(at["velocity"], value["velocity"], rtol=0.01)
    places = first["pose"][:, :3, 3] - centre
    expected = np.einsum("fji,fj->fi", first["pose"][:, :3, :3], np.log(1.05) * places + [3.0, -2.0, 0.5])
    np.testing.assert_allclose(d[: 6 * NUM].reshape(NUM, 6)[held, :3], expected[held], atol=0.05)


def test_the_road_gives_the_size_of_the_way():
    """Speed known to 5 %, no suspension that would show it in so short a time: points on the road do."""
    config = replace(CONFIG, road=RoadBeliefs(tilt_deg=0.5, heave_m=0.03))
    sigmas, off = {}, []
    for has_road in (False, True):
        for seed in range(3):
            world = World(seed=seed, num_slots=40, has_road=has_road)
            window, moments, truth = begun(seed, NUM + 6, world=world, config=config, speed_sigma_mps=0.45)
            for k in range(NUM, NUM + 6):
                estimate = window.add(moments[k])
            ahead = AT["velocity"].start
            sigmas.setdefault(has_road, []).append(np.sqrt(estimate.covariance[ahead, ahead]))
            if has_road:
                off.append(difference(estimate.state, truth, NUM + 5)[ahead] / sigmas[True][-1])
    # Some seven points a time, and pitch on the springs of half a degree, which is 6 % of the size for all of them.
    assert np.mean(sigmas[True]) < 0.8 * np.mean(sigmas[False])
    assert np.abs(off).max() < 3.0


@pytest.mark.slow
@pytest.mark.parametrize(("speed_sigma_mps", "seeds"), [(0.1, 24), (0.45, 12)])
def test_errors_are_as_large_as_the_window_says_over_many_seeds(speed_sigma_mps, seeds):
    """The mean normalised square lies in its 95 % band, or below: for velocity, position, yaw and biases apart."""
    num = NUM + 14
    ends, ahead, lasts_s = [], [], []
    for seed in range(seeds):
        window, moments, truth = begun(seed, num, speed_sigma_mps=speed_sigma_mps)
        for k in range(NUM, num):
            estimate = window.add(moments[k])
            seen, v_base = seen_velocity(estimate), truth["pose"][k, :3, :3].T @ truth["velocity"][k]
            ahead.append((seen.velocity_base - v_base)[0] / seen.lasting_sigma[0])
            lasts_s.append(seen.lasts_s[0])
        ends.append((difference(estimate.state, truth, num - 1), estimate.covariance))
    for name, at in {
        "position": [0, 1, 2],
        "yaw": [5],
        "tilt": [3, 4],
        "velocity": range(*AT["velocity"].indices(STATE)),
        "biases": range(*AT["bias"].indices(STATE)),
    }.items():
        at = list(at)
        errors = np.stack([d[at] for d, _ in ends])
        report = nees(normalised_squares(errors, np.stack([C[np.ix_(at, at)] for _, C in ends])), len(at))
        assert 0.4 < report.mean < 1.15 * report.high, f"{name}: {report.mean:.2f}, band to {report.high:.2f}"
    # What is left of an error of the speed after 0.5 s: as stated, within what so few drives show.
    u = np.reshape(ahead, (seeds, -1))
    left = np.sum(u[:, 5:] * u[:, :-5]) / np.sqrt(np.sum(u[:, 5:] ** 2) * np.sum(u[:, :-5] ** 2))
    assert left == pytest.approx(np.mean(np.exp(-0.5 / np.array(lasts_s))), abs=0.2)


def test_road_beyond_its_crown_says_less_of_the_size_of_the_way():
    """The other lane falls off by up to 5 % more: 12 cm at 4 m aside, where a point in the lane is known to 3 cm."""
    away_m, down = np.array([8.0, 8.0]), np.sin(np.arctan2(1.4, 8.0))
    where = away_m, np.array([0.5, 4.0])
    weights = _road_weights(np.full(2, -down), np.full(2, 1.4), where, np.arange(2), np.ones(2, bool), RoadBeliefs())
    depth_m = np.hypot(8.0, 1.4)
    common = 0.03**2 + (1e-4 * 64) ** 2 + 0.013**2 + (np.deg2rad(0.2) * 8.0) ** 2
    assert depth_m / weights == pytest.approx(np.sqrt([common, common + (0.05 * 2.5) ** 2]))
