"""Sensor logs of a drive: satellite fixes, wheel odometry, inertial data (room: datasets; host).

In: csv files of the drive layout. Out: GnssTrack, WheelOdometry, Imu.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float

from semloc_jax.datasets.clock import TIME_NAMES, seconds
from semloc_jax.datasets.tables import column_names, find_columns
from semloc_jax.datasets.templates import GNSS_COLUMNS
from semloc_jax.errors import SemlocError
from semloc_jax.geometry.geodesy import Geodetic, enu_from_wgs84, wgs84_from_enu
from semloc_jax.storage import FARTHEST_M
from semloc_jax.structs import InertialNoise

_FASTEST_MPS, _HIGHEST_M = 150.0, 1e5
"""No vehicle is faster, no road is higher."""
_LARGEST_READING = 1e6
"""Beyond what a sensor reads, in any unit; computed with in float32, 1e39 would be infinite."""
_DECIMALS = 4
"""Decimals of metres that fixes from degrees keep, so that a drive is the same in every format; our choice."""


@dataclass(frozen=True)
class GnssTrack:
    """Satellite fixes in the map frame.

    Args:
        time_s: times of the fixes [s]; drop-outs are simply absent.
        p_enu: positions of the antenna, east north up of the map frame [m].
        sigma_m: standard deviations the receiver states for east, north, up [m].
        antenna_base: where the antenna sits on the vehicle [m].
        origin: place on the earth of the frame of `p_enu` where that is not the frame of the map yet; see `seen_from`.
    """

    time_s: Float[np.ndarray, " n"]
    p_enu: Float[np.ndarray, "n 3"]
    sigma_m: Float[np.ndarray, "n 3"]
    antenna_base: tuple[float, float, float] = (0.0, 0.0, 0.0)
    origin: Geodetic | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.time_s).all() and (np.abs(self.p_enu) < FARTHEST_M).all()):
            raise SemlocError(
                "GNSS: a time or position is NaN, infinite or beyond the earth; expected seconds and metres; drop such "
                "rows"
            )
        wrong = ~((self.sigma_m > 0.0) & (self.sigma_m < _HIGHEST_M)).all(axis=1)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise SemlocError(
                f"GNSS: the fix at {self.time_s[row]:.3f} s states standard deviations {self.sigma_m[row].tolist()} m; "
                "expected positive ones; leave the cell empty where they are not known"
            )

    @classmethod
    def from_wgs84(
        cls,
        time_s: Float[np.ndarray, " n"],
        lat_lon_alt: Float[np.ndarray, "n 3"],
        sigma_m: Float[np.ndarray, "n 3"],
        antenna_base: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> "GnssTrack":
        """Fixes in degrees and ellipsoidal height [m], in time order, in the frame of the first of them."""
        sigma_m = _known_sigma(sigma_m)
        usable = np.isfinite(lat_lon_alt).all(axis=1) & np.isfinite(time_s)
        usable &= np.abs(lat_lon_alt[:, 2]) < _HIGHEST_M
        order = np.flatnonzero(usable)[np.argsort(time_s[usable], kind="stable")]
        if not len(order):
            raise SemlocError("GNSS: no row holds a position; expected latitude and longitude in degrees")
        origin = tuple(float(value) for value in lat_lon_alt[order[0]])
        p_enu = enu_from_wgs84(*lat_lon_alt[order].T, origin)
        return cls(time_s[order], p_enu, sigma_m[order], antenna_base, origin)

    def seen_from(self, origin: Geodetic) -> "GnssTrack":
        """The fixes in the frame that sits at `origin` on the earth, to 0.1 mm; unchanged where they are in a map."""
        if self.origin is None:
            return self
        p_enu = enu_from_wgs84(*wgs84_from_enu(self.p_enu, self.origin), tuple(origin))
        # Degrees leave errors of nanometres, with which a search can choose another of two equally good starts.
        return replace(self, p_enu=np.round(p_enu, _DECIMALS), origin=None)


@dataclass(frozen=True)
class WheelOdometry:
    """Speed and yaw rate of the rear axle.

    Args:
        time_s: increasing sample times [s].
        speed_mps: signed speed along base x [m/s].
        yaw_rate_radps: yaw rate about base z [rad/s].
    """

    time_s: Float[np.ndarray, " n"]
    speed_mps: Float[np.ndarray, " n"]
    yaw_rate_radps: Float[np.ndarray, " n"]

    def __post_init__(self) -> None:
        if not np.isfinite([self.time_s, self.speed_mps, self.yaw_rate_radps]).all():
            raise SemlocError("wheel odometry: a value is NaN or infinite; expected finite numbers; drop such rows")
        if np.abs(self.yaw_rate_radps).max(initial=0.0) > _LARGEST_READING:
            raise SemlocError(
                f"wheel odometry: a yaw rate of {np.abs(self.yaw_rate_radps).max():g} rad/s; expected that of a "
                "vehicle; drop such rows"
            )
        if np.abs(self.speed_mps).max(initial=0.0) > _FASTEST_MPS:
            raise SemlocError(
                f"wheel odometry: a speed of {np.abs(self.speed_mps).max():g} m/s; expected that of a vehicle; is it "
                "in km/h or mm/s?"
            )
        if len(self.time_s) < 2 or np.any(np.diff(self.time_s) <= 0.0):
            raise SemlocError(
                f"wheel odometry: {len(self.time_s)} samples whose times do not all increase; expected at least 2 "
                "samples in time order"
            )

    @cached_property
    def _path(self) -> Float[np.ndarray, "n 4"]:
        """x, y, yaw and travelled distance at the sample times; the motion between two samples is an arc."""
        step_s = np.diff(self.time_s)
        turn = _mean_of_neighbours(self.yaw_rate_radps) * step_s
        advance = _mean_of_neighbours(self.speed_mps) * step_s
        yaw = np.concatenate([[0.0], np.cumsum(turn)])
        course = yaw[:-1] + 0.5 * turn
        chord = advance * np.sinc(turn / (2.0 * np.pi))
        steps = np.column_stack([chord * np.cos(course), chord * np.sin(course), turn, np.abs(advance)])
        return np.vstack([np.zeros(4), np.cumsum(steps, axis=0)])

    def dead_reckon(self, time_s: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k 3"]:
        """Planar poses x, y [m], yaw [rad] in the `odom` frame; beyond the log the last speed and yaw rate continue."""
        return self._at(time_s)[:, :3]

    def distance_m(self, time_s: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Travelled distance since the first sample [m], reversing included."""
        return self._at(time_s)[:, 3]

    def relative_motion(self, from_s: float, to_s: float) -> Float[np.ndarray, "4 4"]:
        """T_base(from)_base(to): the planar motion of the vehicle between two times."""
        start, end = self.dead_reckon(np.array([from_s, to_s]))
        cos, sin = np.cos(start[2]), np.sin(start[2])
        dx, dy = end[:2] - start[:2]
        T = np.eye(4)
        T[:2, 3] = cos * dx + sin * dy, -sin * dx + cos * dy
        turn = end[2] - start[2]
        T[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        return T

    def _at(self, time_s: np.ndarray) -> np.ndarray:
        path = np.column_stack([np.interp(time_s, self.time_s, column) for column in self._path.T])
        nearest = np.clip(time_s, self.time_s[0], self.time_s[-1])
        beyond_s = time_s - nearest
        speed = np.interp(nearest, self.time_s, self.speed_mps)
        turn = np.interp(nearest, self.time_s, self.yaw_rate_radps) * beyond_s
        course = path[:, 2] + 0.5 * turn
        advance = speed * beyond_s
        step = np.column_stack([advance * np.cos(course), advance * np.sin(course), turn, np.abs(speed) * beyond_s])
        return path + step


@dataclass(frozen=True)
class Imu:
    """Inertial data in the base frame.

    Args:
        time_s: sample times [s].
        gyro_radps: angular rate about base x, y, z [rad/s].
        accel_mps2: specific force along base x, y, z [m/s^2].
        noise: of the sensor, as a file states it; else that of a production car.
    """

    time_s: Float[np.ndarray, " n"]
    gyro_radps: Float[np.ndarray, "n 3"]
    accel_mps2: Float[np.ndarray, "n 3"]
    noise: InertialNoise = field(default_factory=InertialNoise)

    def __post_init__(self) -> None:
        readings = np.column_stack([self.gyro_radps, self.accel_mps2])
        wrong = ~((np.abs(readings) < _LARGEST_READING).all(axis=1) & np.isfinite(self.time_s))
        if wrong.any():
            raise SemlocError(
                f"imu: row {int(np.argmax(wrong)) + 1} holds NaN, an infinite or a huge number; expected rad/s and "
                "m/s^2; drop such rows"
            )
        if np.any(np.diff(self.time_s) <= 0.0):
            row = int(np.argmax(np.diff(self.time_s) <= 0.0)) + 2
            raise SemlocError(f"imu: row {row} is not later than that before; expected time order; sort the rows")


_DEGREES = {"lat": ("lat_deg", "latitude", "lat"), "lon": ("lon_deg", "longitude", "lon", "lng", "long")}
_DEGREES |= {"alt": ("alt_m", "altitude", "alt", "height", "ele")}
_METRES = {"east": ("east_m", "east", "easting"), "north": ("north_m", "north", "northing"), "up": ("up_m", "up")}
_SIGMA = ("sigma_e", "sigma_n", "sigma_u")
_WHEELS = {"speed": ("v_m_s", "speed_mps", "speed", "v")}
_WHEELS |= {"rate": ("yaw_rate_rad_s", "yaw_rate_radps", "yaw_rate", "yawrate")}
_INERTIAL = {"gx": ("gx_rad_s", "gx", "wx"), "gy": ("gy", "gy_rad_s", "wy"), "gz": ("gz", "gz_rad_s", "wz")}
_INERTIAL |= {"ax": ("ax_m_s2", "ax"), "ay": ("ay", "ay_m_s2"), "az": ("az", "az_m_s2")}
_UNKNOWN_SIGMA_M = (3.0, 3.0, 6.0)
"""Accuracy assumed of a receiver that does not state one; our choice."""


def log_of(path: Path) -> str | None:
    """The log that a table is by its columns: gps.csv, wheel_odom.csv, imu.csv; None where it is none of them."""
    logs = {"imu.csv": _INERTIAL, "wheel_odom.csv": _WHEELS}
    logs |= {"gps.csv": {key: _DEGREES[key] for key in ("lat", "lon")}}
    for name, wanted in logs.items():
        if column_names(path, {"time": TIME_NAMES, **wanted}).keys() == {"time", *wanted}:
            return name
    return None


def read_gnss(path: Path) -> GnssTrack:
    """Fixes of a `gps.csv`: east, north, up of a map, else latitude, longitude and height in degrees and metres.

    Times are in s, ms, us or ns. Rows without a position are left out; where no standard deviation is stated, 3 m and
    6 m in height are taken.
    """
    has = column_names(path, {"time": TIME_NAMES, **_METRES, **_DEGREES})
    place = next((kind for kind in (_METRES, _DEGREES) if set(tuple(kind)[:2]) <= has.keys()), None)
    if place is None or "time" not in has:
        lacking = "position" if place is None else "time"
        raise SemlocError(f"table {path}: no {lacking} in its columns; expected {GNSS_COLUMNS}")
    height_name = tuple(place)[2]
    names = {"time": TIME_NAMES, **place, **{key: (key,) for key in _SIGMA}}
    table = find_columns(path, names, (height_name, *_SIGMA))
    time_s, _ = seconds(table["time"], f"table {path}", has["time"])
    table.setdefault(height_name, np.zeros(len(time_s)))
    position = np.column_stack([table[key] for key in place])
    stated = [table.get(key, np.full(len(time_s), s)) for key, s in zip(_SIGMA, _UNKNOWN_SIGMA_M, strict=True)]
    if place is _DEGREES:
        return GnssTrack.from_wgs84(time_s, position, np.column_stack(stated))
    usable = np.isfinite(position).all(axis=1)
    order = np.argsort(time_s[usable], kind="stable")
    sigma_m = _known_sigma(np.column_stack(stated))
    return GnssTrack(time_s[usable][order], position[usable][order], sigma_m[usable][order])


def _known_sigma(sigma_m: np.ndarray) -> np.ndarray:
    """The standard deviations, those of a plain receiver where a cell is empty."""
    return np.where(np.isnan(sigma_m), _UNKNOWN_SIGMA_M, sigma_m)


def read_wheel_odometry(path: Path) -> WheelOdometry:
    """Speed and yaw rate of a `wheel_odom.csv`; times in s, ms, us or ns."""
    names = {"time": TIME_NAMES, **_WHEELS}
    table = find_columns(path, names)
    time_s, _ = seconds(table["time"], f"table {path}", column_names(path, names)["time"])
    return WheelOdometry(time_s, table["speed"], table["rate"])


def read_imu(path: Path) -> Imu:
    """Rates and accelerations of an `imu.csv`; times in s, ms, us or ns."""
    names = {"time": TIME_NAMES, **_INERTIAL}
    table = find_columns(path, names)
    time_s, _ = seconds(table["time"], f"table {path}", column_names(path, names)["time"])
    gyro = np.column_stack([table["gx"], table["gy"], table["gz"]])
    return Imu(time_s, gyro, np.column_stack([table["ax"], table["ay"], table["az"]]))


def _mean_of_neighbours(values: np.ndarray) -> np.ndarray:
    return 0.5 * (values[1:] + values[:-1])
