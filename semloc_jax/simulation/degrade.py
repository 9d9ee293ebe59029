"""Masks as a real network makes them (room: simulation; host).

In: exact class ids. Out: class ids at half resolution with its half-pixel shift, wobbly borders, erosion, missing
blobs, swapped classes and false positives.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import UInt8

from semloc_jax.datasets.drive import CLASS_IDS

Mask = UInt8[np.ndarray, "h w"]

_SWAPS = {
    "lane_solid": "lane_dashed",
    "lane_dashed": "lane_solid",
    "arrow": "lane_dashed",
    "crosswalk": "arrow",
    "stop_line": "crosswalk",
    "slot_line": "stop_line",
    "pole": "building",
    "sign": "traffic_light",
    "traffic_light": "sign",
    "cone": "pole",
}
_THIN = ("lane_solid", "lane_dashed", "stop_line", "crosswalk", "arrow", "slot_line", "pole", "sign", "cone", "pillar")


@dataclass(frozen=True)
class Degradation:
    """How bad the masks are; the defaults are our choice, modelled on segmentation networks in road scenes.

    Args:
        wobble_px: standard deviation of the displacement of borders.
        wobble_length_px: length over which it changes.
        erosion_share: share of the image in which thin classes lose a border pixel.
        missing_share: chance that a connected piece of a thin class is gone.
        swap_share: chance that it has a wrong class.
        num_holes: mean number of blobs filled with the class of their surroundings.
        num_false: mean number of invented pieces.
    """

    wobble_px: float = 0.8
    wobble_length_px: float = 6.0
    erosion_share: float = 0.3
    missing_share: float = 0.04
    swap_share: float = 0.03
    num_holes: float = 2.0
    num_false: float = 3.0


def degrade(mask: Mask, rng: np.random.Generator, level: Degradation | None = None) -> Mask:
    """A mask that a network could have made of the exact one; pixel (u, v) shows what was at about (u, v) - 0.5."""
    level = level or Degradation()
    height, width = mask.shape
    half = mask[::2, ::2]
    half = _wobble(half, rng, level)
    half = _erode(half, rng, level)
    half = _swap_and_drop(half, rng, level)
    half = _punch_holes(half, rng, level)
    half = _invent(half, rng, level)
    doubled = np.repeat(np.repeat(half, 2, axis=0), 2, axis=1)
    return np.ascontiguousarray(doubled[:height, :width])


def _smooth_noise(shape: tuple[int, int], rng: np.random.Generator, length_px: float) -> np.ndarray:
    """Normal noise with standard deviation 1 that changes over `length_px`."""
    noise = cv2.GaussianBlur(rng.normal(size=shape).astype(np.float32), (0, 0), length_px)
    return noise / max(float(noise.std()), 1e-6)


def _wobble(mask: np.ndarray, rng: np.random.Generator, level: Degradation) -> np.ndarray:
    rows, columns = np.indices(mask.shape).astype(np.float32)
    # Half of the pixels of a full mask: displacement and length halve with them.
    scale, length_px = 0.5 * level.wobble_px, 0.5 * level.wobble_length_px
    columns += scale * _smooth_noise(mask.shape, rng, length_px)
    rows += scale * _smooth_noise(mask.shape, rng, length_px)
    return cv2.remap(mask, columns, rows, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)


def _erode(mask: np.ndarray, rng: np.random.Generator, level: Degradation) -> np.ndarray:
    """Thin classes lose their border to what lies beside them, in patches."""
    patch = _smooth_noise(mask.shape, rng, 20.0)
    patch = patch < np.quantile(patch, level.erosion_share)
    result = mask.copy()
    thin = np.isin(mask, [CLASS_IDS[name] for name in _THIN])
    kernel = np.array([[0, 0, 0], [0, 1, 1], [0, 0, 0]], dtype=np.uint8)
    kept = cv2.erode(thin.astype(np.uint8), np.rot90(kernel, int(rng.integers(4))).copy()) > 0
    lost = thin & ~kept & patch
    result[lost] = _surroundings(mask, thin)[lost]
    return result


def _surroundings(mask: np.ndarray, removed: np.ndarray) -> np.ndarray:
    """Class of the nearest pixel that is not `removed`, for every pixel."""
    _, labels = cv2.distanceTransformWithLabels(
        removed.astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )
    class_of = np.zeros(int(labels.max()) + 1, dtype=np.uint8)
    class_of[labels[~removed]] = mask[~removed]
    return class_of[labels]


def _swap_and_drop(mask: np.ndarray, rng: np.random.Generator, level: Degradation) -> np.ndarray:
    result = mask.copy()
    lost = np.zeros(mask.shape, dtype=bool)
    for name, wrong in _SWAPS.items():
        count, pieces = cv2.connectedComponents((mask == CLASS_IDS[name]).astype(np.uint8))
        fate = rng.random(count)
        fate[0] = 1.0
        lost |= (fate < level.missing_share)[pieces]
        is_swapped = (fate >= level.missing_share) & (fate < level.missing_share + level.swap_share)
        result[is_swapped[pieces]] = CLASS_IDS[wrong]
    result[lost] = _surroundings(mask, lost)[lost]
    return result


def _punch_holes(mask: np.ndarray, rng: np.random.Generator, level: Degradation) -> np.ndarray:
    holes = np.zeros(mask.shape, dtype=np.uint8)
    for _ in range(rng.poisson(level.num_holes)):
        _draw_blob(holes, rng, (3.0, 12.0))
    if not holes.any() or holes.all():
        return mask
    return np.where(holes > 0, _surroundings(mask, holes > 0), mask)


def _invent(mask: np.ndarray, rng: np.random.Generator, level: Degradation) -> np.ndarray:
    """Small pieces of paint on the road and of poles elsewhere."""
    result = mask.copy()
    for _ in range(rng.poisson(level.num_false)):
        piece = np.zeros(mask.shape, dtype=np.uint8)
        if rng.random() < 0.6:
            _draw_blob(piece, rng, (1.5, 7.0))
            name, ground = str(rng.choice(["lane_dashed", "arrow", "crosswalk", "slot_line"])), ("road",)
        else:
            u, v = rng.uniform(0, mask.shape[1]), rng.uniform(0, mask.shape[0])
            end = (int(u + rng.normal()), int(v + rng.uniform(6.0, 25.0)))
            cv2.line(piece, (int(u), int(v)), end, 1, 1)
            name, ground = "pole", ("building", "wall", "terrain", "sidewalk", "vegetation")
        on_ground = np.isin(mask, [CLASS_IDS[base] for base in ground])
        result[(piece > 0) & on_ground] = CLASS_IDS[name]
    return result


def _draw_blob(canvas: np.ndarray, rng: np.random.Generator, size_px: tuple[float, float]) -> None:
    center = (int(rng.uniform(0, canvas.shape[1])), int(rng.uniform(0.4, 1.0) * canvas.shape[0]))
    axes = (int(rng.uniform(*size_px)) + 1, int(rng.uniform(*size_px) / 2) + 1)
    cv2.ellipse(canvas, center, axes, float(rng.uniform(0, 180)), 0, 360, 1, -1)
