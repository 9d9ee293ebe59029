"""Kalman fusion with odometry and satellites behind chi-square and mean-motion gates (room: fusion; host).

In: PoseMeasurement, MotionIncrement, GnssMeasurement. Out: FusedPose; the light alternative to the window.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri

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
from semloc_jax.fusion.prediction import Calibration, MotionIncrement, MotionQuality, coasted
from semloc_jax.fusion.window_terms import fit, is_finite
from semloc_jax.geometry import rigid
from semloc_jax.solvers.factors import Factors


@dataclass(frozen=True)
class KalmanConfig:
    """Noise of the sensors and limits of outliers; all values are our choice."""

    sensors: SensorBeliefs = field(default_factory=SensorBeliefs)
    gate_probability: float = 0.999
    """A measurement beyond this quantile of the chi-square distribution is refused."""
    motion_gate_m: float = 1.5
    """A step that differs from the mean motion by more than this, and what `motion_gate_mps2` adds, is refused."""
    motion_gate_mps2: float = 4.0
    motion_memory_s: float = 1.0
    """Time over which the mean motion is taken; it says nothing after twice this time without a measured pose."""


class KalmanState(NamedTuple):
    """State of `KalmanFusion`; the error is (right tangent of the pose, scale, gyro bias, travel, GNSS offset)."""

    time_s: Float[np.ndarray, ""]
    T_map_base: Float[np.ndarray, "4 4"]
    odometer_scale: Float[np.ndarray, ""]
    gyro_bias_radps: Float[np.ndarray, ""]
    travel_rad: Float[np.ndarray, ""]
    gnss_offset_m: Float[np.ndarray, "2"]
    covariance: Float[np.ndarray, "11 11"]
    measured_s: Float[np.ndarray, ""]
    """Time of the last accepted pose measurement."""
    T_measured: Float[np.ndarray, "4 4"]
    mean_twist: Float[np.ndarray, "6"]
    """Mean motion between measured poses [m/s, rad/s]; nan before the second of them."""


class KalmanFusion:
    """Error-state Kalman filter on SE(3) with odometer scale, gyroscope bias and GNSS-to-map offset.

    A measured pose is refused when the chi-square test of its innovation fails, or when its step from the last measured
    pose does not fit the mean motion. Refused or not, the covariance grows with the motion: the gate opens again.
    """

    def __init__(self, config: KalmanConfig | None = None) -> None:
        """A filter with the given beliefs."""
        self.config = config or KalmanConfig()

    def start(self, measurement: PoseMeasurement) -> KalmanState:
        """State at the first pose, with nominal calibration."""
        covariance = np.zeros((11, 11))
        covariance[:6, :6] = measurement.covariance
        covariance[6:, 6:] = np.diag(self.config.sensors.sigma**2)
        T, time_s, zero = measurement.T_map_base.astype(np.float64), np.float64(measurement.time_s), np.float64(0.0)
        nominal = (np.float64(1.0), zero, zero, np.zeros(2))
        return KalmanState(time_s, T, *nominal, covariance, time_s, T, np.full(6, np.nan))

    def predict(self, state: KalmanState, increment: MotionIncrement) -> KalmanState:
        """State after the motion; where no sensor measures it, the mean motion continues."""
        check_same_time("increment", increment.from_s, float(state.time_s))
        step_s = abs(increment.to_s - increment.from_s)
        if increment.quality is MotionQuality.MISSING and np.isfinite(state.mean_twist).all():
            age_s = float(state.time_s - state.measured_s)
            memory_s, noise = self.config.motion_memory_s, self.config.sensors.motion
            increment = coasted(increment, state.mean_twist, age_s, memory_s, noise)
        motion = increment.corrected(_calibration(state))
        F = np.eye(11)
        F[:6, :6] = rigid.adjoint(rigid.inverse(motion))
        F[:6, 6:9] = increment.jacobian
        Q = np.zeros((11, 11))
        Q[:6, :6] = increment.covariance
        Q[6:, 6:] = np.diag(self.config.sensors.walk**2) * step_s
        return state._replace(
            time_s=np.float64(increment.to_s),
            T_map_base=rigid.normalised(state.T_map_base @ motion),
            covariance=_symmetric(F @ state.covariance @ F.T + Q),
        )

    def correct(self, state: KalmanState, measurement: PoseMeasurement) -> tuple[KalmanState, Innovation]:
        """State with a measured pose, unless the chi-square test or the mean motion refuses it."""
        check_same_time("pose", measurement.time_s, float(state.time_s))
        difference = rigid.log(rigid.inverse(state.T_map_base) @ measurement.T_map_base)
        # log(exp(-e) exp(difference)) = difference - J e for a small error e of the state.
        H = np.zeros((6, 11))
        H[:, :6] = np.linalg.inv(rigid.right_jacobian(-difference))
        corrected, square = _update(state, difference, H, measurement.covariance)
        fits = square <= chdtri(6, 1.0 - self.config.gate_probability) and self._fits_mean_motion(state, measurement)
        if not fits:
            return state, Innovation(square, 6, False)
        return self._with_motion(corrected, state, measurement), Innovation(square, 6, True)

    def correct_gnss(self, state: KalmanState, measurement: GnssMeasurement) -> tuple[KalmanState, Innovation]:
        """State with a satellite fix, unless the chi-square test refuses it."""
        check_same_time("fix", measurement.time_s, float(state.time_s))
        difference = measurement.p_map[:2] - state.T_map_base[:2, 3] - state.gnss_offset_m
        H = np.zeros((2, 11))
        H[:, :3] = state.T_map_base[:2, :3]
        H[:, 9:] = np.eye(2)
        corrected, square = _update(state, difference, H, np.diag(measurement.sigma_m[:2] ** 2))
        gate = self.config.gate_probability
        fits = needs_no_offset(measurement, state.T_map_base, state.covariance[:6, :6], gate)
        accepted = fits or square <= float(chdtri(2, 1.0 - gate))
        return (corrected if accepted else state), Innovation(square, 2, accepted)

    def correct_term(self, state: KalmanState, term: Factors) -> tuple[KalmanState, Innovation]:
        """State with a term that was measured at the time of the state, unless the chi-square test refuses it."""
        innovation, r, J = fit(term, state.T_map_base, state.covariance[:6, :6])
        if not is_finite(term) or innovation.chi2 > chdtri(innovation.dof, 1.0 - self.config.gate_probability):
            return state, innovation
        H = np.zeros((len(r), 11))
        H[:, :6] = J
        corrected, _ = _update(state, -r, H, np.eye(len(r)))
        return corrected, innovation._replace(accepted=True)

    def pose(self, state: KalmanState) -> FusedPose:
        """Pose, covariance and calibration of a state."""
        found = _calibration(state)
        sensors = found.odometer_scale, found.gyro_bias_radps, state.gnss_offset_m, found.travel_rad
        return FusedPose(float(state.time_s), state.T_map_base, state.covariance[:6, :6], *sensors)

    def _fits_mean_motion(self, state: KalmanState, measurement: PoseMeasurement) -> bool:
        since_s = measurement.time_s - float(state.measured_s)
        if not np.isfinite(state.mean_twist).all() or since_s > 2.0 * self.config.motion_memory_s:
            return True
        expected = state.T_measured @ rigid.exp(state.mean_twist * since_s)
        off_m = np.linalg.norm(measurement.T_map_base[:3, 3] - expected[:3, 3])
        return bool(off_m <= self.config.motion_gate_m + 0.5 * self.config.motion_gate_mps2 * since_s**2)

    def _with_motion(self, corrected: KalmanState, state: KalmanState, measurement: PoseMeasurement) -> KalmanState:
        """The corrected state with the step from the last measured pose in its mean motion."""
        since_s = measurement.time_s - float(state.measured_s)
        mean = state.mean_twist
        if since_s > 0.0:
            twist = rigid.log(rigid.inverse(state.T_measured) @ measurement.T_map_base) / since_s
            share = 1.0 - np.exp(-since_s / self.config.motion_memory_s)
            mean = mean + share * (twist - mean) if np.isfinite(mean).all() else twist
        return corrected._replace(
            measured_s=np.float64(measurement.time_s), T_measured=measurement.T_map_base, mean_twist=mean
        )


def _calibration(state: KalmanState) -> Calibration:
    return Calibration(float(state.odometer_scale), float(state.gyro_bias_radps), float(state.travel_rad))


def _update(state: KalmanState, difference: np.ndarray, H: np.ndarray, R: np.ndarray) -> tuple[KalmanState, float]:
    """State after one linear correction, in the covariance form that stays positive (Joseph), and its chi-square."""
    P = state.covariance
    S = H @ P @ H.T + R
    gain = np.linalg.solve(S, H @ P).T
    step = gain @ difference
    rest = np.eye(len(P)) - gain @ H
    corrected = state._replace(
        T_map_base=rigid.normalised(state.T_map_base @ rigid.exp(step[:6])),
        odometer_scale=state.odometer_scale + step[6],
        gyro_bias_radps=state.gyro_bias_radps + step[7],
        travel_rad=state.travel_rad + step[8],
        gnss_offset_m=state.gnss_offset_m + step[9:],
        covariance=_symmetric(rest @ P @ rest.T + gain @ R @ gain.T),
    )
    return corrected, normalised_square(difference, S)


def _symmetric(P: np.ndarray) -> np.ndarray:
    return 0.5 * (P + P.T)
