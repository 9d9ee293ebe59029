"""Sensor logs of a simulated drive with stated errors (room: simulation; host).

In: the true motion. Out: rows of gps.csv, wheel_odom.csv and imu.csv.
"""

from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from semloc_jax.datasets.inertial import IMU_NOISE, imu_yaml
from semloc_jax.errors import SemlocError
from semloc_jax.maps import GeoOrigin
from semloc_jax.simulation.motion import TrueMotion
from semloc_jax.storage import write_text
from semloc_jax.structs import InertialNoise

_GRAVITY_MPS2 = 9.80665
_EARTH_RADIUS_M = 6_378_137.0
_LARGEST_OFFSET_S = 1.0


@dataclass(frozen=True)
class SensorErrors:
    """Errors of the sensors; the defaults are our choice, for a consumer receiver and a production car.

    Args:
        gnss_bias_m: standard deviation of the error that all fixes of a drive share.
        gnss_walk_m: standard deviation of the slowly changing error (correlated over 10 s).
        gnss_noise_m: standard deviation of the independent error of each fix.
        gnss_outlier_share: share of fixes that are 5-12 m off.
        gnss_dropout_s: length of the gap without fixes; placed in the middle of the log.
        speed_scale: standard deviation of the scale error of the wheel speed.
        yaw_scale: standard deviation of the scale error of the yaw rate.
        speed_noise_mps: standard deviation of the speed.
        yaw_rate_noise_radps: standard deviation of the yaw rate.
        gyro_bias_radps: standard deviation of the gyroscope bias.
        accel_bias_mps2: standard deviation of the accelerometer bias.
        inertial: noise of the inertial sensor and change of its biases.
    """

    gnss_bias_m: float = 1.0
    gnss_walk_m: float = 0.4
    gnss_noise_m: float = 0.3
    gnss_outlier_share: float = 0.04
    gnss_dropout_s: float = 1.5
    speed_scale: float = 0.008
    yaw_scale: float = 0.01
    speed_noise_mps: float = 0.03
    yaw_rate_noise_radps: float = 0.004
    gyro_bias_radps: float = 0.001
    accel_bias_mps2: float = 0.05
    inertial: InertialNoise = field(default_factory=lambda: InertialNoise(2e-4, 3e-3, 2e-5, 1e-3))


@dataclass(frozen=True)
class SensorPlan:
    """What is logged besides the errors.

    Args:
        errors: of the sensors.
        imu_rate_hz: rows of imu.csv in a second.
        imu_offset_s: how far the clock of the IMU is ahead: it stamps time t with t + offset.
        gps_bias_m: horizontal length of the error that all fixes of the drive share; None draws it.
        has_gnss: whether there is a receiver; none under a roof.
    """

    errors: SensorErrors
    imu_rate_hz: float = 100.0
    imu_offset_s: float = 0.0
    gps_bias_m: float | None = None
    has_gnss: bool = True

    def __post_init__(self) -> None:
        if not 10.0 <= self.imu_rate_hz <= 2000.0:
            raise SemlocError(f"imu_rate_hz = {self.imu_rate_hz:g}; expected 10 to 2000 rows in a second")
        if not abs(self.imu_offset_s) <= _LARGEST_OFFSET_S:
            raise SemlocError(f"imu_offset_s = {self.imu_offset_s:g}; expected at most {_LARGEST_OFFSET_S:g} s")
        if self.gps_bias_m is not None and not 0.0 <= self.gps_bias_m <= 1000.0:
            raise SemlocError(f"gps_bias_m = {self.gps_bias_m:g}; expected metres from 0 to 1000")


