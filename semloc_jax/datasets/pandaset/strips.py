"""Where images show a painted stroke, in strips of road along it (room: datasets; host).

In: centre lines, frames, camera poses. Out: Sighting: how far off the line the paint is seen, and from where.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from semloc_jax.cameras import Camera
from semloc_jax.datasets.base import Frame
from semloc_jax.datasets.pandaset.projection import project

_RANGE_M = (6.0, 26.0)
_STEP_M = 0.05
_CROSS_STEP_M = 0.01
_CROSS_REACH_M = 0.5
_SEARCH_M = 0.13
_END_REACH_M = 0.6
_WIDTHS_M = np.arange(0.06, 0.22, 0.02)
_MIN_CONTRAST = 10.0
"""Grey levels by which paint must be brighter than the road beside it."""


@dataclass(frozen=True)
class Sighting:
    """One stroke in one frame.

    Args:
        line: index of the stroke.
        range_m: horizontal distance from the camera to its middle.
        left_m: paint is this far to the left of the line, nan where no paint is seen.
        width_m: width of the paint.
        ahead_m: paint is shifted this far along the line, nan where its ends are not looked for or not seen.
        contrast: grey levels above the road.
        away: cosine between the direction of the line and the direction of sight.
    """

    line: int
    range_m: float
    left_m: float
    width_m: float
    ahead_m: float
    contrast: float
    away: float


def look_for(
    lines: list[np.ndarray],
    has_ends: list[bool],
    frames: Iterable[tuple[Frame, Camera, Float[np.ndarray, "4 4"]]],
    camera_name: str,
) -> list[Sighting]:
    """Sightings of straight strokes [2 3] in frames, each with its camera and T_map_cam."""
    sightings = []
    for frame, camera, T_map_cam in frames:
        grey = cv2.cvtColor(frame.image(camera_name), cv2.COLOR_BGR2GRAY).astype(np.float32)
        dynamic = frame.dynamic_mask(camera_name)
        if dynamic is not None:
            grey[cv2.dilate(dynamic.astype(np.uint8), np.ones((9, 9), dtype=np.uint8)) > 0] = np.nan
        for index, line in enumerate(lines):
            found = _sight(index, line, has_ends[index], grey, camera, T_map_cam)
            if found is not None:
                sightings.append(found)
    return sightings


def _sight(
    index: int, line: np.ndarray, has_ends: bool, grey: np.ndarray, camera: Camera, T_map_cam: np.ndarray
) -> Sighting | None:
    """One stroke in one image; None where the strip is not wholly in view or too near or far."""
    start, end = line
    length = float(np.linalg.norm(end - start))
    axis = (end - start) / length
    left = np.cross([0.0, 0.0, 1.0], axis)
    left /= np.linalg.norm(left)
    sight = (0.5 * (start + end) - T_map_cam[:3, 3])[:2]
    range_m = float(np.linalg.norm(sight))
    if not _RANGE_M[0] <= range_m <= _RANGE_M[1]:
        return None
    margin = _END_REACH_M if has_ends else 0.0
    along = np.arange(-margin, length + margin + 1e-9, _STEP_M)
    across = np.arange(-_CROSS_REACH_M, _CROSS_REACH_M + 1e-9, _CROSS_STEP_M)
    p_map = start + along[:, None, None] * axis + across[None, :, None] * left
    strip = _strip(p_map, grey, camera, T_map_cam)
    if strip is None:
        return None
    inner = (along >= 0.1 * length) & (along <= 0.9 * length)
    profile = np.median(strip[inner], axis=0)
    left_m, width_m, contrast = _best_box(across, profile)
    if contrast < _MIN_CONTRAST:
        left_m = width_m = np.nan
    ahead_m = np.nan
    if has_ends and contrast >= _MIN_CONTRAST:
        on_paint = np.abs(across - left_m) <= 0.5 * width_m
        beside = (np.abs(across - left_m) >= width_m) & (np.abs(across - left_m) <= width_m + 0.15)
        ahead_m = _best_shift(along, strip[:, on_paint].mean(axis=1) - strip[:, beside].mean(axis=1), length)
    away = float(sight @ axis[:2] / range_m)
    return Sighting(index, range_m, float(left_m), float(width_m), float(ahead_m), float(contrast), away)


def _strip(p_map: np.ndarray, grey: np.ndarray, camera: Camera, T_map_cam: np.ndarray) -> np.ndarray | None:
    """Brightness at road points [a c 3]; None if one is hidden or out of view."""
    p_cam = (p_map - T_map_cam[:3, 3]) @ T_map_cam[:3, :3]
    if p_cam[..., 2].min() < 1.0:
        return None
    uv = project(camera, p_cam).astype(np.float32)
    h, w = grey.shape
    if uv.min() < 1.0 or uv[..., 0].max() > w - 2 or uv[..., 1].max() > h - 2:
        return None
    strip = cv2.remap(grey, uv[..., 0], uv[..., 1], cv2.INTER_LINEAR)
    return None if np.isnan(strip).any() else strip


def _best_box(across: np.ndarray, profile: np.ndarray) -> tuple[float, float, float]:
    """Centre, width and contrast of the bright band near the middle: mean inside minus mean of both borders."""
    centers = np.arange(-_SEARCH_M, _SEARCH_M + 1e-9, _CROSS_STEP_M)
    distance = np.abs(across - centers[:, None, None])
    half = 0.5 * _WIDTHS_M[:, None] + 1e-9
    inside = distance <= half
    ring = (distance > half + _CROSS_STEP_M) & (distance <= half + 0.07)
    contrast = inside @ profile / inside.sum(axis=2) - ring @ profile / ring.sum(axis=2)
    best = np.unravel_index(np.argmax(contrast * np.sqrt(_WIDTHS_M)), contrast.shape)
    return float(centers[best[0]]), float(_WIDTHS_M[best[1]]), float(contrast[best])


def _best_shift(along: np.ndarray, brightness: np.ndarray, length: float) -> float:
    """Shift of a box of the line's length along it that holds the most brightness against what lies outside."""
    shifts = np.arange(-_END_REACH_M + 0.1, _END_REACH_M - 0.1 + 1e-9, 0.02)
    scores = []
    for shift in shifts:
        inside = (along >= shift) & (along <= length + shift)
        scores.append(brightness[inside].mean() - brightness[~inside].mean())
    best = int(np.argmax(scores))
    is_at_border = best in (0, len(shifts) - 1)
    return np.nan if is_at_border or scores[best] < _MIN_CONTRAST else float(shifts[best])
