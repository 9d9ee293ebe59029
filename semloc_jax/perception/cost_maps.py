"""Cost maps: smooth ramps around the boundaries of a semantic mask, coarse to fine (room: perception; host).

In: masks of class ids, one for each camera, and their class table. Out: structs.CostMaps.
"""

import itertools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import cv2
import jax
import numpy as np
from numpy.typing import DTypeLike

from semloc_jax.errors import SemlocError
from semloc_jax.perception.border_mask import borders_of
from semloc_jax.perception.class_table import ClassTable
from semloc_jax.perception.distance import BLOCK_PX
from semloc_jax.perception.ramps import FAR_BYTE, Level, fill_from_borders, fill_levels
from semloc_jax.runtime.allocator import ALIGN_BYTES, used_again
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
    quantised: bool = False,
) -> CostMaps:
    """Cost maps of one frame: for every camera, channel and level the clipped signed distance to the mask boundary.

    Args:
        masks: class ids, uint8[h w], one for each camera; smaller masks are padded with unusable pixels. Where a mask
            knows its borders (`BorderMask`), its own distances are taken.
        table: the class table of the masks.
        config: None for the defaults.
        channels: the channels to fill (those of the local map), None for all; the others stay at +1.
        quantised: bytes, as textures hold them; many times faster where there are native kernels, which take the exact
            distance where OpenCV's is near enough.

    Returns:
        CostMaps whose channel axis is that of `table.channels`.

    >>> maps = sj.cost_maps([mask], sj.load_class_table("drive"))
    >>> [level.shape for level in maps.ramps][-1]
    (1, 13, 400, 640)
    """
    config = config or CostMapConfig()
    wanted = range(len(table.channels)) if channels is None else sorted(set(channels))
    ramps, usable = mask_ramps(masks, table, config, wanted, np.uint8 if quantised else np.float32)
    return CostMaps(
        ramps=tuple(jax.device_put(ramp) for ramp in ramps),
        ramp_px=tuple(float(ramp) for ramp in config.ramp_px),
        stride=tuple(config.stride),
        usable=jax.device_put(usable),
        usable_stride=config.usable_stride,
    )


def mask_ramps(
    masks: Sequence[np.ndarray], table: ClassTable, config: CostMapConfig, channels: Sequence[int], dtype: DTypeLike
) -> tuple[list[np.ndarray], np.ndarray]:
    """The arrays of `cost_maps` on the host: ramps of every level `[cam channel h w]`, and which pixels are usable.

    Args:
        masks: as `cost_maps`.
        table: as `cost_maps`.
        config: as `cost_maps`.
        channels: the channels to fill.
        dtype: float32, or uint8 for bytes 0 .. 254 that span [-1, 1].
    """
    _check_masks(masks)
    height, width = (max(mask.shape[axis] for mask in masks) for axis in (0, 1))
    shape = (len(masks), len(table.channels))
    ramps = _saturated([(*shape, -(-height // s), -(-width // s)) for s in config.stride], dtype)
    u = config.usable_stride
    usable = np.zeros((len(masks), -(-height // u), -(-width // u)), bool)
    padded = [_pad_to_blocks(mask) for mask in masks]
    layers = [cv2.LUT(mask, table.layer_numbers) for mask in padded]
    for camera, mask in enumerate(masks):
        _fill_usable(usable[camera], padded[camera], mask.shape, table, config)

    def fill(camera: int, channel: int) -> None:
        kind = _kind_of(table, channel, config)
        h, w = masks[camera].shape
        levels = [
            Level(ramp[camera, channel, : -(-h // s), : -(-w // s)], ramp_px, s)
            for ramp, ramp_px, s in zip(ramps, config.ramp_px, config.stride, strict=True)
        ]
        seen = borders_of(masks[camera])
        if seen is not None and table.channels[channel].name in seen.names:
            fill_from_borders(levels, seen, table.channels[channel].name)
            return
        fill_levels(levels, layers[camera], channel + 1, kind, config.blur_px)

    jobs = [partial(fill, *job) for job in itertools.product(range(len(masks)), channels)]
    _run_all(jobs, by_thread=np.dtype(dtype) != np.uint8)
    return ramps, usable


def _run_all(jobs: Sequence[Callable[[], None]], by_thread: bool) -> None:
    """Run jobs that each write their own planes; OpenCV releases the interpreter lock."""
    if not by_thread:  # each takes less time than a thread to start
        for job in jobs:
            job()
        return
    with ThreadPoolExecutor() as pool:
        for done in [pool.submit(job) for job in jobs]:
            done.result()


def _kind_of(table: ClassTable, channel: int, config: CostMapConfig) -> str:
    if config.kind != "literature":
        return config.kind
    return "laplacian" if ElementClass.SIGN in table.channels[channel].classes else "gradient"


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


def _pad_to_blocks(mask: np.ndarray) -> np.ndarray:
    bottom, right = -mask.shape[0] % BLOCK_PX, -mask.shape[1] % BLOCK_PX
    return cv2.copyMakeBorder(mask, 0, bottom, 0, right, cv2.BORDER_REPLICATE)


def _saturated(shapes: Sequence[tuple[int, ...]], dtype: DTypeLike) -> list[np.ndarray]:
    """Ramps of empty masks, aligned so that JAX on the CPU takes the memory over without a copy."""
    sizes = [int(np.prod(shape)) * np.dtype(dtype).itemsize for shape in shapes]
    starts = np.cumsum([0, *(-(-size // ALIGN_BYTES) * ALIGN_BYTES for size in sizes)]).tolist()
    block = used_again(starts[-1])
    block.view(dtype).fill(1.0 if np.dtype(dtype) == np.float32 else FAR_BYTE)
    parts = (block[start : start + size] for start, size in zip(starts, sizes, strict=False))
    return [part.view(dtype).reshape(shape) for part, shape in zip(parts, shapes, strict=True)]


def _check_masks(masks: Sequence[np.ndarray]) -> None:
    if isinstance(masks, np.ndarray) or len(masks) == 0:
        raise SemlocError("cost maps: expected a list with one mask for each camera")
    for index, mask in enumerate(masks):
        if mask.dtype != np.uint8 or mask.ndim != 2 or mask.size == 0:
            raise SemlocError(
                f"cost maps: mask {index} is {mask.dtype}{list(mask.shape)}, expected class ids uint8[h w] (read_mask)"
            )
