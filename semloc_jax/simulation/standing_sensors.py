"""Clocks, wheels, gyroscopes and satellites that are wrong for a whole drive (room: simulation; host).

In: Maker, the size of a fault. Out: FaultyDrive. What is drawn at random is seeded.
The truth of a frame is that of its exposure, whatever time it states.
"""

from dataclasses import replace

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory
from semloc_jax.simulation.faulty_drive import FaultyDrive, Maker, log_rows, with_late_sensors

_START_S = 2.0


def fixes_moved(maker: Maker, ahead_m: float, left_m: float, sigma_m: float | None = None) -> FaultyDrive:
    """Fixes that are off ahead and to the left by the same everywhere."""
    fixes = maker.gnss
    truth = maker.truth
    inside = (fixes.time_s >= truth.time_s[0]) & (fixes.time_s <= truth.time_s[-1])
    T = truth.interpolate(np.clip(fixes.time_s, truth.time_s[0], truth.time_s[-1]))
    shift = inside[:, None] * (ahead_m * T[:, :3, 0] + left_m * T[:, :3, 1])
    sigma = fixes.sigma_m if sigma_m is None else np.full_like(fixes.sigma_m, sigma_m)
    return maker.with_log("gnss", p_enu=fixes.p_enu + shift, sigma_m=sigma)


def fixes_left(maker: Maker, size_m: float) -> FaultyDrive:
    """Fixes that are off to the left."""
    return fixes_moved(maker, 0.0, size_m)


def fixes_along(maker: Maker, size_m: float) -> FaultyDrive:
    """Fixes that are off ahead."""
    return fixes_moved(maker, size_m, 0.0)


def fixes_too_sure(maker: Maker, size_m: float) -> FaultyDrive:
    """Fixes that are off to the left and ahead and state 0.1 m."""
    return fixes_moved(maker, size_m / np.sqrt(2.0), size_m / np.sqrt(2.0), 0.1)


def fixes_spoofed(maker: Maker, size_m: float) -> FaultyDrive:
    """Fixes that state 5 cm are drawn aside slowly, by the size at the end of the drive."""
    fixes, frames = maker.gnss, maker.drive.frames
    truth = maker.truth
    at_s = np.clip(fixes.time_s, truth.time_s[0], truth.time_s[-1])
    T = truth.interpolate(at_s)
    share = np.clip((fixes.time_s - frames[0].time_s) / (maker.end_s - frames[0].time_s), 0.0, 1.0)
    # A spoofed receiver shows what it is made to show: the true place and the pull.
    p_enu = T[:, :3, 3] + size_m * share[:, None] * T[:, :3, 1]
    return maker.with_log("gnss", p_enu=p_enu, sigma_m=np.full_like(fixes.sigma_m, 0.05))


def fixes_jump(maker: Maker, size_m: float) -> FaultyDrive:
    """From the middle of the drive on all fixes are off to the left."""
    moved = fixes_moved(maker, 0.0, size_m).drive.gnss
    late = maker.gnss.time_s >= 0.5 * (maker.drive.frames[0].time_s + maker.end_s)
    return maker.with_log("gnss", p_enu=np.where(late[:, None], moved.p_enu, maker.gnss.p_enu))


def fixes_noisy(maker: Maker, size_m: float) -> FaultyDrive:
    """Fixes that scatter more than they state."""
    p_enu = maker.gnss.p_enu
    return maker.with_log("gnss", p_enu=p_enu + size_m * maker.rng.normal(size=p_enu.shape))


def fixes_late(maker: Maker, size_s: float) -> FaultyDrive:
    """Fixes state a time later than theirs."""
    return maker.with_log("gnss", time_s=maker.gnss.time_s + size_s)


def start_along(maker: Maker, size_m: float) -> FaultyDrive:
    """The first fixes are off along the way and none follow: a garage that is entered a few slots off."""
    moved = fixes_moved(maker, size_m, 0.0).drive.gnss
    kept = log_rows(moved, moved.time_s < maker.drive.frames[0].time_s + _START_S)
    return maker.whole(drive=replace(maker.drive, gnss=kept))


