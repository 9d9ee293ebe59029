"""What the page shows about a pose (room: explorer; host).

In: PoseProbe, costs, Descent, all on the host. Out: plain numbers in m, deg and px, and compact arrays.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from semloc_jax.analysis.landscape import DIRECTIONS
from semloc_jax.analysis.probe import Descent, Leg, PoseProbe
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.structs import STATUS_TEXT, PoseEstimate, SolveStatus

DEG = np.array([1.0, 1.0, 1.0, *[180.0 / np.pi] * 3])
"""Tangents in m and rad to m and deg."""


def summary(found: PoseProbe, channel_names: Sequence[str], has_truth: bool) -> dict[str, Any]:
    """Cost, fit by class, covariance and quadratic model of a pose, as plain data."""
    fit = found.channels
    columns = zip(channel_names, fit.in_view_px, fit.visible_px, fit.cost, fit.inlier_ratio, fit.rms_px, strict=True)
    keys = "name", "in_view_px", "visible_px", "cost", "inlier_ratio", "rms_px"
    estimate = found.estimate
    return {
        "cost": float(estimate.cost),
        "coverage": float(estimate.coverage),
        "inlier_ratio": float(estimate.inlier_ratio),
        "status": SolveStatus(int(estimate.status)).name,
        "status_text": STATUS_TEXT[SolveStatus(int(estimate.status))],
        "channels": [dict(zip(keys, row, strict=True)) for row in columns],
        "covariance": _covariance(estimate),
        "eigenvalues": estimate.information_eigenvalues,
        "gradient": found.gradient / DEG,
        "hessian": found.hessian / DEG[:, None] / DEG,
        "to_truth": found.xi_truth * DEG if has_truth else None,
    }


def sample_arrays(found: PoseProbe) -> dict[str, np.ndarray]:
    """Samples in the images, as small as the page can do with."""
    samples = found.samples
    # Far outside of the image nothing is drawn: one large number stands for all that are larger.
    uv = np.clip(np.nan_to_num(samples.uv, nan=-1e6), -1e6, 1e6).astype(np.float32)
    return {
        "uv": uv,
        "slope": samples.slope.astype(np.float32),
        "residual": samples.residual.astype(np.float32),
        "weight": samples.weight.astype(np.float32),
        "in_view": samples.in_view.astype(np.float32),
        "channel": samples.channel.astype(np.uint8),
    }


def path_of(descent: Descent, local: LocalFrame) -> tuple[np.ndarray, dict[str, Any]]:
    """The pose a solve ends at in the map frame, and its steps as plain data."""
    steps = [step for leg in descent.legs for step in _steps(leg, local)]
    estimate = descent.estimate
    T_map_end = local.to_map(estimate.T_map_base)
    sigma = np.sqrt(np.maximum(np.diagonal(estimate.covariance), 0.0)) * DEG
    return T_map_end, {
        "steps": steps,
        "cost": float(estimate.cost),
        "inlier_ratio": float(estimate.inlier_ratio),
        "status": descent.status.name,
        "status_text": STATUS_TEXT[descent.status],
        "last_level": descent.legs[descent.last].level,
        "sigma": dict(zip(DIRECTIONS, sigma, strict=True)),
    }


def _covariance(estimate: PoseEstimate) -> np.ndarray:
    """Covariance `[6 6]` in m and deg."""
    return np.asarray(estimate.covariance, dtype=np.float64) * DEG[:, None] * DEG


def _steps(leg: Leg, local: LocalFrame) -> list[dict[str, Any]]:
    steps, path = [], leg.path
    for k in np.flatnonzero(path.valid):
        held, tried = (np.asarray(T[k], dtype=np.float64) for T in (path.T_held, path.T_tried))
        steps.append(
            {
                "stage": leg.stage,
                "level": leg.level,
                "accepted": bool(path.accepted[k]),
                "cost": float(path.cost[k]),
                "xy": np.round(local.to_map(held)[:2, 3], 4),
                "tried_xy": np.round(local.to_map(tried)[:2, 3], 4),
                "yaw_deg": np.rad2deg(np.arctan2(held[1, 0], held[0, 0])),
                "xi": np.round(path.xi_held[k] * DEG, 5),
            }
        )
    return steps
