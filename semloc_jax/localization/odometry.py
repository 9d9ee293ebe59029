"""The way of a vehicle by cameras and an inertial sensor, without any map (room: localization; host).

In: a Drive with images and inertial data. Out: OdometryFrame of one frame after another.
The frame of the poses is `odom`: the place of the first pose, z up as the first seconds tell it, x ahead. Wheels join
where they are asked for.
"""

import itertools
import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from semloc_jax.datasets import Drive, Frame
from semloc_jax.datasets.inertial import require_usable
from semloc_jax.errors import SemlocError
from semloc_jax.fusion.inertial_moment import InertialMoment, InertialWindowConfig
from semloc_jax.fusion.inertial_samples import Steps, capacity_for, rotation_between, steps_between
from semloc_jax.fusion.inertial_start import InertialStartConfig, started
from semloc_jax.fusion.inertial_states import STATE
from semloc_jax.fusion.inertial_window import InertialEstimate, InertialWindow
from semloc_jax.fusion.seen_velocity import seen_velocity
from semloc_jax.fusion.velocity_sample import VelocitySample
from semloc_jax.geometry import rigid
from semloc_jax.perception.tracks import CornerConfig, FeatureTracker, Scenery, Tracks

_LOG = logging.getLogger(__name__)
_REREAD_S = 1e-3
"""A clock that is off by more than this is taken into account in the inertial steps of the start."""
_CLOCK_SIGMAS = 4.0
ScenerySource = Callable[[Frame, str], Scenery | None]
"""What masks say of the image of a camera."""


@dataclass(frozen=True)
class OdometryConfig:
    """How a drive is followed by cameras and inertial sensor."""

    tracks: CornerConfig = field(default_factory=CornerConfig)
    window: InertialWindowConfig = field(default_factory=InertialWindowConfig)
    start: InertialStartConfig = field(default_factory=InertialStartConfig)
    standing_flow_px: float = 0.3
    """Corners of a vehicle that stands move less between images."""
    standing_rate_radps: float = 0.02
    """And it turns less, the bias of the sensor included."""
    standing_force_mps2: float = 0.15
    """And its force varies less (standard deviation)."""
    retry_s: float = 1.0
    """A start that is refused is tried again so much later."""


class OdometryFrame(NamedTuple):
    """What is known of one frame."""

    time_s: float
    T_odom_base: Float[np.ndarray, "4 4"]
    velocity_odom: Float[np.ndarray, "3"]
    bias: Float[np.ndarray, "6"]
    sigma: Float[np.ndarray, "22"]
    """Standard deviations in the order of `inertial_states`; NaN during the start."""
    num_followed: int
    num_landmarks: int
    is_standing: bool
    mount_rad: Float[np.ndarray, "3"] = np.zeros(3)
    """Rotation vector that turns the axes of the inertial sensor into those of the base."""
    delay_s: float = 0.0
    """Clock of the inertial sensor less that of the cameras."""
    velocity: VelocitySample | None = None
    """In the axes of the vehicle, and how long its error lasts; None where a later image was needed to know it."""


