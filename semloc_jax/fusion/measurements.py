"""Measured poses, motion and satellite fixes become one pose over time (room: fusion; host).

In: PoseMeasurement, MotionIncrement, GnssMeasurement. Out: FusedPose. Filter: kalman, window: window.
Every fusion is pure: state in, state out; a state is a tree of float64 arrays that a npz file holds bit for bit.
"""

from dataclasses import dataclass, field
from typing import Generic, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri

from semloc_jax.errors import SemlocError
from semloc_jax.fusion.inertial_motion import Moving
from semloc_jax.fusion.motion_noise import MotionNoise
from semloc_jax.fusion.prediction import Calibration, MotionIncrement
from semloc_jax.geometry import rigid
from semloc_jax.solvers.factors import Factors

State = TypeVar("State")
_SAME_TIME_S = 1e-3


class PoseMeasurement(NamedTuple):
    """Pose that one frame was found at; the covariance is that of the right tangent (x, y, z, roll, pitch, yaw)."""

    time_s: float
    T_map_base: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]


class GnssMeasurement(NamedTuple):
    """Satellite fix of the base origin in the map frame [m]; only its horizontal part is used."""

    time_s: float
    p_map: Float[np.ndarray, "3"]
    sigma_m: Float[np.ndarray, "3"]

    @property
    def is_usable(self) -> bool:
        """Whether every number is finite and the receiver states some doubt."""
        is_finite = np.isfinite([self.time_s, *self.p_map, *self.sigma_m]).all()
        return bool(is_finite and (np.asarray(self.sigma_m) > 0.0).all())


class FusedPose(NamedTuple):
    """Best pose at a time, with what was learned about the sensors."""

    time_s: float
    T_map_base: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]
    """Of the right tangent [m, rad]."""
    odometer_scale: float
    gyro_bias_radps: float
    gnss_offset_m: Float[np.ndarray, "2"]
    """What satellite fixes are off by in the map frame, east and north."""
    travel_rad: float = 0.0
    """Direction of travel against base x, positive to the left."""
    travel_sigma_rad: float = 0.0
    """Its standard deviation; 0 where it is not estimated."""
    travel_heading_covariance: float = 0.0
    """Of it with the heading [rad^2]."""
    moving: Moving | None = None
    """Velocity and biases, by a fusion that estimates them: its next increment begins with them."""

    @property
    def calibration(self) -> Calibration:
        """What the next motion increment takes off."""
        return Calibration(self.odometer_scale, self.gyro_bias_radps, self.travel_rad)

    def moved(self, left_m: float, ahead_m: float, turn_deg: float) -> "FusedPose":
        """The pose beside itself, of a vehicle that drives where it did; its heading turned to the left."""
        turn_rad = float(np.deg2rad(turn_deg))
        step = rigid.exp(np.array([ahead_m, left_m, 0.0, 0.0, 0.0, turn_rad]))
        return self._replace(T_map_base=self.T_map_base @ step, travel_rad=self.travel_rad - turn_rad)

    def less_sure(self, left_m2: float, ahead_m2: float, turn_deg2: float) -> "FusedPose":
        """The pose with variances added to its own: what the fusion knows nothing of."""
        more = np.diag([ahead_m2, left_m2, 0.0, 0.0, 0.0, np.deg2rad(np.deg2rad(turn_deg2))])
        return self._replace(covariance=self.covariance + more)


class Innovation(NamedTuple):
    """How well a measurement fits the state: squared normalised difference, degrees of freedom, verdict."""

    chi2: float
    dof: int
    accepted: bool


@dataclass(frozen=True)
class SensorBeliefs:
    """How far odometer scale, gyroscope, mount and satellites may be off, and how fast that changes. All values are
    ours."""

    scale_sigma: float = 0.02
    scale_walk: float = 2e-4
    """How fast the odometer scale changes [1 per root of s]: pressure and temperature of the tyres."""
    gyro_bias_sigma_degps: float = 0.2
    gyro_bias_walk_degps: float = 0.005
    """[deg/s per root of s]."""
    travel_sigma_deg: float = 0.3
    """Direction of travel against base x: tolerance of a mount, toe and thrust angle of the axle."""
    travel_walk_deg: float = 0.003
    """[deg per root of s]: load and crossfall change it slowly."""
    gnss_offset_sigma_m: float = 3.0
    gnss_offset_walk_m: float = 0.15
    """How fast the slow error of the fixes changes [m per root of s]."""
    motion: MotionNoise = field(default_factory=MotionNoise)
    """What the vehicle may do while nothing measures its motion."""

    @property
    def sigma(self) -> Float[np.ndarray, "5"]:
        """Standard deviations of scale, gyroscope bias [rad/s], direction of travel [rad], GNSS offset east, north [m]
        at the start."""
        angles = np.deg2rad([self.gyro_bias_sigma_degps, self.travel_sigma_deg])
        return np.array([self.scale_sigma, *angles, *[self.gnss_offset_sigma_m] * 2])

    @property
    def walk(self) -> Float[np.ndarray, "5"]:
        """How fast they change [per root of s]."""
        angles = np.deg2rad([self.gyro_bias_walk_degps, self.travel_walk_deg])
        return np.array([self.scale_walk, *angles, *[self.gnss_offset_walk_m] * 2])


