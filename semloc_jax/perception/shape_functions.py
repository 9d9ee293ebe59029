"""Ensemble of Shape Functions: what a flat cloud looks like, whatever its place and heading (room: perception; host).

In: points in a plane and their spacing. Out: 640 numbers: ten histograms of 64 bins.
Wohlkinger, Vincze, Ensemble of Shape Functions for 3D Object Classification, ROBIO 2011: 20,000 random triples of
points give angles (A3), roots of areas (D3) and lengths (D2), each told apart by whether its line runs inside of the
cloud, outside of it or both, and the share of a mixed line inside. Marks are flat: one layer of 64^3 voxels is used.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.errors import SemlocError

NUM_BINS, SIDE = 64, 64
"""Bins of a histogram; voxels along a side of the grid."""
WEIGHTS = (0.5, 0.5, 0.5, 0.5, 0.5, 1.0, 1.0, 2.0, 2.0, 2.0)
"""Of A3 in, out, mixed, D3 in, out, mixed, D2 in, out, mixed, ratio; the paper's."""
_OUTSIDE = 8
"""So many samples of a line, those at its ends among them, make it no inside one."""


@dataclass(frozen=True)
class ShapeConfig:
    """How a shape is sampled."""

    num_triples: int = 20_000
    """The paper's; fewer are faster and a little noisier."""
    num_samples: int = SIDE
    """Places along a line that are looked up in the grid: one for each voxel that it can cross."""
    seed: int = 0
    """The same cloud gives the same numbers."""


def shape_functions(
    xy: Float[np.ndarray, "n 2"], spacing: float, config: ShapeConfig | None = None
) -> Float[np.ndarray, " 640"]:
    """The ESF-640 descriptor of a flat cloud; its sum is 1.

    Args:
        xy: points.
        spacing: distance of neighbouring points, in the same unit.
        config: None for the defaults.

    Raises:
        SemlocError: fewer than three points, or all in one place.
    """
    config = config or ShapeConfig()
    xy = np.asarray(xy, np.float64)
    xy = xy - xy.sum(axis=0) / max(len(xy), 1)
    radius = float(np.linalg.norm(xy, axis=1).max(initial=0.0))
    if len(xy) < 3 or not radius > 0.0:
        raise SemlocError(f"shape functions: {len(xy)} points within {radius:g}; expected three in different places")
    voxel = 2.0 * radius / (SIDE - 1)
    cells = xy / voxel + 0.5 * (SIDE - 1)
    grid = _occupied(cells, spacing / voxel)
    a, b, c = cells[np.random.default_rng(config.seed).integers(len(xy), size=(3, config.num_triples))]
    sides = [(b, c), (c, a), (a, b)]
    length = np.array([np.linalg.norm(p - q, axis=1) for p, q in sides])
    share = np.array([_inside(grid, p, q, config.num_samples) for p, q in sides])
    kind = np.where(share >= 1.0, 0, np.where(share * config.num_samples <= _OUTSIDE, 1, 2))
    half = 0.5 * length.sum(axis=0)
    area = np.sqrt(np.maximum(half * np.prod(half - length, axis=0), 0.0))
    cosine = (length[1] ** 2 + length[2] ** 2 - length[0] ** 2) / np.maximum(2 * length[1] * length[2], 1e-12)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0)) / np.pi
    whole = np.where((kind == 0).all(axis=0), 0, np.where((kind == 1).all(axis=0), 1, 2))
    root = np.sqrt(area)
    parts = [_histogram(angle[kind[0] == k], 1.0) for k in range(3)]
    parts += [_histogram(root[whole == k], root.max()) for k in range(3)]
    parts += [_histogram(length[kind == k], length.max()) for k in range(3)]
    parts.append(_histogram(share[kind == 2], 1.0))
    found = np.concatenate([weight * part for weight, part in zip(WEIGHTS, parts, strict=True)])
    return found / found.sum()


def _occupied(cells: Float[np.ndarray, "n 2"], spacing: float) -> Bool[np.ndarray, "64 64"]:
    """The voxels that the points fill; those between neighbouring points, too."""
    grid = np.zeros((SIDE, SIDE), np.uint8)
    column, row = np.rint(cells).astype(int).clip(0, SIDE - 1).T
    grid[row, column] = 1
    size = 2 * int(np.ceil(0.5 * spacing)) + 1
    return cv2.morphologyEx(grid, cv2.MORPH_CLOSE, np.ones((size, size), np.uint8)) > 0


def _inside(grid: np.ndarray, p: np.ndarray, q: np.ndarray, num_samples: int) -> Float[np.ndarray, " t"]:
    """Share of each line that runs through occupied voxels."""
    along = np.linspace(0.0, 1.0, num_samples, dtype=np.float32)[:, None]
    column, row = (
        np.rint(p[:, k].astype(np.float32) + along * (q - p)[:, k].astype(np.float32)).astype(np.int32) for k in (0, 1)
    )
    return grid.ravel()[row * SIDE + column].mean(axis=0)


def _histogram(values: np.ndarray, most: float) -> Float[np.ndarray, " 64"]:
    if not most > 0.0:
        return np.zeros(NUM_BINS)
    return np.histogram(values, bins=NUM_BINS, range=(0.0, float(most)))[0].astype(np.float64)
