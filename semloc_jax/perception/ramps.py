"""The ramps of one class of one mask on all levels (room: perception; host).

In: layers of a mask, levels. Out: values written in place: floats in [-1, 1], or bytes 0 .. 254 that span it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from semloc_jax import native
from semloc_jax.native.mask_ramps import LevelBytes, reaches, write_mask_ramps
from semloc_jax.perception.border_mask import SeenBorders
from semloc_jax.perception.distance import (
    coarse_signed_distance,
    content_boxes,
    edge_at,
    occupied_blocks,
    refined_signed_distance,
    signed_distance,
)
from semloc_jax.perception.edge_maps import gradient_cost, laplacian_cost

FAR_BYTE = 254
"""The byte of +1; 127 is 0, as in `residuals.texture`."""


class Level(NamedTuple):
    """One level of one channel of one camera."""

    out: Float[np.ndarray, "h w"] | UInt8[np.ndarray, "h w"]
    """Where the values go; +1 beforehand."""
    ramp_px: float
    stride: int


def fill_levels(
    levels: Sequence[Level], layers: UInt8[np.ndarray, "h w"], value: int, kind: str, blur_px: float
) -> None:
    """Write the ramps of the pixels of one value.

    Args:
        levels: Coarse to fine; all of floats or all of bytes.
        layers: The mask, height and width multiples of every stride.
        value: Pixels of this value are inside.
        kind: 'ramp', 'gradient' or 'laplacian'.
        blur_px: Smoothing along the boundary [px].
    """
    is_bytes = levels[0].out.dtype == np.uint8
    if is_bytes and kind == "ramp" and native.is_available() and _fill_natively(levels, layers, value, blur_px):
        return
    binary = cv2.compare(layers, float(value), cv2.CMP_EQ)
    if not cv2.countNonZero(binary):
        return
    floats = [level._replace(out=np.ones(level.out.shape, np.float32)) for level in levels] if is_bytes else levels
    if kind == "ramp":
        _fill_ramps(floats, binary, blur_px)
    else:
        _fill_edge_costs(floats, binary, kind)
    if is_bytes:
        for level, exact in zip(levels, floats, strict=True):
            level.out[:] = np.rint((exact.out + 1.0) * (FAR_BYTE / 2))


def fill_from_borders(levels: Sequence[Level], seen: SeenBorders, name: str) -> None:
    """Write the ramps of a class from the distances that a network tells.

    Args:
        levels: Coarse to fine.
        seen: What it says.
        name: Channel of the class.
    """
    counted = seen.counted_px(name)
    if counted is None:
        return
    for level in levels:
        height, width = level.out.shape
        share = np.clip(seen.at(counted, (width, height), level.stride) / np.float32(level.ramp_px), -1.0, 1.0)
        level.out[:] = np.rint((share + 1.0) * (FAR_BYTE / 2)) if level.out.dtype == np.uint8 else share


def _fill_natively(levels: Sequence[Level], layers: np.ndarray, value: int, blur_px: float) -> bool:
    """Whether the native kernel could write the levels."""
    full, reduced, base = _by_size(levels)
    jobs = []
    for stride, group in ((1, full), (base, reduced)):
        planes = [LevelBytes(level.out, level.stride, level.ramp_px) for level in group]
        edge = edge_at(stride, blur_px) if group and blur_px > 0 else None
        if group and (edge is None or not reaches(planes, edge, stride)):
            return False
        if group:
            jobs.append((stride, edge, planes))
    for stride, edge, planes in jobs:
        write_mask_ramps(layers, value, stride, edge, planes)
    return True


def _by_size(levels: Sequence[Level]) -> tuple[list[Level], list[Level], int]:
    """Levels of the full size, reduced ones, and the smallest stride of these."""
    full, reduced = [level for level in levels if level.stride == 1], [level for level in levels if level.stride > 1]
    return full, reduced, min((level.stride for level in reduced), default=1)


def _fill_ramps(levels: Sequence[Level], binary: np.ndarray, blur_px: float) -> None:
    full, reduced, base = _by_size(levels)
    blocks = occupied_blocks(binary)
    coarse = np.zeros((binary.shape[0] // base, binary.shape[1] // base), np.float32) if reduced and full else None
    for rows, columns in content_boxes(blocks, _reach_px(reduced, blur_px)) if reduced else []:
        distance = coarse_signed_distance(binary[rows, columns], base, blur_px)
        for level in reduced:
            _write_ramp(level, distance, (rows.start, columns.start), base)
        if coarse is not None:
            coarse[_scaled(rows, base), _scaled(columns, base)] = distance
    # A narrow band at full size; it lies inside the boxes of the reduced levels, whose ramps are wider.
    for rows, columns in content_boxes(blocks, _reach_px(full, blur_px)) if full else []:
        part = binary[rows, columns]
        if coarse is None or blur_px == 0 or _reach_px(full, blur_px) > _reach_px(reduced, blur_px):
            distance = signed_distance(part, blur_px)
        else:
            distance = refined_signed_distance(part, coarse[_scaled(rows, base), _scaled(columns, base)], blur_px)
        for level in full:
            _write_ramp(level, distance, (rows.start, columns.start), 1)


def _fill_edge_costs(levels: Sequence[Level], binary: np.ndarray, kind: str) -> None:
    """Write unsigned costs of the literature."""
    cost_of = gradient_cost if kind == "gradient" else laplacian_cost
    for level in levels:
        height, width = level.out.shape
        level.out[:] = cost_of(binary, level.ramp_px, level.stride)[:height, :width]


def _reach_px(levels: Sequence[Level], blur_px: float) -> float:
    """How far from the mask the distance of these levels is needed [px]."""
    return max(level.ramp_px + level.stride for level in levels) + 2.0 * blur_px


def _scaled(span: slice, stride: int) -> slice:
    return slice(span.start // stride, span.stop // stride)


def _write_ramp(level: Level, distance: np.ndarray, corner: tuple[int, int], base: int) -> None:
    """Write the box of a distance field with its top-left `corner` (row, column) of the mask into one level.

    The field is of stride `base` and may reach beyond the level.
    """
    stride = level.stride
    size = distance.shape[1] * base // stride, distance.shape[0] * base // stride
    field = distance if stride == base else cv2.resize(distance, size, interpolation=cv2.INTER_AREA)
    top, left = corner[0] // stride, corner[1] // stride
    target = level.out[top : top + size[1], left : left + size[0]]
    np.multiply(field[: target.shape[0], : target.shape[1]], np.float32(1.0 / level.ramp_px), out=target)
    np.clip(target, -1.0, 1.0, out=target)
