"""Cost maps: smooth ramps around the boundaries of a semantic mask, coarse to fine (room: perception; host).

In: masks of class ids, one for each camera, and their class table. Out: structs.CostMaps.
"""

import itertools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import jax
import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.perception.class_table import ClassTable
from semloc_jax.perception.distance import (
    BLOCK_PX,
    coarse_signed_distance,
    content_boxes,
    occupied_blocks,
    refined_signed_distance,
    signed_distance,
)
from semloc_jax.perception.edge_maps import gradient_cost, laplacian_cost
from semloc_jax.structs import CostMaps, ElementClass

KINDS = ("ramp", "gradient", "laplacian", "literature")


@dataclass(frozen=True)
class CostMapConfig:
    """How masks become cost maps; one entry of `ramp_px` and `stride` for each level, coarsest first."""

    ramp_px: tuple[float, ...] = (40.0, 14.0, 8.0, 3.0)
    """Distance [px of the full mask] at which the ramp of a level saturates."""
    stride: tuple[int, ...] = (4, 2, 2, 1)
    """Pixels of the full mask in one pixel of the level: 1, 2, 4, 8 or 16."""
    blur_px: float = 1.0
    """Smoothing along the boundary that makes it sub-pixel [px]."""
    kind: str = "ramp"
    """'ramp': signed distance. 'gradient', 'laplacian': unsigned costs of the literature; 'literature': the former for
    all but signs, the latter for signs."""
    grow_unusable_px: int = 2
    """Margin around ego body, dynamic objects and ignored pixels [px]: the outlines they cut are not real."""
    usable_stride: int = 2

    def __post_init__(self) -> None:
        if len(self.ramp_px) != len(self.stride) or not self.ramp_px:
            raise SemlocError(
                f"cost maps: ramp_px {self.ramp_px} and stride {self.stride} need one entry for each level"
            )
        if min(self.ramp_px) <= 0 or self.blur_px < 0 or self.grow_unusable_px < 0:
            raise SemlocError(
                f"cost maps: ramp_px must be positive, blur_px and grow_unusable_px not negative; got {self}"
            )
        if any(stride not in (1, 2, 4, 8, 16) for stride in (*self.stride, self.usable_stride)):
            raise SemlocError(f"cost maps: strides must be 1, 2, 4, 8 or 16, got {self.stride}, {self.usable_stride}")
        if self.kind not in KINDS:
            raise SemlocError(f"cost maps: unknown kind '{self.kind}'; expected one of {', '.join(KINDS)}")