def sensors_late(maker: Maker, size_s: float) -> FaultyDrive:
    """The clock of wheels, inertial sensor and receiver is late against that of the cameras."""
    return maker.whole(drive=with_late_sensors(maker.drive, size_s))


def wheels_late(maker: Maker, size_s: float) -> FaultyDrive:
    """Only the wheels are late."""
    return maker.with_log("odometry", time_s=maker.odometry.time_s + size_s)


def frames_jitter(maker: Maker, size_s: float) -> FaultyDrive:
    """The stated times of frames scatter; their order stays, and so does where each was taken."""
    frames = maker.drive.frames
    times = np.array([frame.time_s for frame in frames])
    stated = np.maximum.accumulate(times + size_s * maker.rng.normal(size=len(times))) + 1e-4 * np.arange(len(times))
    restamped = tuple(replace(frame, time_s=float(t)) for frame, t in zip(frames, stated, strict=True))
    taken_at = Trajectory(stated, maker.truth.interpolate(times))
    return maker.whole(drive=replace(maker.drive, frames=restamped, truth=taken_at))


def frames_missing(maker: Maker, share: float) -> FaultyDrive:
    """A share of the frames never arrives."""
    kept = tuple(frame for frame in maker.drive.frames if maker.rng.random() >= share)
    if not kept:
        raise SemlocError(f"fault '{maker.name}': no frame of drive {maker.drive.name} is left")
    return maker.whole(drive=replace(maker.drive, frames=kept))


def odometer_scale(maker: Maker, share: float) -> FaultyDrive:
    """The wheels count more than is driven."""
    return maker.with_log("odometry", speed_mps=(1.0 + share) * maker.odometry.speed_mps)


def odometer_slips(maker: Maker, share: float) -> FaultyDrive:
    """For half a second in every three the wheels spin faster than the road goes by."""
    odometry = maker.odometry
    slips = np.mod(odometry.time_s - odometry.time_s[0], 3.0) < 0.5
    return maker.with_log("odometry", speed_mps=np.where(slips, 1.0 + share, 1.0) * odometry.speed_mps)


def odometer_stuck(maker: Maker, size_s: float) -> FaultyDrive:
    """From the middle of the drive on the wheels say the last speed again and again for some time."""
    odometry, (from_s, within) = maker.odometry, _in_the_middle(maker, size_s)
    said_mps = np.interp(from_s - 1.0, odometry.time_s, odometry.speed_mps)
    return maker.with_log("odometry", speed_mps=np.where(within, said_mps, odometry.speed_mps))


def odometer_silent(maker: Maker, size_s: float) -> FaultyDrive:
    """The wheels say zero for some time in the middle of the drive, while the vehicle drives on."""
    _, within = _in_the_middle(maker, size_s)
    return maker.with_log("odometry", speed_mps=np.where(within, 0.0, maker.odometry.speed_mps))


def _in_the_middle(maker: Maker, size_s: float) -> tuple[float, np.ndarray]:
    """The middle of the drive [s], and which samples of the wheels lie in the stretch of time that begins there."""
    from_s, time_s = 0.5 * (maker.drive.frames[0].time_s + maker.end_s), maker.odometry.time_s
    return from_s, (time_s >= from_s) & (time_s < from_s + size_s)


def gyro_bias(maker: Maker, size_degps: float) -> FaultyDrive:
    """The gyroscope turns while the vehicle does not."""
    return maker.with_log("imu", gyro_radps=maker.imu.gyro_radps + np.array([0.0, 0.0, np.deg2rad(size_degps)]))


def gyro_scale(maker: Maker, share: float) -> FaultyDrive:
    """The gyroscope says too little; a share of 2 is the wrong sign."""
    return maker.with_log("imu", gyro_radps=maker.imu.gyro_radps * np.array([1.0, 1.0, 1.0 - share]))