@runtime_checkable
class Fusion(Protocol, Generic[State]):
    """What window, filter and single frames have in common."""

    def start(self, measurement: PoseMeasurement) -> State:
        """State at the first pose."""
        ...

    def predict(self, state: State, increment: MotionIncrement) -> State:
        """State at `increment.to_s`; the increment begins at the time of the state."""
        ...

    def correct(self, state: State, measurement: PoseMeasurement) -> tuple[State, Innovation]:
        """State with a measured pose; unchanged where the pose is refused."""
        ...

    def correct_gnss(self, state: State, measurement: GnssMeasurement) -> tuple[State, Innovation]:
        """State with a satellite fix; unchanged where the fix is refused."""
        ...

    def correct_term(self, state: State, term: Factors) -> tuple[State, Innovation]:
        """State with a cost term of the user, measured at its time; unchanged where the term is refused."""
        ...

    def pose(self, state: State) -> FusedPose:
        """Pose, covariance and calibration of a state."""
        ...


class SingleFrameState(NamedTuple):
    """Last measured pose, carried on by the motion since."""

    time_s: Float[np.ndarray, ""]
    T_map_base: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]


class SingleFrameFusion:
    """No fusion: the last measured pose, carried on by the odometry in between; what the others are compared with."""

    def start(self, measurement: PoseMeasurement) -> SingleFrameState:
        """State at the first pose."""
        return SingleFrameState(np.float64(measurement.time_s), measurement.T_map_base, measurement.covariance)

    def predict(self, state: SingleFrameState, increment: MotionIncrement) -> SingleFrameState:
        """State propagated by the odometry alone."""
        check_same_time("increment", increment.from_s, float(state.time_s))
        Ad = rigid.adjoint(rigid.inverse(increment.T_from_to))
        covariance = Ad @ state.covariance @ Ad.T + increment.covariance
        T = rigid.normalised(state.T_map_base @ increment.T_from_to)
        return SingleFrameState(np.float64(increment.to_s), T, covariance)

    def correct(self, state: SingleFrameState, measurement: PoseMeasurement) -> tuple[SingleFrameState, Innovation]:
        """The measurement itself; its innovation is reported and never refuses it."""
        check_same_time("pose", measurement.time_s, float(state.time_s))
        difference = rigid.log(rigid.inverse(state.T_map_base) @ measurement.T_map_base)
        return self.start(measurement), Innovation(
            normalised_square(difference, state.covariance + measurement.covariance), 6, True
        )

    def correct_gnss(
        self, state: SingleFrameState, measurement: GnssMeasurement
    ) -> tuple[SingleFrameState, Innovation]:
        """The state as it was: fixes are not used."""
        difference = measurement.p_map[:2] - state.T_map_base[:2, 3]
        R = state.T_map_base[:2, :3]
        spread = R @ state.covariance[:3, :3] @ R.T + np.diag(measurement.sigma_m[:2] ** 2)
        return state, Innovation(normalised_square(difference, spread), 2, False)

    def correct_term(self, state: SingleFrameState, term: Factors) -> tuple[SingleFrameState, Innovation]:
        """The state as it was: terms are not used."""
        return state, Innovation(np.nan, len(term.keys[0]), False)

    def pose(self, state: SingleFrameState) -> FusedPose:
        """Pose and covariance; the calibration is the nominal one."""
        return FusedPose(float(state.time_s), state.T_map_base, state.covariance, 1.0, 0.0, np.zeros(2))


def check_same_time(what: str, time_s: float, state_s: float) -> None:
    """Refuse input that does not belong to the time of the state.

    Raises:
        SemlocError: the times differ by more than a millisecond.
    """
    if not abs(time_s - state_s) <= _SAME_TIME_S:
        raise SemlocError(
            f"{what} at {time_s:.4f} s for a state at {state_s:.4f} s; expected the same time; predict up to it first"
        )


def needs_no_offset(
    fix: GnssMeasurement,
    T_map_base: Float[np.ndarray, "4 4"],
    covariance: Float[np.ndarray, "6 6"],
    gate_probability: float,
) -> bool:
    """Whether a fix fits a pose as it stands.

    Such a fix has not gone astray, whatever the fixes before it say of the offset that they share: a first one that is
    metres off would else be all that is believed, and every right one after it be refused.
    """
    H = T_map_base[:2, :3]
    spread = H @ covariance[:3, :3] @ H.T + np.diag(fix.sigma_m[:2] ** 2)
    square = normalised_square(fix.p_map[:2] - T_map_base[:2, 3], spread)
    return square <= float(chdtri(2, 1.0 - gate_probability))


def normalised_square(difference: np.ndarray, covariance: np.ndarray) -> float:
    """Squared length of a difference in units of its covariance."""
    return float(difference @ np.linalg.solve(covariance, difference))