def write_sensor_logs(
    folder: Path,
    motion: TrueMotion,
    start_s: float,
    end_s: float,
    plan: SensorPlan,
    origin: GeoOrigin,
    rng: np.random.Generator,
) -> dict:
    """Write the logs of the time from `start_s` to `end_s`; returns the drawn errors for meta.json."""
    errors = plan.errors
    scales = {
        "odo_speed_scale": 1.0 + errors.speed_scale * rng.normal(),
        "odo_yaw_scale": 1.0 + errors.yaw_scale * rng.normal(),
    }
    biases = {
        "gps_bias": _fix_bias(plan, rng).tolist(),
        "gyro_bias": (errors.gyro_bias_radps * rng.normal(size=3)).tolist(),
        "acc_bias": (errors.accel_bias_mps2 * rng.normal(size=3)).tolist(),
    }
    told: dict = {**scales, **biases, "errors": asdict(errors), "gps_antenna": "body origin"}
    if plan.has_gnss:
        middle, half = 0.5 * (start_s + end_s), 0.5 * errors.gnss_dropout_s
        told["gps_dropout"] = [middle - half, middle + half]
        times = np.arange(start_s, end_s, 0.2)
        _write_gnss(folder / "gps.csv", motion, times, plan, np.array(biases["gps_bias"]), origin, rng)
    else:
        told |= {"gps_bias": None, "gps_dropout": None}
    _write_wheel(folder / "wheel_odom.csv", motion, np.arange(start_s, end_s, 0.02), errors, scales, rng)
    _write_imu(folder / "imu.csv", motion, (start_s, end_s), plan, biases, rng)
    write_text(folder / IMU_NOISE, imu_yaml(errors.inertial))
    return told | {"imu_rate_hz": plan.imu_rate_hz, "imu_offset_s": plan.imu_offset_s}


def _fix_bias(plan: SensorPlan, rng: np.random.Generator) -> np.ndarray:
    """The error [3] that all fixes share [m]: drawn, or of the stated length in a drawn direction."""
    drawn = rng.normal(size=3)
    size_m = plan.errors.gnss_bias_m if plan.gps_bias_m is None else plan.gps_bias_m / np.hypot(*drawn[:2])
    return size_m * drawn * [1.0, 1.0, 1.5]


def _write_gnss(
    path: Path,
    motion: TrueMotion,
    time_s: np.ndarray,
    plan: SensorPlan,
    bias: np.ndarray,
    origin: GeoOrigin,
    rng: np.random.Generator,
) -> None:
    errors = plan.errors
    middle = 0.5 * (time_s[0] + time_s[-1])
    is_received = np.abs(time_s - middle) > 0.5 * errors.gnss_dropout_s
    decay = np.exp(-0.2 / 10.0)
    walk = np.zeros((len(time_s), 3))
    walk[0] = rng.normal(size=3)
    for k in range(1, len(time_s)):
        walk[k] = decay * walk[k - 1] + np.sqrt(1.0 - decay**2) * rng.normal(size=3)
    p = motion.poses(time_s)[:, :3, 3] + bias + errors.gnss_walk_m * walk
    p += errors.gnss_noise_m * rng.normal(size=p.shape)
    direction = rng.uniform(0.0, 2.0 * np.pi, len(time_s))
    size = np.where(rng.random(len(time_s)) < errors.gnss_outlier_share, rng.uniform(5.0, 12.0, len(time_s)), 0.0)
    p[:, :2] += size[:, None] * np.column_stack([np.cos(direction), np.sin(direction)])
    bias_m = errors.gnss_bias_m if plan.gps_bias_m is None else plan.gps_bias_m
    stated = np.sqrt(bias_m**2 + errors.gnss_walk_m**2 + errors.gnss_noise_m**2)
    lines = ["t,lat_deg,lon_deg,alt_m,east_m,north_m,up_m,sigma_e,sigma_n,sigma_u"]
    for t, (east, north, up), received in zip(time_s, p, is_received, strict=True):
        if received:
            lat, lon = _to_degrees(east, north, origin)
            lines.append(
                f"{t:.3f},{lat:.9f},{lon:.9f},{origin.alt_m + up:.3f},{east:.3f},{north:.3f},{up:.3f},"
                f"{stated:.2f},{stated:.2f},{1.5 * stated:.2f}"
            )
    write_text(path, "\n".join(lines) + "\n")


