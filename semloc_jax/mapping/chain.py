"""The way of a drive without any map: wheels and inertial sensor from frame to frame (room: mapping; host).

In: a Drive with wheel odometry. Out: Chain: poses in a level frame `odom`, motion between frames with its covariance
and its derivative by odometer scale, gyro scale, direction of travel and what is left of the gyro bias.
"""

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.datasets import Drive
from semloc_jax.datasets.sensors import Imu
from semloc_jax.errors import SemlocError
from semloc_jax.fusion.motion_noise import MotionNoise
from semloc_jax.fusion.prediction import Calibration, MotionIncrement, MotionLog
from semloc_jax.geometry import rigid
from semloc_jax.mapping.inertial_states import InertialConfig, InertialStates, inertial_states


@dataclass(frozen=True)
class ChainConfig:
    """How the way of a drive is put together. All values are ours."""

    inertial: InertialConfig = field(default_factory=InertialConfig)
    noise: MotionNoise = field(
        default_factory=lambda: MotionNoise(tilt_density_degps=0.05, heave_share=0.004, gyro_turn_share=0.001)
    )
    """Of the motion between frames when the gyro biases are taken off. Roads and springs lift a vehicle by 0.5 to 2 cm
    in 5 m: where each frame may stand 5 cm higher than the last one, paint tells no distance along the road. The scale
    of the turn is an unknown of the drive."""
    odometer_sigma: float = 0.02
    """Of the scale where no accelerometer tells it."""
    gyro_scale_sigma: float = 0.01
    """Of a micromechanical gyroscope; where there is none, wheels turn with `noise.wheel_turn_share`."""
    travel_sigma_deg: float = 0.3


class Chain(NamedTuple):
    """Poses of the frames of a drive, from its own sensors alone.

    `odom` is the frame of the first pose made level: z against gravity, x along the first heading.
    """

    times_s: Float[np.ndarray, " n"]
    Ts_odom_base: Float[np.ndarray, "n 4 4"]
    steps_covariance: Float[np.ndarray, "e 6 6"]
    """Of the right tangent of each motion T_from_to [m, rad]; errors of the calibration are not in it."""
    steps_jacobian: Float[np.ndarray, "e 6 3"]
    """Derivative of the right tangent by odometer scale, scale of the turn and direction of travel [rad]."""
    steps_by_wander: Float[np.ndarray, "e 6"]
    """The same by what is left of the gyro bias, in standard deviations of it."""
    wander_memory_s: float
    """For how long that stays the same."""
    calibration: Float[np.ndarray, "3"]
    """Odometer scale, scale of the turn, direction of travel [rad] that the chain was made with."""
    calibration_sigma: Float[np.ndarray, "3"]
    way_m: Float[np.ndarray, " n"]
    """Way driven since the first pose, forth and back added."""
    tilt_sigma_rad: Float[np.ndarray, " n"]
    """Of roll and pitch against gravity."""
    gyro_bias_radps: Float[np.ndarray, "n 3"]
    """What was taken off the gyroscope; zero without one."""

    @property
    def steps(self) -> Float[np.ndarray, "e 4 4"]:
        """T_from_to of neighbouring frames."""
        return rigid.inverse(self.Ts_odom_base[:-1]) @ self.Ts_odom_base[1:]


def drive_chain(drive: Drive, config: ChainConfig | None = None) -> Chain:
    """The poses of all frames of a drive by its wheels and its inertial sensor.

    The rotation comes from the gyroscope, less a bias that is learned from standstill and from the wheels; roll and
    pitch from gravity; the odometer scale from the accelerometer in curves. Without inertial data the wheels give the
    yaw rate, and the road counts as level.

    Args:
        drive: With wheel odometry and at least two frames.
        config: None for the defaults.

    Raises:
        SemlocError: the drive has no wheel odometry, or its odometry does not span the frames, or fewer than 2 frames.
    """
    config = config or ChainConfig()
    time_s = np.array([frame.time_s for frame in drive.frames])
    _check(drive, time_s)
    if drive.imu is None or len(drive.imu.time_s) < 2:
        noise = config.noise
        return _by_increments(MotionLog.of_drive(replace(drive, imu=None), noise), time_s, None, config)
    states = inertial_states(drive, time_s, config.inertial)
    log = MotionLog.of_drive(replace(drive, imu=_without_bias(drive.imu, states)), config.noise)
    return _by_increments(log, time_s, states, config)


