"""Which poses around the one under the hand are scored (room: explorer; host).

In: ramp of a level, zoom, resolution. Out: SliceGrid: two slices, x-y and x-yaw, and a curve along each direction.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from semloc_jax.analysis.landscape import DIRECTIONS

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
