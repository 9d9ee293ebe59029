"""Metrics of a localizer: signed errors in the truth's vehicle frame and their statistics (room: evaluation; host).

In: estimated and reference trajectories. Out: error arrays, list[Metric].
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.trajectory import Trajectory, associate

Direction = Literal["lower", "higher", "report"]
Errors = dict[str, np.ndarray]

TOLERANCE = {"m": 0.01, "deg": 0.02, "share": 0.02}
"""How much worse than its baseline a metric may become, by unit; our choice."""


@dataclass(frozen=True)
class Metric:
    """One number with its unit, which way is better, and how much worse than a baseline it may get.

    Args:
        key: dotted name, e.g. `lateral.p95`.
        value: the number in `unit`; nan where it is not defined.
        unit: `m`, `deg`, `share`, `frames`, `ms` ...
        direction: which way is better; `report` takes no part in a gate.
        tolerance: allowed change for the worse, in `unit`.
    """

    key: str
    value: float
    unit: str
    direction: Direction = "lower"
    tolerance: float = 0.0


@dataclass(frozen=True)
class ErrorLimit:
    """A pose counts as inside when every one of its absolute errors is at most these.

    Args:
        name: part of the metric's key.
        lateral_m: limit across the vehicle [m].
        longitudinal_m: limit along the vehicle [m].
        heading_deg: limit of the heading [deg].
    """

    name: str
    lateral_m: float
    longitudinal_m: float
    heading_deg: float

    def __str__(self) -> str:
        """In words: 0.29 m lateral, 0.29 m longitudinal, 0.5 deg."""
        return f"{self.lateral_m:g} m lateral, {self.longitudinal_m:g} m longitudinal, {self.heading_deg:g} deg"


ALERT_LIMITS = (ErrorLimit("local_street", 0.29, 0.29, 0.50), ErrorLimit("freeway", 0.57, 1.40, 1.50))
RECALL_LIMITS = (
    ErrorLimit("0.3m_0.5m_0.5deg", 0.3, 0.5, 0.5),
    ErrorLimit("1m_1deg", 1.0, 1.0, 1.0),
    ErrorLimit("3m_3deg", 3.0, 3.0, 3.0),
    ErrorLimit("5m_5deg", 5.0, 5.0, 5.0),
)
AVAILABILITY_M = (0.5, 1.0)


def pose_errors(T_est: Float[np.ndarray, "*batch 4 4"], T_ref: Float[np.ndarray, "*batch 4 4"]) -> Errors:
    """Signed errors of estimated poses in the vehicle frame of the truth: T_ref^-1 @ T_est.

    Args:
        T_est: estimated T_map_base.
        T_ref: true T_map_base.

    Returns:
        `longitudinal_m` (+ ahead of the truth), `lateral_m` (+ to its left), `height_m` (+ above), `heading_deg`
        (+ turned left), `pitch_deg` (+ nose down), `roll_deg` (+ left side up); angles are intrinsic z-y-x.

    >>> errors = sj.pose_errors(sj.planar_pose(2.3, 0.1), sj.planar_pose(2.0, 0.0))
    >>> errors["longitudinal_m"].round(3), errors["lateral_m"].round(3)
    (np.float64(0.3), np.float64(0.1))
    """
    R_ref = T_ref[..., :3, :3]
    offset_map = T_est[..., :3, 3] - T_ref[..., :3, 3]
    offset_base = np.einsum("...ji,...j->...i", R_ref, offset_map)
    R_error = np.einsum("...ji,...jk->...ik", R_ref, T_est[..., :3, :3])
    angles = Rotation.from_matrix(R_error.reshape(-1, 3, 3)).as_euler("ZYX", degrees=True)
    angles = angles.reshape(*R_error.shape[:-2], 3)
    return {
        "longitudinal_m": offset_base[..., 0],
        "lateral_m": offset_base[..., 1],
        "height_m": offset_base[..., 2],
        "heading_deg": angles[..., 0],
        "pitch_deg": angles[..., 1],
        "roll_deg": angles[..., 2],
    }


def horizontal_error_m(errors: Errors) -> Float[np.ndarray, "*batch"]:
    """Distance in the road plane [m]."""
    return np.hypot(errors["longitudinal_m"], errors["lateral_m"])


def within(errors: Errors, limit: ErrorLimit) -> Bool[np.ndarray, "*batch"]:
    """Which poses are inside `limit`."""
    return (
        (np.abs(errors["lateral_m"]) <= limit.lateral_m)
        & (np.abs(errors["longitudinal_m"]) <= limit.longitudinal_m)
        & (np.abs(errors["heading_deg"]) <= limit.heading_deg)
    )


def statistics(name: str, signed: Float[np.ndarray, " n"], unit: str) -> list[Metric]:
    """mean, rmse, median, p95 and max of the absolute values, and the signed bias."""
    size = np.abs(signed)
    values = {
        "mean": size.mean(),
        "rmse": np.sqrt(np.mean(size**2)),
        "median": np.median(size),
        "p95": np.percentile(size, 95.0),
        "max": size.max(),
    }
    tolerance = TOLERANCE.get(unit, 0.0)
    metrics = [Metric(f"{name}.{key}", float(value), unit, "lower", tolerance) for key, value in values.items()]
    return [*metrics, Metric(f"{name}.bias", float(signed.mean()), unit, "report")]


def evaluate(estimate: Trajectory, reference: Trajectory, max_difference_s: float = 0.02) -> list[Metric]:
    """Metrics of an estimated trajectory, without any alignment.

    Shares are of ALL reference frames: a frame without a finite estimate within `max_difference_s` counts as missed,
    so that a localizer gains nothing by staying silent. Statistics are over the frames that have an estimate.

    Raises:
        SemlocError: no estimate belongs to any reference time.

    >>> metrics = {metric.key: metric.value for metric in sj.evaluate(drive.truth, drive.truth)}
    >>> float(metrics["lateral.max"])
    0.0
    """
    finite = np.isfinite(estimate.T_map_base).all(axis=(1, 2))
    index_est, index_ref = associate(estimate.time_s[finite], reference.time_s, max_difference_s)
    if len(index_est) == 0:
        raise SemlocError(
            f"evaluate: none of {int(finite.sum())} finite estimates is within {max_difference_s} s of one of "
            f"{len(reference)} reference poses; expected the same clock; check times or raise max_difference_s"
        )
    errors = pose_errors(estimate.T_map_base[finite][index_est], reference.T_map_base[index_ref])
    return metrics_of_errors(errors, len(reference))


def metrics_of_errors(errors: Errors, num_frames: int) -> list[Metric]:
    """Statistics of `errors` and shares of `num_frames` frames, of which those without errors count as missed."""
    num_estimates = len(errors["lateral_m"])
    horizontal = horizontal_error_m(errors)
    metrics = [
        Metric("frames.reference", float(num_frames), "frames", "report"),
        Metric("frames.estimated", float(num_estimates), "frames", "report"),
        _share("estimated", np.ones(num_estimates, dtype=bool), num_frames),
    ]
    for key in ("lateral_m", "longitudinal_m", "height_m", "heading_deg", "pitch_deg", "roll_deg"):
        name, unit = key.rsplit("_", 1)
        metrics += statistics(name, errors[key], unit)
    metrics += statistics("horizontal", horizontal, "m")[:-1]
    metrics += statistics("translation", np.hypot(horizontal, errors["height_m"]), "m")[:-1]
    metrics += [_share(f"inside.{limit.name}", within(errors, limit), num_frames) for limit in ALERT_LIMITS]
    metrics += [_share(f"available.{limit_m:g}m", horizontal <= limit_m, num_frames) for limit_m in AVAILABILITY_M]
    metrics += [_share(f"recall.{limit.name}", within(errors, limit), num_frames) for limit in RECALL_LIMITS]
    return metrics


def _share(key: str, hits: np.ndarray, num_frames: int) -> Metric:
    return Metric(key, float(hits.sum()) / num_frames, "share", "higher", TOLERANCE["share"])