def _check(drive: Drive, time_s: np.ndarray) -> None:
    if drive.odometry is None:
        has = "inertial data" if drive.imu is not None else "neither wheels nor inertial data"
        raise SemlocError(
            f"drive {drive.name}: has {has} but no wheel odometry; expected the speed of the wheels (wheel_odom.csv: "
            "t, v_m_s, yaw_rate_rad_s), which says how far it drove from frame to frame; add it, or localize in a map"
        )
    if len(time_s) < 2 or np.any(np.diff(time_s) <= 0.0):
        raise SemlocError(
            f"drive {drive.name}: {len(time_s)} frames whose times do not all increase; expected at least 2 frames in "
            "time order"
        )
    begin, end = drive.odometry.time_s[[0, -1]]
    outside = int(np.sum((time_s < begin) | (time_s > end)))
    if 2 * outside > len(time_s):
        raise SemlocError(
            f"drive {drive.name}: wheel odometry from {begin:.3f} s to {end:.3f} s leaves {outside} of {len(time_s)} "
            f"frames ({time_s[0]:.3f} s to {time_s[-1]:.3f} s) without; expected the same clock; check the time columns"
        )


def _without_bias(imu: Imu, states: InertialStates) -> Imu:
    """The inertial data with the smoothed gyro bias taken off."""
    bias = np.column_stack([np.interp(imu.time_s, states.time_s, column) for column in states.gyro_bias_radps.T])
    return replace(imu, gyro_radps=imu.gyro_radps - bias)


def _by_increments(log: MotionLog, time_s: np.ndarray, states: InertialStates | None, config: ChainConfig) -> Chain:
    scale = 1.0 if states is None else states.odometer_scale
    calibration = Calibration(odometer_scale=scale)
    increments = [log.increment(*ends, calibration) for ends in pairwise(time_s)]
    travel = np.deg2rad(config.travel_sigma_deg)
    if states is None:
        slope = np.deg2rad(config.inertial.road_slope_deg)
        sigma = np.array([config.odometer_sigma, config.noise.wheel_turn_share, travel])
        tilt, bias, left = np.full(len(time_s), slope), np.zeros((len(time_s), 3)), np.zeros(len(time_s))
    else:
        sigma = np.array([states.odometer_scale_sigma, config.gyro_scale_sigma, travel])
        tilt, bias, left = states.tilt_sigma_rad, states.gyro_bias_radps, states.gyro_bias_sigma_radps[:, 2]
    way_m = [log.way_m(*ends) for ends in pairwise(time_s)]
    return Chain(
        times_s=time_s,
        Ts_odom_base=_chained(increments, states),
        steps_covariance=np.array([increment.covariance for increment in increments]),
        steps_jacobian=_by_calibration(increments),
        steps_by_wander=np.array([i.jacobian[:, 1] for i in increments]) * (0.5 * (left[1:] + left[:-1]))[:, None],
        wander_memory_s=config.inertial.bias_memory_s,
        calibration=np.array([scale, 1.0, calibration.travel_rad]),
        calibration_sigma=sigma,
        way_m=np.concatenate([[0.0], scale * np.cumsum(way_m)]),
        tilt_sigma_rad=tilt,
        gyro_bias_radps=bias,
    )


def _by_calibration(increments: list[MotionIncrement]) -> Float[np.ndarray, "e 6 3"]:
    """Derivative of each right tangent by odometer scale, scale of the turn and direction of travel: within a step
    the rate is even, and a share of it is a bias."""
    jacobian = np.array([increment.jacobian for increment in increments])
    turn = rigid.log(np.array([increment.T_from_to for increment in increments]))[:, 5]
    step_s = np.array([increment.to_s - increment.from_s for increment in increments])
    jacobian[:, :, 1] *= -(turn / step_s)[:, None]
    return jacobian


def _chained(increments: list[MotionIncrement], states: InertialStates | None) -> np.ndarray:
    """Poses one after another; roll and pitch of each are those of gravity where it is known."""
    poses = [np.eye(4)]
    if states is not None:
        poses[0] = _levelled(poses[0], states.up_base[0])
    for k, increment in enumerate(increments):
        T = rigid.normalised(poses[-1] @ increment.T_from_to)
        poses.append(T if states is None else _levelled(T, states.up_base[k + 1]))
    return np.array(poses)


def _levelled(T_odom_base: np.ndarray, up_base: np.ndarray) -> np.ndarray:
    """The pose turned about a level axis so that `up_base` points up."""
    up = T_odom_base[:3, :3] @ up_base
    axis = np.array([up[1], -up[0], 0.0])
    sine = np.linalg.norm(axis)
    if sine < 1e-12:
        return T_odom_base
    omega = axis / sine * np.arctan2(sine, up[2])
    T = T_odom_base.copy()
    T[:3, :3] = rigid.exp(np.concatenate([np.zeros(3), omega]))[:3, :3] @ T_odom_base[:3, :3]
    return T
