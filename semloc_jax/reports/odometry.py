"""The report of a drive without a map: what `semloc odometry` writes (room: reports; host).

In: a drive, how it is followed. Out: trajectory, table, metrics and a picture in a folder.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from tqdm import tqdm

from semloc_jax.datasets import Drive
from semloc_jax.evaluation import Metric, Trajectory, drift, format_metrics, write_metrics, write_tum
from semloc_jax.fusion.inertial_states import AT, STATE
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.localization.motion_source import scenery_of
from semloc_jax.localization.odometry import OdometryConfig, OdometryFrame, VisualInertialOdometry, follow
from semloc_jax.mapping.chain import Chain, drive_chain
from semloc_jax.reports.folder import make_folder, write_record
from semloc_jax.reports.tables import write_csv
from semloc_jax.viz import odometry_picture, save

Motion = Literal["vio", "wheels", "both"]
_LEAST_WAY_M = 1.0
_KNOWN_S, _KNOWN_DEG = 2e-4, 0.03
"""Clock and mount that are held to less than this were not to be found."""


class OdometryReport(NamedTuple):
    """A drive that was followed.

    Args:
        folder: where everything was written.
        text: summary for people.
    """

    folder: Path
    text: str


def report_odometry(
    drive: Drive,
    motion: Motion,
    cameras: Sequence[str],
    masks: MaskSource | None,
    settings: OdometryConfig,
    out: Path | None = None,
    options: Mapping[str, Any] | None = None,
) -> OdometryReport:
    """Follow a drive without a map and write everything about it.

    Args:
        drive: the drive.
        motion: vio: cameras and inertial sensor; both: wheel speeds too; wheels: wheels and gyroscope.
        cameras: names of the cameras that vio follows corners in.
        masks: where they say traffic, sky or the vehicle, no corner is taken; None for no masks.
        settings: how cameras and inertial sensor are used.

    Raises:
        SemlocError: the drive lacks what the motion needs, or no start was found.
    """
    if motion == "wheels":
        chain = drive_chain(drive)
        folder = _folder(out, settings, options)
        return _written(drive, folder, Trajectory(chain.times_s, chain.Ts_odom_base), _rows_of_chain(chain))
    odometry = VisualInertialOdometry(drive, cameras, settings, motion == "both")
    folder = _folder(out, settings, options)
    scenery = None if masks is None else scenery_of(masks)
    with tqdm(odometry.frames, desc="odometry", unit="frame") as frames:
        found = follow(odometry, frames, scenery)
    poses = np.stack([frame.T_odom_base for frame in found])
    trajectory = Trajectory(np.array([frame.time_s for frame in found]), poses)
    return _written(drive, folder, trajectory, found)


def _folder(out: Path | None, settings: OdometryConfig, options: Mapping[str, Any] | None) -> Path:
    folder = make_folder(out)
    write_record(folder, settings, options or {})
    return folder


def _rows_of_chain(chain: Chain) -> list[OdometryFrame]:
    speed = np.gradient(chain.way_m, chain.times_s) if len(chain.times_s) > 1 else np.zeros(1)
    return [
        OdometryFrame(t, T, T[:3, 0] * v, np.r_[bias, np.zeros(3)], np.full(STATE, np.nan), 0, 0, v < 0.02)
        for t, T, v, bias in zip(chain.times_s, chain.Ts_odom_base, speed, chain.gyro_bias_radps, strict=True)
    ]


def _written(drive: Drive, folder: Path, trajectory: Trajectory, rows: Sequence[OdometryFrame]) -> OdometryReport:
    write_tum(trajectory, folder / "trajectory.tum")
    _write_frames(rows, folder / "frames.csv")
    metrics = [
        Metric("frames.drive", float(len(drive)), "frames", "report"),
        Metric("frames.estimated", float(len(rows)), "frames", "report"),
        Metric("start", float(rows[0].time_s - drive.frames[0].time_s), "s", "report"),
    ]
    metrics += _sensor_metrics(rows[-1])
    T_true = _truth_of(drive, trajectory.time_s)
    if T_true is not None and np.sum(np.linalg.norm(np.diff(T_true[:, :3, 3], axis=0), axis=1)) >= _LEAST_WAY_M:
        metrics += drift(trajectory, Trajectory(trajectory.time_s, T_true))
    write_metrics(metrics, folder / "metrics.json")
    sigma = np.stack([row.sigma[:3] for row in rows])
    speed = np.array([np.linalg.norm(row.velocity_odom) for row in rows])
    landmarks = np.array([row.num_landmarks for row in rows], float)
    save(odometry_picture(trajectory, sigma, speed, landmarks, T_true), folder / "odometry.png")
    return OdometryReport(folder, format_metrics(metrics))


def _sensor_metrics(last: OdometryFrame) -> list[Metric]:
    """Clock and mount of the inertial sensor at the end of the drive, where they were to be found."""
    metrics = []
    delay, mount = last.sigma[AT["delay"]], np.rad2deg(last.sigma[AT["mount"]])
    if delay[0] > _KNOWN_S:
        metrics.append(Metric("clock.offset", 1e3 * last.delay_s, "ms", "report"))
        metrics.append(Metric("clock.sigma", float(1e3 * delay[0]), "ms", "report"))
    if mount.max() > _KNOWN_DEG:
        turn = dict(zip("xyz", np.rad2deg(last.mount_rad), strict=True))
        metrics += [Metric(f"mount.turn_{axis}", float(value), "deg", "report") for axis, value in turn.items()]
        metrics.append(Metric("mount.sigma", float(mount.max()), "deg", "report"))
    return metrics


def _truth_of(drive: Drive, time_s: np.ndarray) -> np.ndarray | None:
    truth = drive.truth
    if truth is None or truth.time_s[0] > time_s[0] or truth.time_s[-1] < time_s[-1]:
        return None
    return truth.interpolate(time_s)


def _write_frames(rows: Sequence[OdometryFrame], path: Path) -> None:
    """frames.csv: state and standard deviations of every frame."""
    head = (
        *("time_s", "x_m", "y_m", "z_m", "speed_mps", "gyro_bias_x_radps", "gyro_bias_y_radps", "gyro_bias_z_radps"),
        *("accel_bias_x_mps2", "accel_bias_y_mps2", "accel_bias_z_mps2"),
        *("sigma_longitudinal_m", "sigma_lateral_m", "sigma_height_m", "sigma_heading_deg", "sigma_speed_mps"),
        *("corners", "landmarks", "standing"),
    )
    table = []
    for row in rows:
        sigma = (*row.sigma[:3], np.rad2deg(row.sigma[5]), row.sigma[AT["velocity"].start])
        speed = float(np.linalg.norm(row.velocity_odom))
        values = (row.time_s, *row.T_odom_base[:3, 3], speed, *row.bias, *sigma)
        table.append((*map(float, values), row.num_followed, row.num_landmarks, int(row.is_standing)))
    write_csv(path, head, table)