def _to_degrees(east_m: float, north_m: float, origin: GeoOrigin) -> tuple[float, float]:
    """Latitude and longitude on a sphere: within centimetres over the few hundred metres of a simulated drive."""
    lat = origin.lat_deg + np.degrees(north_m / _EARTH_RADIUS_M)
    return lat, origin.lon_deg + np.degrees(east_m / (_EARTH_RADIUS_M * np.cos(np.radians(origin.lat_deg))))


def _write_wheel(
    path: Path,
    motion: TrueMotion,
    time_s: np.ndarray,
    errors: SensorErrors,
    scales: dict[str, float],
    rng: np.random.Generator,
) -> None:
    step = _steps(motion, time_s)
    speed = step[:, 0, 3] / 0.02 * scales["odo_speed_scale"] + errors.speed_noise_mps * rng.normal(size=len(time_s))
    yaw_rate = np.arctan2(step[:, 1, 0], step[:, 0, 0]) / 0.02 * scales["odo_yaw_scale"]
    yaw_rate = yaw_rate + errors.yaw_rate_noise_radps * rng.normal(size=len(time_s))
    lines = ["t,v_m_s,yaw_rate_rad_s,v_left,v_right"]
    lines += [
        f"{t:.5f},{v:.5f},{w:.5f},{v - 0.8 * w:.5f},{v + 0.8 * w:.5f}"
        for t, v, w in zip(time_s, speed, yaw_rate, strict=True)
    ]
    write_text(path, "\n".join(lines) + "\n")


def _write_imu(
    path: Path,
    motion: TrueMotion,
    ends_s: tuple[float, float],
    plan: SensorPlan,
    biases: dict[str, list[float]],
    rng: np.random.Generator,
) -> None:
    step_s, half, noise = 1.0 / plan.imu_rate_hz, 0.005, plan.errors.inertial
    time_s = np.arange(*ends_s, step_s)
    # A stream of its own: what is drawn from the other one stays what it is.
    walk = np.random.Generator(rng.bit_generator.jumped()).normal(size=(len(time_s), 6)) * noise.bias_walk
    gyro_walk, accel_walk = np.split(np.sqrt(step_s) * np.cumsum(walk, axis=0), 2, axis=1)
    poses = [motion.poses(time_s + offset) for offset in (-half, 0.0, half)]
    turn = np.swapaxes(poses[0][:, :3, :3], 1, 2) @ poses[2][:, :3, :3]
    gyro = Rotation.from_matrix(turn).as_rotvec() / (2.0 * half) + biases["gyro_bias"] + gyro_walk
    gyro += noise.gyro_density / np.sqrt(step_s) * rng.normal(size=gyro.shape)
    # A wider stencil for the second derivative keeps rounding and the knots of the path out of it.
    wide = 0.1
    before, after = motion.poses(time_s - wide)[:, :3, 3], motion.poses(time_s + wide)[:, :3, 3]
    accel_map = (before - 2.0 * poses[1][:, :3, 3] + after) / wide**2 + [0.0, 0.0, _GRAVITY_MPS2]
    accel = np.einsum("nji,nj->ni", poses[1][:, :3, :3], accel_map) + biases["acc_bias"] + accel_walk
    accel += noise.accel_density / np.sqrt(step_s) * rng.normal(size=accel.shape)
    lines = ["t,gx_rad_s,gy,gz,ax_m_s2,ay,az"]
    lines += [
        f"{t:.5f}," + ",".join(f"{value:.5f}" for value in (*w, *a))
        for t, w, a in zip(time_s + plan.imu_offset_s, gyro, accel, strict=True)
    ]
    write_text(path, "\n".join(lines) + "\n")


def _steps(motion: TrueMotion, time_s: np.ndarray) -> np.ndarray:
    """T_base(t - 10 ms)_base(t + 10 ms) for each time."""
    return np.linalg.inv(motion.poses(time_s - 0.01)) @ motion.poses(time_s + 0.01)
