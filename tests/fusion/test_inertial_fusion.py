"""Measured poses and an inertial sensor without wheels: derivatives, consistency, what is left without poses."""

from typing import NamedTuple

import numpy as np
import pytest

from semloc_jax.datasets import Imu
from semloc_jax.fusion.clock import BELIEFS, CameraTimeLog, learned, unknown_offset
from semloc_jax.fusion.inertial_fusion import InertialBeliefs, InertialFusion, error_transition
from semloc_jax.fusion.inertial_motion import Moving
from semloc_jax.fusion.measurements import Fusion, GnssMeasurement, PoseMeasurement
from semloc_jax.fusion.prediction import MotionLog, MotionQuality
from semloc_jax.fusion.velocity_sample import VelocitySample
from semloc_jax.geometry import rigid
from tests.fusion.inertial_world import World

SIGMA = np.array([0.05, 0.02, 0.01, 2e-3, 2e-3, 1.5e-3])
"""Of the measured poses [m, rad]."""
STEP_S = 0.2


def log_of(imu: Imu) -> MotionLog:
    log = MotionLog()
    for row in zip(imu.time_s, imu.gyro_radps, imu.accel_mps2, strict=True):
        log.add_imu(*row)
    return log


def test_is_a_fusion():
    assert isinstance(InertialFusion(), Fusion)


def test_transition_of_the_error_is_the_finite_difference():
    world = World(noise=0.0)
    imu, _ = world.imu(1.0, np.random.default_rng(0))
    log, T = log_of(imu), world.pose(0.3)
    moving = Moving(T[:3, :3], world.velocity(0.3), np.zeros(6), np.zeros((3, 3)))

    def after(error):
        turned = T @ rigid.exp(error[:6])
        mount = rigid.exp(np.concatenate([np.zeros(3), error[18:21]]))[:3, :3]
        start = Moving(turned[:3, :3], moving.velocity_map + error[6:9], error[9:15], np.zeros((3, 3)), mount)
        motion = log.increment(0.3, 0.5, moving=start).inertial
        step, velocity = motion.after(start)
        return turned @ step, velocity

    motion = log.increment(0.3, 0.5, moving=moving).inertial
    F, _ = error_transition(motion, moving)
    T_end, v_end = after(np.zeros(24))
    for column in (*range(15), 18, 19, 20):
        step = np.zeros(24)
        step[column] = 1e-4
        (T_more, v_more), (T_less, v_less) = after(step), after(-step)
        there = [rigid.log(rigid.inverse(T_end) @ found) for found in (T_more, T_less)]
        found = np.concatenate([there[0] - there[1], v_more - v_less]) / 2e-4
        # The derivative by the biases is that of held steps: to first order in the length of a step.
        assert found == pytest.approx(F[:9, column], abs=3e-4)
    assert T_end == pytest.approx(world.pose(0.5), abs=3e-4) and v_end == pytest.approx(world.velocity(0.5), abs=3e-3)


class Seen(NamedTuple):
    """Velocities by cameras: scale, what is new in every error [m/s], what lasts [m/s] and for how long [s]."""

    scale: float
    new_mps: float
    lasting_mps: float = 0.0
    lasts_s: float = 1.0

    def samples(self, velocities, rng):
        """One for each velocity in the axes of the vehicle."""
        kept, lasting = np.exp(-STEP_S / self.lasts_s), rng.normal(size=3)
        for v in velocities:
            error = self.lasting_mps * lasting + self.new_mps * rng.normal(size=3)
            yield VelocitySample(
                v / self.scale + error, *np.full((2, 3), [[self.new_mps], [self.lasting_mps]]), np.full(3, self.lasts_s)
            )
            lasting = kept * lasting + np.sqrt(1.0 - kept**2) * rng.normal(size=3)


