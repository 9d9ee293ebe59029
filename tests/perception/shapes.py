"""Masks of known shapes, rendered by the area that the shape covers in each pixel."""

from collections.abc import Callable

import numpy as np

SAMPLES = 13


def cover(inside: Callable[[np.ndarray, np.ndarray], np.ndarray], height: int, width: int) -> np.ndarray:
    """Share of each pixel that a shape covers, float64[h w]; pixel centres at integers."""
    offset = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    u = (np.arange(width)[:, None] + offset).ravel()
    v = (np.arange(height)[:, None] + offset).ravel()
    covered = inside(*np.meshgrid(u, v)).reshape(height, SAMPLES, width, SAMPLES)
    return covered.mean(axis=(1, 3))


def rendered(inside: Callable[[np.ndarray, np.ndarray], np.ndarray], height: int, width: int) -> np.ndarray:
    """A mask with 1 where the shape covers at least half of the pixel, uint8[h w]."""
    return (cover(inside, height, width) >= 0.5).astype(np.uint8)
