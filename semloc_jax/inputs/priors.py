"""First guesses of the vehicle pose: from satellites, from truth plus noise, from a file (room: inputs; host).

In: a Drive, a map, the kind of prior. Out: PosePrior for each frame.
"""

from pathlib import Path

import numpy as np

from semloc_jax.alignment.pose_prior import PosePrior, PriorSource
from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import read_trajectory

_MIN_SIGMA_HEADING_DEG = 1.0
"""A fit of fixes trusts its heading to tenths of a degree; wheel slip and lever arms are not in it."""


def prior_source(
    kind: str,
    drive: Drive,
    sigma_xy_m: float | None = None,
    sigma_heading_deg: float | None = None,
    seed: int = 0,
) -> PriorSource:
    """What gives the prior of each frame.

    Args:
        kind: `gnss` (position and heading from the fixes), `truth` (reference plus seeded Gaussian noise of the stated
            sigmas) or the path of a trajectory file.
        drive: The drive.
        sigma_xy_m: Standard deviation of the position [m]; None for what the source states, or 1 m.
        sigma_heading_deg: Standard deviation of the heading [deg]; None for what the source states, or 3 deg.
        seed: Of the noise on the truth.

    Raises:
        SemlocError: the drive has no such prior, there is no such file, or a sigma is not positive.

    >>> prior = sj.prior_source("truth", drive, sigma_xy_m=0.5)
    >>> prior(drive.frames[0]).sigma_xy_m
    0.5
    """
    _require_sigma("position", sigma_xy_m, "m")
    _require_sigma("heading", sigma_heading_deg, "deg")
    if kind == "gnss":
        return _from_gnss(drive, sigma_xy_m, sigma_heading_deg)
    if kind == "truth":
        return _from_truth(drive, sigma_xy_m or 1.0, np.deg2rad(sigma_heading_deg or 3.0), seed)
    if not Path(kind).is_file():
        raise SemlocError(f"prior '{kind}': neither gnss nor truth nor a trajectory file; give one of these")
    trajectory = read_trajectory(kind)
    sigma_rad = np.deg2rad(sigma_heading_deg or 3.0)

    def from_file(frame: Frame) -> PosePrior:
        T = trajectory.interpolate(np.array([frame.time_s]))[0]
        return PosePrior(T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0]), sigma_xy_m or 1.0, sigma_rad)

    return from_file


def other_priors(drive: Drive) -> str:
    """What may be given where there are no satellite fixes; the truth only where the drive has one."""
    return "--prior truth or --prior FILE.tum" if drive.truth is not None else "--prior FILE.tum"


def _require_sigma(what: str, sigma: float | None, unit: str) -> None:
    if sigma is not None and not (np.isfinite(sigma) and sigma > 0.0):
        raise SemlocError(
            f"prior: standard deviation of the {what} {sigma} {unit}; expected a positive number; leave the option out "
            "for that of the source"
        )


def _from_gnss(drive: Drive, sigma_xy_m: float | None, sigma_heading_deg: float | None) -> PriorSource:
    if drive.gnss is None:
        raise SemlocError(f"drive {drive.name}: has no satellite fixes for --prior gnss; give {other_priors(drive)}")

    def from_gnss(frame: Frame) -> PosePrior:
        fix = drive.gnss_prior(frame.time_s)
        xy = sigma_xy_m or float(np.max(fix.sigma_m[:2]))
        heading = (
            np.deg2rad(sigma_heading_deg)
            if sigma_heading_deg
            else max(fix.sigma_heading_rad, np.deg2rad(_MIN_SIGMA_HEADING_DEG))
        )
        return PosePrior(float(fix.p_enu[0]), float(fix.p_enu[1]), float(fix.heading_rad), xy, float(heading))

    return from_gnss


def _from_truth(drive: Drive, sigma_xy_m: float, sigma_rad: float, seed: int) -> PriorSource:
    def from_truth(frame: Frame) -> PosePrior:
        T = drive.truth_at(frame)
        # One generator for each frame: the noise of a frame does not depend on which frames are run.
        noise = np.random.default_rng((seed, frame.index)).normal(size=3) * (sigma_xy_m, sigma_xy_m, sigma_rad)
        xy = T[:2, 3] + T[:2, :2] @ noise[:2]
        return PosePrior(xy[0], xy[1], np.arctan2(T[1, 0], T[0, 0]) + noise[2], sigma_xy_m, sigma_rad)

    return from_truth