def followed(seed, num=60, map_until_s=np.inf, seen=None):
    """The errors, the covariances and the states of a drive with poses at 5 Hz.

    Args:
        seed: Of the drive.
        num: Poses.
        map_until_s: Later poses are not measured.
        seen: What velocities by cameras are off by; None for none.
    """
    world, rng = World(seed=seed), np.random.default_rng(100 + seed)
    imu, bias = world.imu(num * STEP_S, rng)
    log, fusion = log_of(imu), InertialFusion()
    time_s = STEP_S * np.arange(num)
    T_true = world.pose(time_s)
    in_base = np.einsum("nji,nj->ni", T_true[:, :3, :3], world.velocity(time_s))
    for t, sample in zip(time_s, [] if seen is None else seen.samples(in_base, rng), strict=seen is not None):
        log.add_velocity(t, sample)

    def measured(k):
        return PoseMeasurement(k * STEP_S, T_true[k] @ rigid.exp(SIGMA * rng.normal(size=6)), np.diag(SIGMA**2))

    state = fusion.start(measured(0))
    poses = []
    for k in range(1, num):
        before = fusion.pose(state)
        state = fusion.predict(state, log.increment(before.time_s, k * STEP_S, before.calibration, before.moving))
        if k * STEP_S <= map_until_s:
            state, _ = fusion.correct(state, measured(k))
        poses.append((fusion.pose(state), T_true[k]))
    errors = np.array([rigid.log(rigid.inverse(pose.T_map_base) @ T) for pose, T in poses])
    covariances = np.array([pose.covariance for pose, _ in poses])
    true_bias = np.array([np.interp((num - 1) * STEP_S, imu.time_s, column) for column in bias.T])
    truth = np.concatenate([world.velocity((num - 1) * STEP_S), true_bias])
    return errors, covariances, state, truth


def test_velocity_and_biases_are_found_and_all_sigmas_hold():
    squares, of_motion, along = [], [], []
    for seed in range(12):
        errors, covariances, state, truth = followed(seed)
        squares.append(np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariances), errors)[5:].mean() / 6)
        off = np.concatenate([state.velocity_map, state.bias]) - truth
        of_motion.append(off @ np.linalg.solve(state.covariance[6:15, 6:15], off) / 9)
        along.append(np.abs(errors[20:, 0]).mean())
        assert np.linalg.norm(off[:3]) < 0.15 and np.abs(off[3:6]).max() < 2e-3
    # Means of 12 drives of 9 and more independent numbers: 3 sigma is 0.4.
    assert 0.6 < np.mean(squares) < 1.4 and 0.6 < np.mean(of_motion) < 1.4
    assert np.mean(along) < 0.03, "poses of 5 cm are smoothed, though no wheel turns"


def test_without_poses_the_inertial_sensor_carries_on_and_says_how_well():
    ends = [followed(seed, 50, map_until_s=7.9) for seed in range(12)]
    for after_s, most_m in ((0.2, 0.06), (2.0, 0.5)):
        k = 38 + round(after_s / STEP_S)
        off = np.array([np.linalg.norm(errors[k, :2]) for errors, *_ in ends])
        assert np.mean(off) < most_m
    squares = [e[-1] @ np.linalg.solve(P[-1], e[-1]) / 6 for e, P, *_ in ends]
    assert 0.5 < np.mean(squares) < 1.6


def test_velocities_by_cameras_give_the_way_and_poses_their_scale():
    alone = [followed(seed, 120, map_until_s=12.0)[0][-1, 0] for seed in range(4)]
    seen = [followed(seed, 120, 12.0, Seen(1.03, 0.05)) for seed in range(4)]
    scales = np.array([float(state.odometer_scale) for _, _, state, _ in seen])
    sigma = np.sqrt([state.covariance[15, 15] for _, _, state, _ in seen])
    assert np.abs((scales - 1.03) / sigma).max() < 3.0 and np.mean(scales) == pytest.approx(1.03, abs=0.01)
    # 12 s at 9 m/s without the map: half a percent of the way, though the cameras are off by 3 %.
    along = np.array([errors[-1, 0] for errors, *_ in seen])
    assert np.sqrt(np.mean(along**2)) < 0.005 * 108 < np.sqrt(np.mean(np.square(alone)))


@pytest.mark.slow
def test_the_doubt_about_a_way_without_a_map_holds_where_errors_of_the_velocity_last():
    """Gaps of 2, 6 and 20 s: velocities 1 % of 9 m/s wrong for 8 s, as a window has them. Taken for new at every image
    they would leave 0.2 m of doubt after 20 s (180 m), five times too little."""
    seen = Seen(1.0, 0.05, 0.09, 8.0)
    drives = [followed(seed, 141, 8.0, seen) for seed in range(8)]
    for gap_s in (2.0, 6.0, 20.0):
        k = round((8.0 + gap_s) / STEP_S) - 1
        squares = [e[k] @ np.linalg.solve(P[k], e[k]) / 6 for e, P, *_ in drives]
        # Eight drives of six numbers: 3 sigma of their mean is 0.61.
        assert 0.39 < np.mean(squares) < 1.61, f"{gap_s} s"
    along = np.sqrt([P[k, 0, 0] for _, P, *_ in drives])
    assert 0.6 < along.mean() < 1.2, "with errors of 9 cm/s that last: 0.4 to 0.7 % of the way"


