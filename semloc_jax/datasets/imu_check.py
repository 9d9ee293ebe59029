"""What the readings of an inertial sensor themselves say of units and axes (room: datasets; host).

In: an Imu in the axes of the base. Out: what is wrong in words, empty where nothing is. Limits are ours.
"""

import numpy as np
from jaxtyping import Float

from semloc_jax.datasets.sensors import Imu
from semloc_jax.errors import SemlocError

_GRAVITY_MPS2 = 9.81
_G_SHARE = 0.1
_UPRIGHT = 0.9
_TILT_S, _MOST_TILT_RAD = 1.0, 0.35
"""Pitch and roll of a road vehicle within a second (root mean square) are a tenth of this."""
_AXES = "xyz"


def wrong_forces(imu: Imu) -> str:
    """What the mean force says of units and axes: at rest and on average it is 9.81 m/s^2, upwards."""
    if not np.abs(imu.accel_mps2).any():
        return ""
    mean = np.mean(imu.accel_mps2, axis=0)
    size = float(np.linalg.norm(mean))
    if abs(size - 1.0) < _G_SHARE:
        return f"the mean force is {size:.2f}; expected 9.8 m/s^2: the unit is g; multiply by 9.81"
    if abs(size / _GRAVITY_MPS2 - 1.0) > _G_SHARE:
        return f"the mean force is {size:.2f}; expected 9.8 m/s^2 with gravity in it; check the unit"
    if mean[2] / size < -_UPRIGHT:
        return "the mean force points down (-z); expected up at rest (a specific force, z up): the sign is wrong"
    if mean[2] / size < _UPRIGHT:
        axis = int(np.argmax(np.abs(mean)))
        return (
            f"the mean force points along {'-' if mean[axis] < 0 else '+'}{_AXES[axis]}; expected +z (x ahead, y left, "
            "z up): the axes are not those of the vehicle; give T_body_imu or turn the columns"
        )
    return ""


def wrong_rates(imu: Imu) -> str:
    """What the rates say of their unit: about x and y they add up to how the vehicle tilts."""
    tilt_rad = _tilts(imu)
    size = float(np.sqrt(np.mean(tilt_rad**2))) if len(tilt_rad) else 0.0
    if size > _MOST_TILT_RAD:
        return (
            f"the rates about x and y tilt the vehicle by {np.rad2deg(size):.0f} deg within a second (root mean "
            "square); expected a degree or two: the unit is deg/s; divide by 57.3"
        )
    return ""


def require_usable(imu: Imu, what: str) -> None:
    """Refuse readings that cannot be those of a vehicle in rad/s and m/s^2.

    Raises:
        SemlocError: `what` and what is wrong.
    """
    wrong = wrong_forces(imu) or wrong_rates(imu)
    if wrong:
        raise SemlocError(f"{what}: imu: {wrong}; semloc check-calib looks at clock and mount, too")


def _tilts(imu: Imu) -> Float[np.ndarray, "n 2"]:
    """Angles about x and y over every second of the log."""
    step_s = np.minimum(np.diff(imu.time_s), _TILT_S)[:, None]
    rates = imu.gyro_radps[:, :2]
    angle = np.concatenate([np.zeros((1, 2)), np.cumsum(0.5 * step_s * (rates[1:] + rates[:-1]), axis=0)])
    ends_s = np.arange(imu.time_s[0], imu.time_s[-1], _TILT_S)
    return np.diff(np.stack([np.interp(ends_s, imu.time_s, column) for column in angle.T], axis=1), axis=0)