class VisualInertialOdometry:
    """Follows a vehicle: first collects the seconds of a start, then one window step for each frame."""

    def __init__(self, drive: Drive, cameras: Sequence[str], config: OdometryConfig, with_wheels: bool) -> None:
        """Nothing is read yet.

        Raises:
            SemlocError: the drive has no inertial data, no images, or no wheels where they are asked for.
        """
        _require(drive, cameras, with_wheels)
        self.drive, self.cameras, self.config, self.with_wheels = drive, tuple(cameras), config, with_wheels
        self.reason = ""
        """Why the last start was refused."""
        self._tracker = FeatureTracker(len(self.cameras), config.tracks)
        margin_s = _CLOCK_SIGMAS * config.window.delay_sigma_s
        first_s, last_s = drive.imu.time_s[[0, -1]] + [margin_s, -margin_s]
        self.frames = tuple(frame for frame in drive.frames if first_s <= frame.time_s <= last_s)
        """Those that the inertial log spans."""
        if len(self.frames) < len(drive):
            _LOG.warning(
                "drive %s: %d of %d frames lie outside the inertial log (%.2f .. %.2f s); left out",
                drive.name, len(drive) - len(self.frames), len(drive), first_s, last_s,
            )  # fmt: skip
        self._capacity = capacity_for(drive.imu, np.array([frame.time_s for frame in self.frames]))
        self._waiting: list[InertialMoment] = []
        self._window: InertialWindow | None = None
        self._before_s: float | None = None
        self._bias_radps, self._delay_s = np.zeros(3), 0.0
        self._T_odom_oldest = np.eye(4)
        """Of the oldest state of the window."""

    def step(self, frame: Frame, scenery: ScenerySource | None = None) -> list[OdometryFrame]:
        """Go on to the next frame.

        Returns:
            Nothing while the start is awaited; all frames of the start when it is found; then one for each frame.
        """
        moment = self._moment(frame, scenery)
        window = self._window
        if window is None:
            return self._awaited(moment)
        # What the window learns of its vertical turns all its states: the way goes on by motions within the window.
        self._T_odom_oldest = self._T_odom_oldest @ window.motion(0, 1)
        estimate = window.add(moment)
        self._learn(estimate)
        T_odom_base = rigid.normalised(self._T_odom_oldest @ window.motion(0, -1))
        return [_frame_of(estimate, moment, T_odom_base)]

    def _learn(self, estimate: InertialEstimate) -> None:
        self._bias_radps, self._delay_s = estimate.state.bias[:3], float(estimate.state.delay_s[0])

    def _awaited(self, moment: InertialMoment) -> list[OdometryFrame]:
        self._waiting.append(moment)
        if len(self._waiting) == 1:
            self._waiting[0] = moment._replace(steps=None)
        rules, needed = self.config.start, self.config.window.num_states
        lasted_s = moment.time_s - self._waiting[0].time_s
        if lasted_s < rules.duration_s - 1e-6 or len(self._waiting) < needed:
            return []
        start = started(self._waiting, self.config.window, rules, self.drive.imu.noise)
        if start.window is None:
            self.reason = start.reason
            first_s = self._waiting[0].time_s + self.config.retry_s
            self._waiting = [m for m in self._waiting if m.time_s >= first_s - 1e-6]
            self._waiting[0] = self._waiting[0]._replace(steps=None)
            return []
        window, estimate = start.window, start.estimate
        self._learn(estimate)
        if abs(self._delay_s) > _REREAD_S:
            window.moments = self._reread(window.moments)
            estimate = window.solve()
        found = [_frame_at(window, index) for index in range(len(window.moments) - 1)]
        found.append(_frame_of(estimate, moment, estimate.state.T_map_base))
        self._T_odom_oldest = window.state(-needed).T_map_base
        self._window, self._waiting = window.shrunk(needed), []
        return found

    def _reread(self, moments: list[InertialMoment]) -> list[InertialMoment]:
        """The moments with inertial steps by the clock as it is known now."""
        ends = itertools.pairwise(moments)
        later = [m._replace(steps=self._steps(b.time_s, m.time_s), delay_s=self._delay_s) for b, m in ends]
        return [moments[0], *later]

    def _steps(self, from_s: float, to_s: float) -> Steps:
        """Between two times of the cameras."""
        return steps_between(self.drive.imu, from_s + self._delay_s, to_s + self._delay_s, self._capacity)

    def _moment(self, frame: Frame, scenery: ScenerySource | None) -> InertialMoment:
        rig = frame.rig.select(self.cameras)
        steps = None
        if self._before_s is not None:
            steps = self._steps(self._before_s, frame.time_s)
        R = np.eye(3) if steps is None else rotation_between(steps, self._bias_radps).T
        seen = None if scenery is None else [scenery(frame, name) for name in self.cameras]
        greys = [_grey(frame, name) for name in self.cameras]
        tracks = self._tracker.step(greys, rig, R, seen, self._foretold_way(steps))
        self._before_s = frame.time_s
        speed = None
        if self.with_wheels:
            wheels = self.drive.odometry
            speed = float(np.interp(frame.time_s, wheels.time_s, wheels.speed_mps))
        standing = self._is_standing(steps, tracks, speed)
        T_base_cam = np.asarray(rig.T_base_cam)
        return InertialMoment(frame.time_s, tracks, T_base_cam, steps, speed, standing, self._delay_s)

    def _foretold_way(self, steps: Steps | None) -> Float[np.ndarray, "3"] | None:
        """How the base moves over the steps, in its axes before, as fast as it went; None while that is not known."""
        if self._window is None or steps is None:
            return None
        last = self._window.state(-1)
        return last.T_map_base[:3, :3].T @ last.velocity_map * float(steps.step_s.sum())

    def _is_standing(self, steps: Steps | None, tracks: Tracks, speed_mps: float | None) -> bool:
        """No flow in the images, a quiet inertial sensor, wheels that do not turn."""
        if steps is None or (speed_mps is not None and abs(speed_mps) > 0.02):
            return False
        used = steps.step_s > 0
        turning = np.abs(steps.gyro_radps[used]).max(initial=0.0)
        shaking = steps.accel_mps2[used].std(axis=0).max(initial=0.0)
        is_quiet = turning < self.config.standing_rate_radps and shaking < self.config.standing_force_mps2
        return bool(is_quiet and tracks.num_followed >= 10 and tracks.flow_px < self.config.standing_flow_px)


