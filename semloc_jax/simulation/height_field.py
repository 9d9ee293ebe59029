"""The ground of a real map: a smooth surface through the heights of its lines (room: simulation; host).

In: points of the map. Out: Surface.
"""

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float
from scipy.ndimage import map_coordinates
from scipy.sparse.linalg import splu

from semloc_jax.simulation.surface import Surface, WaveSurface

_NODE_M = 2.0
_MOST_NODES = 60_000
_HEIGHT_SIGMA_M = 0.01
"""Heights of a map are true to about this."""
_BEND_PER_M = 0.004
"""Roads bend about this much in height [1/m]: a crest of 250 m radius."""
_TILT = 0.02
"""Where the map says nothing the ground goes back to its mean plane, slopes within this."""
_FLAT_M = 1e-6
_GRADIENT_M = 0.05


@dataclass(frozen=True)
class SplineSurface(Surface):
    """Uniform cubic B-spline over the plane; level beyond its grid.

    Args:
        coefficients: one for each node, rows along y.
        low: place of the first node in the map frame [m].
        node_m: distance of the nodes.
    """

    coefficients: Float[np.ndarray, "ny nx"]
    low: Float[np.ndarray, "2"]
    node_m: float
    max_slope: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        # The derivative of a B-spline lies between the differences of neighbouring coefficients.
        steepest = [float(np.abs(np.diff(self.coefficients, axis=axis)).max(initial=0.0)) for axis in (0, 1)]
        object.__setattr__(self, "max_slope", float(np.hypot(*steepest) / self.node_m))

    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        place = np.array([(np.asarray(y) - self.low[1]) / self.node_m, (np.asarray(x) - self.low[0]) / self.node_m])
        return map_coordinates(self.coefficients, place, order=3, mode="nearest", prefilter=False)

    def normal(self, xy: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        x, y = xy.T
        here = self.height(x, y)
        gradient = [(self.height(x + _GRADIENT_M, y) - here), (self.height(x, y + _GRADIENT_M) - here)]
        normal = np.column_stack([*(-g / _GRADIENT_M for g in gradient), np.ones(len(xy))])
        return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def surface_through(
    points: Float[np.ndarray, "n 3"], low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"]
) -> Surface:
    """The smoothest surface that follows points of the road within about a centimetre.

    Args:
        points: in the map frame [m].
        low: corner of the region that will be seen.
        high: its other corner.
    """
    design = np.column_stack([points[:, :2], np.ones(len(points))])
    plane = np.linalg.lstsq(design - [*points[:, :2].mean(axis=0), 0.0], points[:, 2], rcond=None)[0]
    plane[2] -= plane[:2] @ points[:, :2].mean(axis=0)
    off_plane = points[:, 2] - design @ plane
    if np.abs(off_plane).max() < _FLAT_M:
        if np.abs(points[:, 2]).max() < _FLAT_M:
            plane = np.zeros(3)
        return _plane(plane)
    node_m = max(_NODE_M, float(np.sqrt(np.prod(high - low) / _MOST_NODES)))
    size = np.ceil((high - low) / node_m).astype(int) + 3
    inside = np.all((points[:, :2] > low) & (points[:, :2] < high), axis=1)
    rows = _spline_rows((points[inside, :2] - low) / node_m + 1.0, size)
    smooth = sp.vstack(
        [_differences(size, order) / (tolerance * node_m**degree) for order, degree, tolerance in _PENALTIES]
    )
    normal = (rows.T @ rows) / _HEIGHT_SIGMA_M**2 + smooth.T @ smooth
    normal = normal + 1e-6 * sp.identity(normal.shape[0])
    # Symmetric and positive definite: no pivoting, and an ordering for such matrices fills in a third.
    factors = splu(normal.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    found = factors.solve(rows.T @ off_plane[inside] / _HEIGHT_SIGMA_M**2).reshape(size[1], size[0])
    nodes = [low[axis] + node_m * (np.arange(size[axis]) - 1.0) for axis in (0, 1)]
    # A cubic B-spline with the values of a plane as coefficients is that plane.
    x, y = np.meshgrid(*nodes)
    return SplineSurface(found + plane[0] * x + plane[1] * y + plane[2], low - node_m, node_m)


_PENALTIES = (
    ((2, 0), 2, _BEND_PER_M),
    ((0, 2), 2, _BEND_PER_M),
    ((1, 1), 2, _BEND_PER_M),
    ((1, 0), 1, 20.0 * _TILT),
    ((0, 1), 1, 20.0 * _TILT),
)
"""Differences along x and y, the derivative they approximate, and its usual size."""


def _plane(plane: np.ndarray) -> Surface:
    return _OffsetPlane(plane[:2], np.zeros(0), np.zeros((0, 2)), np.zeros(0), float(plane[2]))


@dataclass(frozen=True)
class _OffsetPlane(WaveSurface):
    """A plane at any height."""

    offset_m: float = 0.0

    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return super().height(x, y) + self.offset_m


def _spline_rows(place: np.ndarray, size: np.ndarray) -> sp.csr_matrix:
    """Weights of the coefficients at places in units of nodes, one row for each."""
    cell = np.clip(np.floor(place).astype(int), 1, size - 3)
    weights = [_cubic_weights(place[:, axis] - cell[:, axis]) for axis in (0, 1)]
    offset = np.arange(-1, 3)
    column = (cell[:, 1, None, None] + offset[None, :, None]) * size[0] + cell[:, 0, None, None] + offset[None, None, :]
    value = weights[1][:, :, None] * weights[0][:, None, :]
    row = np.repeat(np.arange(len(place)), 16)
    return sp.csr_matrix((value.ravel(), (row, column.ravel())), shape=(len(place), int(size[0] * size[1])))


def _cubic_weights(t: np.ndarray) -> np.ndarray:
    """The four cubic B-spline weights at a share `t` of a cell, `[n 4]`."""
    return np.stack([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3], axis=1) / 6.0


def _differences(size: np.ndarray, order: tuple[int, int]) -> sp.csr_matrix:
    """Differences of the given order along x and along y of a grid stored row by row."""
    parts = []
    for count, times in zip(size, order, strict=True):
        part = sp.identity(int(count), format="csr")
        for _ in range(times):
            part = part[1:] - part[:-1]
        parts.append(part)
    return sp.kron(parts[1], parts[0], format="csr")
