"""Clocks, wheels, gyroscopes and satellites that are wrong for a whole drive (room: simulation; host).

In: Maker, the size of a fault. Out: FaultyDrive. What is drawn at random is seeded.
The truth of a frame is that of its exposure, whatever time it states.
"""

from dataclasses import replace

import numpy as np

from semloc_jax.datasets.sensors import Imu
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory
from semloc_jax.simulation.faulty_drive import FaultyDrive, Maker, log_rows

_SENSORS = ("gnss", "odometry", "imu")
_START_S = 2.0


def fixes_moved(maker: Maker, ahead_m: float, left_m: float, sigma_m: float | None = None) -> FaultyDrive:
    """Fixes that are off ahead and to the left by the same everywhere."""
    fixes = maker.gnss
    truth = maker.truth
    inside = (fixes.time_s >= truth.time_s[0]) & (fixes.time_s <= truth.time_s[-1])
    T = truth.interpolate(np.clip(fixes.time_s, truth.time_s[0], truth.time_s[-1]))
    shift = inside[:, None] * (ahead_m * T[:, :3, 0] + left_m * T[:, :3, 1])
    sigma = fixes.sigma_m if sigma_m is None else np.full_like(fixes.sigma_m, sigma_m)
    return maker.whole(drive=replace(maker.drive, gnss=replace(fixes, p_enu=fixes.p_enu + shift, sigma_m=sigma)))


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
    spoofed = replace(fixes, p_enu=p_enu, sigma_m=np.full_like(fixes.sigma_m, 0.05))
    return maker.whole(drive=replace(maker.drive, gnss=spoofed))


def fixes_jump(maker: Maker, size_m: float) -> FaultyDrive:
    """From the middle of the drive on all fixes are off to the left."""
    moved = fixes_moved(maker, 0.0, size_m).drive.gnss
    late = maker.gnss.time_s >= 0.5 * (maker.drive.frames[0].time_s + maker.end_s)
    p_enu = np.where(late[:, None], moved.p_enu, maker.gnss.p_enu)
    return maker.whole(drive=replace(maker.drive, gnss=replace(maker.gnss, p_enu=p_enu)))


def fixes_noisy(maker: Maker, size_m: float) -> FaultyDrive:
    """Fixes that scatter more than they state."""
    noise = size_m * maker.rng.normal(size=maker.gnss.p_enu.shape)
    return maker.whole(drive=replace(maker.drive, gnss=replace(maker.gnss, p_enu=maker.gnss.p_enu + noise)))


def fixes_late(maker: Maker, size_s: float) -> FaultyDrive:
    """Fixes state a time later than theirs."""
    late = replace(maker.gnss, time_s=maker.gnss.time_s + size_s)
    return maker.whole(drive=replace(maker.drive, gnss=late))


def start_along(maker: Maker, size_m: float) -> FaultyDrive:
    """The first fixes are off along the way and none follow: a garage that is entered a few slots off."""
    moved = fixes_moved(maker, size_m, 0.0).drive.gnss
    kept = log_rows(moved, moved.time_s < maker.drive.frames[0].time_s + _START_S)
    return maker.whole(drive=replace(maker.drive, gnss=kept))


def sensors_late(maker: Maker, size_s: float) -> FaultyDrive:
    """The clock of wheels, inertial sensor and receiver is late against that of the cameras."""
    late = {
        name: replace(log, time_s=log.time_s + size_s)
        for name in _SENSORS
        if (log := getattr(maker.drive, name)) is not None
    }
    return maker.whole(drive=replace(maker.drive, **late))


def wheels_late(maker: Maker, size_s: float) -> FaultyDrive:
    """Only the wheels are late."""
    return maker.whole(
        drive=replace(maker.drive, odometry=replace(maker.odometry, time_s=maker.odometry.time_s + size_s))
    )


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
    odometry = maker.odometry
    return maker.whole(
        drive=replace(maker.drive, odometry=replace(odometry, speed_mps=(1.0 + share) * odometry.speed_mps))
    )


def odometer_slips(maker: Maker, share: float) -> FaultyDrive:
    """For half a second in every three the wheels spin faster than the road goes by."""
    odometry = maker.odometry
    slips = np.mod(odometry.time_s - odometry.time_s[0], 3.0) < 0.5
    speed = np.where(slips, 1.0 + share, 1.0) * odometry.speed_mps
    return maker.whole(drive=replace(maker.drive, odometry=replace(odometry, speed_mps=speed)))


def odometer_stuck(maker: Maker, size_s: float) -> FaultyDrive:
    """From the middle of the drive on the wheels say the last speed again and again for some time."""
    odometry = maker.odometry
    from_s = 0.5 * (maker.drive.frames[0].time_s + maker.end_s)
    stuck = (odometry.time_s >= from_s) & (odometry.time_s < from_s + size_s)
    speed = np.where(stuck, np.interp(from_s - 1.0, odometry.time_s, odometry.speed_mps), odometry.speed_mps)
    return maker.whole(drive=replace(maker.drive, odometry=replace(odometry, speed_mps=speed)))


def odometer_silent(maker: Maker, size_s: float) -> FaultyDrive:
    """The wheels say zero for some time in the middle of the drive, while the vehicle drives on."""
    odometry = maker.odometry
    from_s = 0.5 * (maker.drive.frames[0].time_s + maker.end_s)
    silent = (odometry.time_s >= from_s) & (odometry.time_s < from_s + size_s)
    speed = np.where(silent, 0.0, odometry.speed_mps)
    return maker.whole(drive=replace(maker.drive, odometry=replace(odometry, speed_mps=speed)))


def _imu(maker: Maker) -> Imu:
    if maker.drive.imu is None:
        raise SemlocError(f"fault '{maker.name}': drive {maker.drive.name} has no inertial sensor to disturb")
    return maker.drive.imu


def gyro_bias(maker: Maker, size_degps: float) -> FaultyDrive:
    """The gyroscope turns while the vehicle does not."""
    imu = _imu(maker)
    gyro = imu.gyro_radps + np.array([0.0, 0.0, np.deg2rad(size_degps)])
    return maker.whole(drive=replace(maker.drive, imu=replace(imu, gyro_radps=gyro)))


def gyro_scale(maker: Maker, share: float) -> FaultyDrive:
    """The gyroscope says too little; a share of 2 is the wrong sign."""
    imu = _imu(maker)
    gyro = imu.gyro_radps * np.array([1.0, 1.0, 1.0 - share])
    return maker.whole(drive=replace(maker.drive, imu=replace(imu, gyro_radps=gyro)))