def follow(
    odometry: VisualInertialOdometry, frames: Iterable[Frame], scenery: ScenerySource | None = None
) -> list[OdometryFrame]:
    """All frames of a drive.

    Raises:
        SemlocError: no start was found; says why.
    """
    found: list[OdometryFrame] = []
    for frame in frames:
        found += odometry.step(frame, scenery)
    if not found:
        reason = odometry.reason or (
            f"the drive is shorter than {odometry.config.start.duration_s:g} s or "
            f"{odometry.config.window.num_states} images"
        )
        raise SemlocError(f"odometry of drive {odometry.drive.name}: no start was found: {reason}")
    return found


def _require(drive: Drive, cameras: Sequence[str], with_wheels: bool) -> None:
    if drive.imu is None or not np.abs(drive.imu.accel_mps2).any():
        raise SemlocError(
            f"drive {drive.name}: has no inertial data (imu.csv with rates and forces), which --motion vio and both "
            "need; use --motion wheels"
        )
    require_usable(drive.imu, f"drive {drive.name}")
    if with_wheels and drive.odometry is None:
        raise SemlocError(f"drive {drive.name}: has no wheel odometry; use --motion vio")
    drive.rig.select(cameras)  # names what is not in the calibration
    without = [name for name in cameras if not drive.frames[0].has("rgb", name)]
    if without:
        raise SemlocError(
            f"drive {drive.name}: no images of camera {', '.join(without)}; corners are followed in images, masks do "
            "not do; name cameras with images (--cameras), or use --motion wheels"
        )


def _grey(frame: Frame, camera: str) -> np.ndarray:
    return cv2.cvtColor(frame.image(camera), cv2.COLOR_BGR2GRAY)


def _frame_of(
    estimate: InertialEstimate, moment: InertialMoment, T_odom_base: Float[np.ndarray, "4 4"]
) -> OdometryFrame:
    state = estimate.state
    sigma = np.sqrt(np.maximum(np.diag(estimate.covariance), 0.0))
    velocity_odom = T_odom_base[:3, :3] @ state.T_map_base[:3, :3].T @ state.velocity_map
    return OdometryFrame(
        time_s=moment.time_s,
        T_odom_base=T_odom_base,
        velocity_odom=velocity_odom,
        bias=state.bias,
        sigma=sigma,
        num_followed=moment.tracks.num_followed,
        num_landmarks=estimate.num_landmarks,
        is_standing=moment.is_standing,
        mount_rad=state.mount_rad,
        delay_s=float(state.delay_s[0]),
        velocity=seen_velocity(estimate),
    )


def _frame_at(window: InertialWindow, index: int) -> OdometryFrame:
    state, moment = window.state(index), window.moments[index]
    return OdometryFrame(
        time_s=moment.time_s,
        T_odom_base=state.T_map_base,
        velocity_odom=state.velocity_map,
        bias=state.bias,
        sigma=np.full(STATE, np.nan),
        num_followed=moment.tracks.num_followed,
        num_landmarks=int(window.pool.seen[:, index].sum()),
        is_standing=moment.is_standing,
        mount_rad=state.mount_rad,
        delay_s=float(state.delay_s[0]),
    )
