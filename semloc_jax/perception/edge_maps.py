"""The cost maps of the literature (room: perception; host).

In: one binary layer of a mask. Out: unsigned costs, 0 on the boundary and 1 far from it.
"""

import cv2
import numpy as np


def gradient_cost(binary: np.ndarray, ramp_px: float, stride: int) -> np.ndarray:
    """Dilation minus erosion, smoothed and turned over (arXiv 2107.02557, lane markings and poles), float32[h w].

    Args:
        binary: uint8[h w], 0 outside, 255 inside, h and w multiples of `stride`.
        ramp_px: distance [px of the full mask] at which the cost is about 1.
        stride: pixels of the full mask in one of the result.
    """
    layer = _reduced(binary, stride)
    radius = ramp_px / stride
    element = _ellipse(radius / 2)
    band = cv2.subtract(cv2.dilate(layer, element), cv2.erode(layer, element, borderType=cv2.BORDER_REPLICATE))
    return _smooth_cost(band, radius)


def laplacian_cost(binary: np.ndarray, ramp_px: float, stride: int) -> np.ndarray:
    """Laplacian edge, widened by dilation and smoothed (arXiv 2107.02557, sign boards), float32[h w].

    Args:
        binary: uint8[h w], 0 outside, 255 inside, h and w multiples of `stride`.
        ramp_px: distance [px of the full mask] at which the cost is about 1.
        stride: pixels of the full mask in one of the result.
    """
    layer = _reduced(binary, stride)
    radius = ramp_px / stride
    edge = np.abs(cv2.Laplacian(layer, cv2.CV_16S, borderType=cv2.BORDER_REPLICATE))
    # The Laplacian answers on both sides of the boundary, so the edge is already two pixels wide.
    band = cv2.dilate(np.minimum(edge, 255).astype(np.uint8), _ellipse(max(radius / 2 - 1, 0)))
    return _smooth_cost(band, radius)


def _reduced(binary: np.ndarray, stride: int) -> np.ndarray:
    size = binary.shape[1] // stride, binary.shape[0] // stride
    share = cv2.resize(binary, size, interpolation=cv2.INTER_AREA)
    # Lines thinner than a block would fade, so they count twice.
    return cv2.add(share, cv2.morphologyEx(share, cv2.MORPH_TOPHAT, np.ones((2, 2), np.uint8)))


def _ellipse(radius_px: float) -> np.ndarray:
    size = 2 * max(round(radius_px), 1) + 1
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))


def _smooth_cost(band: np.ndarray, radius_px: float) -> np.ndarray:
    """1 where the band is absent, 0 on its middle, smooth between; float32[h w]."""
    smooth = cv2.GaussianBlur(band.astype(np.float32) / 255.0, (0, 0), max(radius_px / 3.0, 0.7))
    # A band of half-width radius / 2 smoothed with sigma radius / 3 peaks at erf(1.5 / sqrt(2)) = 0.866.
    return np.clip(1.0 - smooth / 0.866, 0.0, 1.0).astype(np.float32)