def test_a_silent_sensor_keeps_the_velocity_and_the_doubt_grows():
    fusion = InertialFusion()
    T = rigid.planar_pose(1.0, 2.0, 0.5)
    state = fusion.start(PoseMeasurement(0.0, T, 1e-4 * np.eye(6)))
    state = state._replace(velocity_map=10.0 * T[:3, 0], covariance=1e-4 * np.eye(24))
    increment = MotionLog().increment(0.0, 0.5, moving=fusion.pose(state).moving)
    assert increment.quality is MotionQuality.MISSING and increment.inertial is None
    gone = fusion.pose(fusion.predict(state, increment))
    assert gone.T_map_base[:3, 3] == pytest.approx(T[:3, 3] + 5.0 * T[:3, 0])
    assert np.sqrt(gone.covariance[0, 0]) == pytest.approx(0.25, rel=0.05), "half of 2 m/s^2 times 0.5 s squared"


def test_what_does_not_fit_is_refused_and_changes_nothing():
    fusion = InertialFusion()
    state = fusion.start(PoseMeasurement(0.0, np.eye(4), 1e-4 * np.eye(6)))
    far = PoseMeasurement(0.0, rigid.planar_pose(1.0, 0.0), 1e-4 * np.eye(6))
    same, innovation = fusion.correct(state, far)
    assert not innovation.accepted and same is state and innovation.chi2 == pytest.approx(5000.0)
    fix = GnssMeasurement(0.0, np.array([1.0, -1.0, 50.0]), np.full(3, 1.0))
    fitted, innovation = fusion.correct_gnss(state, fix)
    assert innovation.accepted and innovation.dof == 2 and np.linalg.norm(fitted.gnss_offset_m) > 1.0


@pytest.mark.slow
def test_clock_and_mount_of_the_sensor_are_found_while_driving():
    """A sensor 20 ms late and turned by 1 deg about an oblique axis, poses of 1 cm and 0.03 deg at 5 Hz, 40 s."""
    mount_deg, late_s, found = np.array([0.6, -0.6, 0.53]), 0.02, []
    for seed in range(3):
        world, rng = World(seed=seed, speed_mps=9.0), np.random.default_rng(seed)
        imu, _ = world.imu(38.0, rng)
        R = rigid.exp(np.concatenate([np.zeros(3), np.deg2rad(mount_deg)]))[:3, :3]
        log = log_of(Imu(imu.time_s + late_s, imu.gyro_radps @ R, imu.accel_mps2 @ R))
        fusion, offset = InertialFusion(InertialBeliefs(mount_sigma_deg=1.0)), unknown_offset(BELIEFS)
        sigma = np.repeat([0.01, np.deg2rad(0.03)], 3)
        state = fusion.start(PoseMeasurement(0.2, world.pose(0.2), np.diag(sigma**2)))
        for t in 0.2 * np.arange(2, 186):
            before, motion = fusion.pose(state), CameraTimeLog(log, offset)
            step = motion.increment(before.time_s, t, before.calibration, before.moving)
            state = fusion.predict(state, step)
            measured = PoseMeasurement(t, world.pose(t) @ rigid.exp(sigma * rng.normal(size=6)), np.diag(sigma**2))
            predicted = fusion.pose(state)
            state, innovation = fusion.correct(state, measured)
            if not innovation.accepted:
                continue
            difference = rigid.log(rigid.inverse(predicted.T_map_base) @ measured.T_map_base)
            slope = motion.slope(before.time_s, t, moving=before.moving)
            spread = predicted.covariance + measured.covariance
            offset = learned(offset, slope, difference, spread, t - before.time_s, BELIEFS)
        turn = rigid.log(np.block([[state.R_base_imu, np.zeros((3, 1))], [0, 0, 0, 1]]))[3:]
        found.append([1e3 * float(offset.offset_s), *np.rad2deg(turn)])
    off = np.abs(np.array(found) - [1e3 * late_s, *mount_deg])
    assert off[:, 0].mean() < 1.0, "[ms]"
    assert off[:, 1:].mean() < 0.1, "[deg]"