def cost_maps(
    masks: Sequence[np.ndarray],
    table: ClassTable,
    config: CostMapConfig | None = None,
    channels: Sequence[int] | None = None,
) -> CostMaps:
    """Cost maps of one frame: for every camera, channel and level the clipped signed distance to the mask boundary.

    Args:
        masks: class ids, uint8[h w], one for each camera; smaller masks are padded with unusable pixels.
        table: the class table of the masks.
        config: None for the defaults.
        channels: the channels to fill (those of the local map), None for all; the others stay at +1.

    Returns:
        CostMaps whose channel axis is that of `table.channels`.
    """
    config = config or CostMapConfig()
    _check_masks(masks)
    wanted = range(len(table.channels)) if channels is None else sorted(set(channels))
    height, width = (max(mask.shape[axis] for mask in masks) for axis in (0, 1))
    shape = (len(masks), len(table.channels))
    ramps = [_ones((*shape, -(-height // s), -(-width // s))) for s in config.stride]
    u = config.usable_stride
    usable = np.zeros((len(masks), -(-height // u), -(-width // u)), bool)
    padded = [_pad_to_blocks(mask) for mask in masks]
    layers = [cv2.LUT(mask, _layer_numbers(table)) for mask in padded]
    for camera, mask in enumerate(masks):
        _fill_usable(usable[camera], padded[camera], mask.shape, table, config)

    def fill(camera: int, channel: int) -> None:
        binary = cv2.compare(layers[camera], channel + 1.0, cv2.CMP_EQ)
        if cv2.countNonZero(binary):
            planes = [ramp[camera, channel] for ramp in ramps]
            kind = _kind_of(table, channel, config)
            if kind == "ramp":
                _fill_channel(planes, binary, masks[camera].shape, config)
            else:
                _fill_edge_costs(planes, binary, masks[camera].shape, kind, config)

    jobs = list(itertools.product(range(len(masks)), wanted))
    # OpenCV lets go of the interpreter lock, and every job writes its own planes.
    with ThreadPoolExecutor() as pool:
        list(pool.map(fill, *zip(*jobs, strict=True)) if jobs else [])
    return CostMaps(
        ramps=tuple(jax.device_put(ramp) for ramp in ramps),
        ramp_px=tuple(float(ramp) for ramp in config.ramp_px),
        stride=tuple(config.stride),
        usable=jax.device_put(usable),
        usable_stride=u,
    )


def _fill_channel(out: list[np.ndarray], binary: np.ndarray, shape: tuple[int, int], config: CostMapConfig) -> None:
    """Write the ramps of one channel of one camera into its levels `out`."""
    levels = list(zip(out, config.ramp_px, config.stride, strict=True))
    full, reduced = [level for level in levels if level[2] == 1], [level for level in levels if level[2] > 1]
    base = min((stride for _, _, stride in reduced), default=1)
    blocks = occupied_blocks(binary)
    coarse = np.zeros((binary.shape[0] // base, binary.shape[1] // base), np.float32) if reduced and full else None
    for rows, columns in content_boxes(blocks, _reach_px(reduced, config)) if reduced else []:
        distance = coarse_signed_distance(binary[rows, columns], base, config.blur_px)
        for level, ramp_px, stride in reduced:
            _write_ramp(level, distance, (rows.start, columns.start), shape, ramp_px, stride, base)
        if coarse is not None:
            coarse[_scaled(rows, base), _scaled(columns, base)] = distance
    # A narrow band at full size; it lies inside the boxes of the reduced levels, whose ramps are wider.
    for rows, columns in content_boxes(blocks, _reach_px(full, config)) if full else []:
        part = binary[rows, columns]
        if coarse is None or config.blur_px == 0 or _reach_px(full, config) > _reach_px(reduced, config):
            distance = signed_distance(part, config.blur_px)
        else:
            distance = refined_signed_distance(
                part, coarse[_scaled(rows, base), _scaled(columns, base)], config.blur_px
            )
        for level, ramp_px, stride in full:
            _write_ramp(level, distance, (rows.start, columns.start), shape, ramp_px, stride, 1)


def _kind_of(table: ClassTable, channel: int, config: CostMapConfig) -> str:
    if config.kind != "literature":
        return config.kind
    return "laplacian" if ElementClass.SIGN in table.channels[channel].classes else "gradient"


def _fill_edge_costs(
    out: list[np.ndarray], binary: np.ndarray, shape: tuple[int, int], kind: str, config: CostMapConfig
) -> None:
    """Write the unsigned costs of one channel of one camera into its levels `out`."""
    cost_of = gradient_cost if kind == "gradient" else laplacian_cost
    for level, ramp_px, stride in zip(out, config.ramp_px, config.stride, strict=True):
        height, width = -(-shape[0] // stride), -(-shape[1] // stride)
        level[:height, :width] = cost_of(binary, ramp_px, stride)[:height, :width]


def _reach_px(levels: list[tuple[np.ndarray, float, int]], config: CostMapConfig) -> float:
    """How far from the mask the distance of these levels is needed [px]."""
    return max(ramp_px + stride for _, ramp_px, stride in levels) + 2.0 * config.blur_px


def _scaled(span: slice, stride: int) -> slice:
    return slice(span.start // stride, span.stop // stride)


def _write_ramp(
    level: np.ndarray,
    distance: np.ndarray,
    corner: tuple[int, int],
    shape: tuple[int, int],
    ramp_px: float,
    stride: int,
    base: int,
) -> None:
    """Write the box of a distance field with its top-left `corner` (row, column) into one level.

    Args:
        shape: height and width of the full mask; the field may reach beyond it.
        base: stride of `distance`.
    """
    size = distance.shape[1] * base // stride, distance.shape[0] * base // stride
    field = distance if stride == base else cv2.resize(distance, size, interpolation=cv2.INTER_AREA)
    top, left = corner[0] // stride, corner[1] // stride
    target = level[top : min(top + size[1], -(-shape[0] // stride)), left : min(left + size[0], -(-shape[1] // stride))]
    np.multiply(field[: target.shape[0], : target.shape[1]], np.float32(1.0 / ramp_px), out=target)
    np.clip(target, -1.0, 1.0, out=target)


def _fill_usable(
    out: np.ndarray, padded: np.ndarray, shape: tuple[int, int], table: ClassTable, config: CostMapConfig
) -> None:
    hidden = np.zeros(256, np.uint8)
    hidden[list(table.unusable_ids)] = 255
    bad = cv2.LUT(padded, hidden)
    if config.grow_unusable_px:
        size = 2 * config.grow_unusable_px + 1
        bad = cv2.dilate(bad, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
    u = config.usable_stride
    # The mean over the block: a coarse pixel is usable only if all of its pixels are.
    bad = cv2.resize(bad, (bad.shape[1] // u, bad.shape[0] // u), interpolation=cv2.INTER_AREA)
    h, w = -(-shape[0] // u), -(-shape[1] // u)
    out[:h, :w] = bad[:h, :w] == 0


def _layer_numbers(table: ClassTable) -> np.ndarray:
    """For each mask id one more than its channel, 0 if it has none; uint8[256]."""
    numbers = np.zeros(256, np.uint8)
    for index, channel in enumerate(table.channels):
        numbers[list(channel.mask_ids)] = index + 1
    return numbers


def _pad_to_blocks(mask: np.ndarray) -> np.ndarray:
    bottom, right = -mask.shape[0] % BLOCK_PX, -mask.shape[1] % BLOCK_PX
    return cv2.copyMakeBorder(mask, 0, bottom, 0, right, cv2.BORDER_REPLICATE)


def _ones(shape: tuple[int, ...]) -> np.ndarray:
    """Ones, float32, aligned so that JAX on the CPU takes the memory over without a copy."""
    size = int(np.prod(shape))
    raw = np.empty(size * 4 + 64, np.uint8)
    start = -raw.ctypes.data % 64
    ones = raw[start : start + size * 4].view(np.float32).reshape(shape)
    ones.fill(1.0)
    return ones


def _check_masks(masks: Sequence[np.ndarray]) -> None:
    if isinstance(masks, np.ndarray) or len(masks) == 0:
        raise SemlocError("cost maps: expected a list with one mask for each camera")
    for index, mask in enumerate(masks):
        if mask.dtype != np.uint8 or mask.ndim != 2 or mask.size == 0:
            raise SemlocError(
                f"cost maps: mask {index} is {mask.dtype}{list(mask.shape)}, expected class ids uint8[h w] (read_mask)"
            )
