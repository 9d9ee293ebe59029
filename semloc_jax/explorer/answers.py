"""What the page shows about a pose, and which poses around it are scored (room: explorer; host).

In: PoseProbe, costs, Descent, all on the host; ramp of a level, zoom. Out: plain numbers in m, deg and px, compact
arrays, SliceGrid.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from semloc_jax.analysis.landscape import DIRECTIONS
from semloc_jax.analysis.probe import Descent, Leg, PoseProbe
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.structs import STATUS_TEXT, PoseEstimate, SolveStatus

SLICES = (("x", "y"), ("x", "yaw"))
CURVE_POINTS = 41
_SIDES = {"fine": (61, 41), "coarse": (25, 17)}
"""Points along a side of a slice at rest and while dragging: with one or two cameras, and with more."""


@dataclass(frozen=True)
class SliceGrid:
    """Offsets of all poses in one batch."""

    xi: np.ndarray
    """Right tangents `float32[n 6]` [m, rad]: both slices (first direction along the rows), then the six curves."""
    side: int
    extent: np.ndarray
    """Half width along each of the six directions `[6]` [m, rad]."""

    def head(self) -> dict[str, Any]:
        """Size and extents (m and deg) as plain data."""
        extent = [e if name in "xyz" else np.rad2deg(e) for name, e in zip(DIRECTIONS, self.extent, strict=True)]
        return {"side": self.side, "extent": dict(zip(DIRECTIONS, extent, strict=True)), "slices": SLICES}

    def chunks(self, num: int) -> list[np.ndarray]:
        """The offsets in batches of `num`, the last one filled up with zeros."""
        filled = np.concatenate([self.xi, np.zeros((-len(self.xi) % num, 6), np.float32)])
        return list(filled.reshape(-1, num, 6))

    def arrays(self, costs: np.ndarray) -> dict[str, np.ndarray]:
        """The costs of the batches as slices `[side side]` and curves `[6 CURVE_POINTS]`."""
        num = self.side**2
        costs = np.asarray(costs, np.float32).reshape(-1)
        return {
            "slice_xy": costs[:num].reshape(self.side, self.side),
            "slice_xyaw": costs[num : 2 * num].reshape(self.side, self.side),
            "curves": costs[2 * num : len(self.xi)].reshape(6, CURVE_POINTS),
        }


@lru_cache(maxsize=64)
def slice_grid(ramp_px: float, zoom: float, resolution: str, num_cameras: int) -> SliceGrid:
    """The grid of a level: the wider its ramp, the wider the basin and the slices.

    The extents are ours: 4 m along, 2 m across, 4 deg of heading for a ramp of 40 px, as its square root for others.
    """
    scale = zoom * np.sqrt(ramp_px / 40.0)
    extent = np.array([4.0, 2.0, 0.5, *np.deg2rad([2.0, 2.0, 4.0])]) * scale
    side = _SIDES[resolution][num_cameras > 2]
    ramp = np.linspace(-1.0, 1.0, side)
    parts = []
    for pair in SLICES:
        first, second = (DIRECTIONS.index(name) for name in pair)
        xi = np.zeros((side, side, 6))
        xi[..., first] = extent[first] * ramp[:, None]
        xi[..., second] = extent[second] * ramp[None, :]
        parts.append(xi.reshape(-1, 6))
    curves = np.eye(6)[:, None, :] * (np.linspace(-1.0, 1.0, CURVE_POINTS)[None, :, None] * extent)
    return SliceGrid(np.concatenate([*parts, curves.reshape(-1, 6)]).astype(np.float32), side, extent)


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
    T_map_end = local.to_map(estimate.T_local_base)
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
