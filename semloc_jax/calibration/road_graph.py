"""Mounts, poses, painted lines and the odometer as one graph (room: calibration; host).

In: sights of lines, ends and spots, motion between frames, priors. Out: a FactorGraph over them, start values. Sizes
are rounded up, so that rounds of matching share one compiled program.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from semloc_jax.calibration.config import CalibrationPriors
from semloc_jax.calibration.road_rows import RoadRows
from semloc_jax.fusion.pose_factors import ODOMETER, odometry
from semloc_jax.fusion.prediction import MotionIncrement
from semloc_jax.residuals.motion import cauchy, pose_residual
from semloc_jax.residuals.road_contact import road_linearised, road_residual
from semloc_jax.residuals.road_sight import at_end_residual, on_line_residual, same_spot_residual
from semloc_jax.solvers.factors import POSE, Factors, vector
from semloc_jax.solvers.graph import FactorGraph, Family, Values

_LINE, _END, _STANCE = vector(0.1, 0.02), vector(0.1), vector(0.1, 0.01, 0.01)
_THRESHOLD = 2.0
"""Sigmas beyond which a sight pulls no more."""
_SWAY = np.array([0.01, np.deg2rad(0.2), np.deg2rad(0.2)])
"""How far a vehicle that drives slowly rises and leans against the road around it [m, rad]; ours."""
_ROUNDED = 128


class Spots(NamedTuple):
    """Spots of the road that were seen twice.

    Attributes:
        camera: of both sights.
        frame: of both sights.
        ray_cam: unit lines of sight.
        sqrt_info: whitens their difference on the road, in heights of the cameras.
        weight: how much of a spot it is.
    """

    camera: Int[np.ndarray, "n 2"]
    frame: Int[np.ndarray, "n 2"]
    ray_cam: Float[np.ndarray, "n 2 3"]
    sqrt_info: Float[np.ndarray, "n 2 2"]
    weight: Float[np.ndarray, " n"]


class RoadEvidence(NamedTuple):
    """What is known of mounts and poses.

    Attributes:
        motion: from each frame to the next.
        T_prior: mounts to start from.
        sigma: of the tangent of each of them [m, rad]; 0 locks.
        places: sights of places of lines.
        ends: sights of ends of lines.
        ends_m: where the ends lie along their lines.
        spots: None where there are no pictures.
    """

    motion: Sequence[MotionIncrement]
    T_prior: Float[np.ndarray, "c 4 4"]
    sigma: Float[np.ndarray, " 6"]
    places: RoadRows
    ends: RoadRows
    ends_m: Float[np.ndarray, " e"]
    spots: Spots | None = None


def road_graph(
    evidence: RoadEvidence,
    Ts_base_cam: Float[np.ndarray, "c 4 4"],
    Ts_odom_base: Float[np.ndarray, "n 4 4"],
    odometer: Float[np.ndarray, " 3"],
    priors: CalibrationPriors,
) -> tuple[FactorGraph, Values]:
    """The graph and its start values.

    Args:
        evidence: what is known.
        Ts_base_cam: mounts as known so far.
        Ts_odom_base: poses as known so far.
        odometer: scale, gyroscope bias [rad/s] and direction of travel [rad] as known so far.
        priors: of the odometer.
    """
    num, lines, ends = len(Ts_odom_base), _used(evidence.places), _used(evidence.ends)
    families = (
        Family("mount", POSE, len(Ts_base_cam)),
        Family("odometer", ODOMETER, 1),
        Family("pose", POSE, num),
        Family("line", _LINE, len(lines)),
        Family("end", _END, len(ends)),
        Family("stance", _STANCE, 1),
    )
    factors = (
        _seen(on_line_residual, "line", evidence.places),
        _seen(at_end_residual, "end", evidence.ends),
        *_priors(evidence, priors),
        _driven(evidence.motion),
        _on_the_road(num),
        *(() if evidence.spots is None else (_twice(evidence.spots),)),
    )
    # Where the way begins is free to choose: x, y and heading of the first pose. What defines forward is the way.
    first = np.ones((num, 6), bool)
    first[0, [0, 1, 5]] = False
    free = {"pose": first, "line": lines[:, None] & np.ones(2, bool), "end": ends[:, None]}
    free |= {"mount": np.tile(evidence.sigma > 0, (len(Ts_base_cam), 1)), "stance": np.zeros((1, 3), bool)}
    free |= {"odometer": np.array([[priors.odometer_scale > 0, priors.gyro_bias_degps > 0, False]])}
    values = {"mount": Ts_base_cam, "odometer": odometer[None], "pose": Ts_odom_base, "stance": np.zeros((1, 3))}
    values |= {"line": np.zeros((len(lines), 2)), "end": _padded(evidence.ends_m[:, None], len(ends))}
    return FactorGraph(families, factors, free), {name: jnp.asarray(value) for name, value in values.items()}


def _used(rows: RoadRows) -> np.ndarray:
    """Which landmarks of a family are there; its size is rounded up."""
    num = int(rows.landmark.max()) + 1 if len(rows.landmark) else 0
    return np.arange(_rounded(num)) < num


def _seen(residual: Callable[..., Array], family: str, rows: RoadRows) -> Factors:
    """Sights of landmarks."""
    camera, frame, landmark, ray_cam, along, sqrt_info, weight = (
        _padded(column, _rounded(len(rows.camera))) for column in rows
    )
    along[len(rows.camera) :, 1, 0] = 1.0
    keys = camera, frame, landmark
    on, robust = ("mount", "pose", family), cauchy(_THRESHOLD)
    return Factors(residual, on, keys, (ray_cam, along), sqrt_info, weight, robust)


def _twice(spots: Spots) -> Factors:
    """Spots that were seen twice."""
    camera, frame, ray_cam, sqrt_info, weight = (_padded(column, _rounded(len(spots.camera))) for column in spots)
    keys = camera[:, 0], frame[:, 0], camera[:, 1], frame[:, 1]
    data = ray_cam[:, 0], ray_cam[:, 1]
    on, robust = ("mount", "pose", "mount", "pose"), cauchy(_THRESHOLD)
    return Factors(same_spot_residual, on, keys, data, sqrt_info, weight, robust)


def _priors(evidence: RoadEvidence, priors: CalibrationPriors) -> tuple[Factors, Factors]:
    """Mounts by drawing, and an odometer that measures well."""
    keys = (np.arange(len(evidence.T_prior)),)
    info = np.tile(np.diag(_inverse(evidence.sigma)), (len(evidence.T_prior), 1, 1))
    sigma = np.array([[priors.odometer_scale, np.deg2rad(priors.gyro_bias_degps), 0.0]])
    expected = np.array([[1.0, 0.0, 0.0]])
    return (
        Factors(pose_residual, ("mount",), keys, (evidence.T_prior,), info),
        Factors(_off, ("odometer",), (np.zeros(1, int),), (expected,), _inverse(sigma)),
    )


def _inverse(sigma: np.ndarray) -> np.ndarray:
    """1 / sigma; 0 for what is locked."""
    return np.where(sigma > 0, 1.0 / np.where(sigma > 0, sigma, 1.0), 0.0)


def _off(value: Float[Array, " d"], expected: Float[Array, " d"], sqrt_info: Float[Array, " d"]) -> Float[Array, " d"]:
    return sqrt_info * (value - expected)


def _driven(motion: Sequence[MotionIncrement]) -> Factors:
    """Motion between frames by wheels and gyroscope."""
    start = np.arange(len(motion))
    T, jacobian, made_with, covariance = (
        np.stack([np.asarray(getattr(step, part)) for step in motion])
        for part in ("T_from_to", "jacobian", "calibration", "covariance")
    )
    return odometry(start, start + 1, T, jacobian, made_with, np.linalg.inv(np.linalg.cholesky(covariance)))


def _on_the_road(num: int) -> Factors:
    """Every pose stands on the plane z = 0 but for its sway."""
    keys = np.arange(num), np.zeros(num, int)
    plane = np.zeros((num, 3)), np.tile([0.0, 0.0, 1.0], (num, 1))
    info = np.tile(1.0 / _SWAY, (num, 1))
    return Factors(road_residual, ("pose", "stance"), keys, plane, info, linearised=road_linearised)


def _rounded(num: int) -> int:
    """A size that holds so many, one of few."""
    return max(_ROUNDED, 1 << max(num - 1, 0).bit_length())


def _padded(values: np.ndarray, size: int) -> np.ndarray:
    return np.concatenate([values, np.zeros((size - len(values), *values.shape[1:]), values.dtype)])
