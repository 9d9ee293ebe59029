"""Kalman fusion of measured poses with an inertial sensor, with or without wheels or cameras (room: fusion; host).

In: PoseMeasurement, MotionIncrement with its inertial part, GnssMeasurement. Out: FusedPose with velocity and biases.
Without a speed the way between two poses depends on the velocity, so velocity and biases are part of the state: what
one pose teaches of them is not taken for new at the next.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri

from semloc_jax.fusion.inertial_motion import InertialMotion, Moving
from semloc_jax.fusion.measurements import (
    FusedPose,
    GnssMeasurement,
    Innovation,
    PoseMeasurement,
    SensorBeliefs,
    check_same_time,
    needs_no_offset,
    normalised_square,
)
from semloc_jax.fusion.prediction import MotionIncrement
from semloc_jax.fusion.velocity_sample import VelocitySample
from semloc_jax.fusion.window_terms import fit, is_finite
from semloc_jax.geometry import rigid
from semloc_jax.solvers.factors import Factors
from semloc_jax.structs import InertialNoise

_POSE, _VELOCITY, _BIAS, _SCALE, _OFFSET = slice(0, 6), slice(6, 9), slice(9, 15), 15, slice(16, 18)
_MOUNT = slice(18, 21)
_LASTING = slice(21, 24)
_NUM = 24


@dataclass(frozen=True)
class InertialBeliefs:
    """What is known of a vehicle and its inertial sensor before it moves. All values are ours, of a production car."""

    sensors: SensorBeliefs = field(default_factory=SensorBeliefs)
    """Of satellites, of the scale of a measured speed, and of a vehicle while nothing measures its motion."""
    speed_sigma_mps: float = 15.0
    side_sigma_mps: float = 0.5
    """Of the first velocity, across the vehicle."""
    gyro_bias_sigma_radps: float = 0.01
    accel_bias_sigma_mps2: float = 0.1
    mount_sigma_deg: float = 0.3
    """Of the axes of the inertial sensor against those of the vehicle that the cameras show: tolerance of a mount."""
    gate_probability: float = 0.999
    """A measurement beyond this quantile of the chi-square distribution is refused."""

    @property
    def bias_sigma(self) -> Float[np.ndarray, "6"]:
        """Standard deviations of the biases before anything is known."""
        return np.repeat([self.gyro_bias_sigma_radps, self.accel_bias_sigma_mps2], 3)


class InertialFusionState(NamedTuple):
    """State of `InertialFusion`; the error is (right tangent of the pose, velocity, biases, scale, GNSS offset,
    turn of the sensor against the base, lasting error of the velocity that cameras measure)."""

    time_s: Float[np.ndarray, ""]
    T_map_base: Float[np.ndarray, "4 4"]
    velocity_map: Float[np.ndarray, "3"]
    bias: Float[np.ndarray, "6"]
    """Of gyroscope [rad/s] and accelerometer [m/s^2]."""
    odometer_scale: Float[np.ndarray, ""]
    """True speed over that of wheels or cameras."""
    gnss_offset_m: Float[np.ndarray, "2"]
    R_base_imu: Float[np.ndarray, "3 3"]
    """What is left of the mount."""
    lasting_error: Float[np.ndarray, "3"]
    """Of the last velocity by cameras, in units of its standard deviation."""
    velocity_s: Float[np.ndarray, ""]
    """When that was measured; -inf where none was."""
    covariance: Float[np.ndarray, "24 24"]


class InertialFusion:
    """Error-state Kalman filter on SE(3) with velocity, biases, a scale of the odometer, GNSS-to-map offset and the
    mount of the inertial sensor, and the error of the velocity that cameras measure, a first-order Gauss-Markov process
    whose size and time its window states."""

    def __init__(self, beliefs: InertialBeliefs | None = None) -> None:
        """A filter with the given beliefs."""
        self.beliefs = beliefs or InertialBeliefs()

    def start(self, measurement: PoseMeasurement) -> InertialFusionState:
        """State at the first pose: any speed ahead, no bias."""
        beliefs, T = self.beliefs, measurement.T_map_base.astype(np.float64)
        side = beliefs.side_sigma_mps
        spread = T[:3, :3] * np.array([beliefs.speed_sigma_mps, side, side])
        covariance = np.zeros((_NUM, _NUM))
        covariance[_POSE, _POSE] = measurement.covariance
        covariance[_VELOCITY, _VELOCITY] = spread @ spread.T
        covariance[_BIAS, _BIAS] = np.diag(beliefs.bias_sigma**2)
        covariance[_SCALE, _SCALE] = beliefs.sensors.scale_sigma**2
        covariance[_OFFSET, _OFFSET] = beliefs.sensors.gnss_offset_sigma_m**2 * np.eye(2)
        covariance[_MOUNT, _MOUNT] = np.deg2rad(beliefs.mount_sigma_deg) ** 2 * np.eye(3)
        covariance[_LASTING, _LASTING] = np.eye(3)
        time_s, one, never = map(np.float64, (measurement.time_s, 1.0, -np.inf))
        at_rest = np.zeros(3), np.zeros(6), one, np.zeros(2), np.eye(3), np.zeros(3), never
        return InertialFusionState(time_s, T, *at_rest, covariance)

    def predict(self, state: InertialFusionState, increment: MotionIncrement) -> InertialFusionState:
        """State after the motion, with the velocity that wheels or cameras measured at its end.

        Where the inertial sensor is silent the velocity goes on, as surely as a vehicle goes on as it did.
        """
        check_same_time("increment", increment.from_s, float(state.time_s))
        step_s = abs(increment.to_s - increment.from_s)
        moving = self._moving(state)
        if increment.inertial is None:
            state = self._coasted(state, step_s)
        else:
            clock = increment.covariance - increment.inertial.covariance_after(moving)
            state = _moved(state, increment.inertial, moving, clock)
        walk = np.zeros(_NUM)
        walk[_BIAS] = (InertialNoise() if increment.inertial is None else increment.inertial.noise).bias_walk
        walk[_SCALE] = self.beliefs.sensors.scale_walk
        walk[_OFFSET] = self.beliefs.sensors.gnss_offset_walk_m
        state = state._replace(
            time_s=np.float64(increment.to_s), covariance=_symmetric(state.covariance + np.diag(walk**2) * step_s)
        )
        return state if increment.velocity is None else self._with_velocity(state, increment.velocity)

    def correct(
        self, state: InertialFusionState, measurement: PoseMeasurement
    ) -> tuple[InertialFusionState, Innovation]:
        """State with a measured pose, unless the chi-square test refuses it."""
        check_same_time("pose", measurement.time_s, float(state.time_s))
        difference = rigid.log(rigid.inverse(state.T_map_base) @ measurement.T_map_base)
        # log(exp(-e) exp(difference)) = difference - J e for a small error e of the state.
        H = np.zeros((6, _NUM))
        H[:, _POSE] = np.linalg.inv(rigid.right_jacobian(-difference))
        return self._gated(state, difference, H, measurement.covariance)

    def correct_gnss(
        self, state: InertialFusionState, measurement: GnssMeasurement
    ) -> tuple[InertialFusionState, Innovation]:
        """State with a satellite fix, unless the chi-square test refuses it."""
        check_same_time("fix", measurement.time_s, float(state.time_s))
        difference = measurement.p_map[:2] - state.T_map_base[:2, 3] - state.gnss_offset_m
        H = np.zeros((2, _NUM))
        H[:, :3] = state.T_map_base[:2, :3]
        H[:, _OFFSET] = np.eye(2)
        known = state.T_map_base, state.covariance[_POSE, _POSE]
        is_taken = needs_no_offset(measurement, *known, self.beliefs.gate_probability)
        return self._gated(state, difference, H, np.diag(measurement.sigma_m[:2] ** 2), is_taken)

    def correct_term(self, state: InertialFusionState, term: Factors) -> tuple[InertialFusionState, Innovation]:
        """State with a term that was measured at the time of the state, unless the chi-square test refuses it."""
        innovation, r, J = fit(term, state.T_map_base, state.covariance[_POSE, _POSE])
        if not is_finite(term):
            return state, innovation
        H = np.zeros((len(r), _NUM))
        H[:, _POSE] = J
        return self._gated(state, -r, H, np.eye(len(r)))

    def pose(self, state: InertialFusionState) -> FusedPose:
        """Pose, covariance, and what the next motion begins with."""
        return FusedPose(
            float(state.time_s), state.T_map_base, state.covariance[_POSE, _POSE], float(state.odometer_scale),
            float(state.bias[2]), state.gnss_offset_m, moving=self._moving(state),
        )  # fmt: skip

    def _moving(self, state: InertialFusionState) -> Moving:
        covariance = state.covariance[_VELOCITY, _VELOCITY]
        return Moving(state.T_map_base[:3, :3], state.velocity_map, state.bias, covariance, state.R_base_imu)

    def _coasted(self, state: InertialFusionState, step_s: float) -> InertialFusionState:
        """The velocity goes on while nothing is measured."""
        noise, R = self.beliefs.sensors.motion, state.T_map_base[:3, :3]
        T = state.T_map_base.copy()
        T[:3, 3] += state.velocity_map * step_s
        F = np.eye(_NUM)
        F[:3, _VELOCITY] = R.T * step_s
        gained = noise.unknown_acceleration_mps2 * np.diag([1.0, 0.2, 0.2])
        turned = np.deg2rad(noise.unknown_yaw_rate_degps) * np.diag([0.2, 0.2, 1.0])
        G = np.zeros((_NUM, 6))
        G[:3, :3], G[_VELOCITY, :3] = 0.5 * gained * step_s**2, R @ gained * step_s
        G[3:6, 3:] = turned * step_s
        return state._replace(T_map_base=T, covariance=F @ state.covariance @ F.T + G @ G.T)

    def _with_velocity(self, state: InertialFusionState, sample: VelocitySample) -> InertialFusionState:
        """The state with a measured velocity, unless the chi-square test refuses it."""
        state = _with_what_lasts(state, sample)
        R = state.T_map_base[:3, :3]
        here = R.T @ state.velocity_map
        H = np.zeros((3, _NUM))
        H[:, 3:6], H[:, _VELOCITY] = rigid.skew(here), R.T
        H[:, _SCALE], H[:, _LASTING] = -sample.velocity_base, np.diag(sample.lasting_sigma)
        lasting = sample.lasting_sigma * state.lasting_error
        difference = state.odometer_scale * sample.velocity_base - here - lasting
        return self._gated(state, difference, H, np.diag(sample.sigma**2))[0]

    def _gated(
        self,
        state: InertialFusionState,
        difference: np.ndarray,
        H: np.ndarray,
        R: np.ndarray,
        is_taken: bool = False,
    ) -> tuple[InertialFusionState, Innovation]:
        """One linear correction, in the covariance form that stays positive (Joseph), unless the chi-square test
        refuses it; what is taken anyway is not tested."""
        P = state.covariance
        S = H @ P @ H.T + R
        square, dof = normalised_square(difference, S), len(difference)
        if square > chdtri(dof, 1.0 - self.beliefs.gate_probability) and not is_taken:
            return state, Innovation(square, dof, False)
        gain = np.linalg.solve(S, H @ P).T
        step, rest = gain @ difference, np.eye(_NUM) - gain @ H
        corrected = state._replace(
            T_map_base=rigid.normalised(state.T_map_base @ rigid.exp(step[_POSE])),
            velocity_map=state.velocity_map + step[_VELOCITY],
            bias=state.bias + step[_BIAS],
            odometer_scale=state.odometer_scale + step[_SCALE],
            gnss_offset_m=state.gnss_offset_m + step[_OFFSET],
            lasting_error=state.lasting_error + step[_LASTING],
            R_base_imu=rigid.exp(np.concatenate([np.zeros(3), step[_MOUNT]]))[:3, :3] @ state.R_base_imu,
            covariance=_symmetric(rest @ P @ rest.T + gain @ R @ gain.T),
        )
        return corrected, Innovation(square, dof, True)


def _moved(
    state: InertialFusionState, motion: InertialMotion, moving: Moving, clock: Float[np.ndarray, "6 6"]
) -> InertialFusionState:
    """The state carried on by the inertial sensor; `clock`: covariance of T_from_to by the time offset."""
    T_from_to, velocity = motion.after(moving)
    F, G = error_transition(motion, moving)
    covariance = F @ state.covariance @ F.T + G @ motion.covariance @ G.T
    covariance[_POSE, _POSE] += clock
    T = rigid.normalised(state.T_map_base @ T_from_to)
    return state._replace(T_map_base=T, velocity_map=velocity, covariance=covariance)


def _with_what_lasts(state: InertialFusionState, sample: VelocitySample) -> InertialFusionState:
    """The state at a sample of velocity: of the error of the one before as much as lasts, and as much new."""
    kept = np.exp(-(state.time_s - state.velocity_s) / sample.lasts_s)
    F = np.eye(_NUM)
    F[_LASTING, _LASTING] = np.diag(kept)
    covariance = F @ state.covariance @ F.T
    covariance[_LASTING, _LASTING] += np.diag(1.0 - kept**2)
    return state._replace(
        lasting_error=kept * state.lasting_error, velocity_s=state.time_s, covariance=_symmetric(covariance)
    )


def error_transition(
    motion: InertialMotion, moving: Moving
) -> tuple[Float[np.ndarray, "24 24"], Float[np.ndarray, "24 9"]]:
    """Derivatives of the error after an inertial motion by the error before, and by the error of the motion."""
    R, dt = moving.R_map_base, motion.duration_s
    back = motion.rotation.T
    G = np.zeros((_NUM, 9))
    G[3:6, :3], G[:3, 3:6], G[_VELOCITY, 6:] = np.eye(3), back, R
    F = np.eye(_NUM)
    F[:3, :3] = F[3:6, 3:6] = back
    # Only what the sensor pushed turns with the base; velocity and fall are those of the map.
    F[:3, 3:6] = -back @ rigid.skew(motion.position)
    F[:3, _VELOCITY] = dt * back @ R.T
    F[_VELOCITY, 3:6] = -R @ rigid.skew(motion.velocity)
    F[:, _BIAS] += G @ motion.by_bias
    F[:, _MOUNT] += G @ motion.by_mount
    return F, G


def _symmetric(P: np.ndarray) -> np.ndarray:
    return 0.5 * (P + P.T)
