"""How far the map as a camera sees it lies from the borders of the masks (room: alignment; pure JAX).

In: poses, map samples, cameras, distances to mask borders. Out: Observed, one row for each pose, camera and sample.
Every pose sees the map for itself: what is in view, how long it is in the image and how far away.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from semloc_jax.alignment.filled_rows import map_filled
from semloc_jax.cameras import Camera, Rig
from semloc_jax.geometry import lie
from semloc_jax.residuals.native_kernels import Path
from semloc_jax.residuals.projection import projected
from semloc_jax.residuals.view import GROUND_CLASSES, contour_points
from semloc_jax.runtime.stored_program import stored_program
from semloc_jax.structs import MapSamples

CELL_COLUMNS = 1024
"""Cells of one row of the image; the number of a cell is row x CELL_COLUMNS + column."""
LONGEST_PX = 50.0
"""A sample stands for no more contour than this in the image; as kLongestPx of native/src/view.h."""


@dataclass(frozen=True)
class ObserveConfig:
    """What counts as seen."""

    max_range_m: float = 60.0
    min_ground_px_per_m: float = 0.6
    """See `residuals.view.ViewConfig`."""
    cell_px: float = 48.0
    """Size of the cells of the image in which samples of one element are one observation."""
    border_px: float = 2.0
    """Samples nearer to the border of the image do not exist."""
    path: Path = "auto"
    """How points are projected; see `semloc_jax.residuals.native_kernels`."""


class Borders(NamedTuple):
    """Distances to the borders of the masks, on the device."""

    signed_px: Float[Array, "cam channel h w"]
    stride: Float[Array, ""]
    usable: Bool[Array, "cam uh uw"]
    usable_stride: Float[Array, ""]


class Observed(NamedTuple):
    """What each pose sees of each sample."""

    signed_px: Float[Array, "n cam p"]
    """Distance to the border of the sample's class, negative inside of the mask [px]."""
    length_px: Float[Array, "n cam p"]
    """Length in the image that the sample stands for; 0 where it does not exist for the pose."""
    cell: Int[Array, "n cam p"]
    """Cell of the image."""
    range_m: Float[Array, "n cam p"]


@stored_program("config", fused=True)
def observe(
    Ts_local_base: Float[Array, "n 4 4"],
    num: Int[Array, ""],
    samples: MapSamples,
    rig: Rig,
    channel_of_label: Int[Array, " label"],
    borders: Borders,
    config: ObserveConfig,
) -> Observed:
    """What every pose sees.

    Args:
        Ts_local_base: Poses relative to the local origin.
        num: How many of them are asked for; what the others see stays zero.
        samples: Map samples.
        rig: Cameras.
        channel_of_label: Mask channel of each ElementClass; -1 where no mask shows the class.
        borders: Distances to mask borders, one field for each camera and channel.
        config: What counts as seen.
    """
    channel = channel_of_label[samples.label]

    def one(T_local_base: Array) -> Observed:
        parts = []
        for index, (camera, T_base_cam) in enumerate(zip(rig.cameras, rig.T_base_cam, strict=True)):
            T_local_cam = T_local_base @ jnp.asarray(T_base_cam, T_local_base.dtype)
            fields = borders.signed_px[index], borders.usable[index]
            camera = camera.astype(T_local_base.dtype)
            parts.append(_one_camera(T_local_cam, samples, channel, camera, fields, borders, config))
        return jax.tree.map(lambda *leaves: jnp.stack(leaves), *parts)

    return map_filled(one, Ts_local_base, num)


def _one_camera(
    T_local_cam: Array,
    samples: MapSamples,
    channel: Array,
    camera: Camera,
    fields: tuple[Array, Array],
    borders: Borders,
    config: ObserveConfig,
) -> Observed:
    p_map, is_contour = contour_points(samples, T_local_cam[:3, 3])
    T_cam_local = lie.inverse(T_local_cam)
    p_cam = lie.transform(T_cam_local, p_map)
    u, v, valid, *_ = pixels = projected(camera, p_cam.T, config.path)

    def moved_px(direction: Array) -> Array:
        du, dv = pixels.moved_px(direction @ T_cam_local[:3, :3].T)
        return jnp.sqrt(du * du + dv * dv)

    away = (p_map - T_local_cam[:3, 3]) * jnp.asarray([1.0, 1.0, 0.0], p_map.dtype)
    away = away / jnp.maximum(jnp.linalg.norm(away, axis=-1, keepdims=True), 1e-3)
    length_px = moved_px(samples.tangent_map) * samples.length_m
    range_m = jnp.linalg.norm(p_cam, axis=-1)
    on_ground = jnp.isin(samples.label, jnp.asarray(GROUND_CLASSES))
    resolved = ~on_ground | (moved_px(away) >= config.min_ground_px_per_m)
    distance, usable = fields
    seen = samples.valid & is_contour & (channel >= 0) & valid & camera.in_image(u, v, config.border_px)
    seen = (
        seen
        & resolved
        & (range_m < config.max_range_m)
        & _at(usable, u / borders.usable_stride, v / borders.usable_stride)
    )
    height, width = distance.shape[1:]
    x = jnp.clip(jnp.nan_to_num((u + 0.5) / borders.stride - 0.5), 0, width - 1.001)
    y = jnp.clip(jnp.nan_to_num((v + 0.5) / borders.stride - 0.5), 0, height - 1.001)
    column, row = x.astype(jnp.int32), y.astype(jnp.int32)
    fu, fv = x - column, y - row
    first = (jnp.maximum(channel, 0) * height + row) * width + column
    flat = distance.reshape(-1)
    a, b, c, d = (flat.at[first + step].get(mode="promise_in_bounds") for step in (0, 1, width, width + 1))
    top, bottom = a + fu * (b - a), c + fu * (d - c)
    # Not `//`: XLA calls a library function for each remainder, which costs as much as all the rest.
    down, across = (jnp.floor(jnp.nan_to_num(w) * (1.0 / config.cell_px)) for w in (v, u))
    cell = jnp.where(seen, down * CELL_COLUMNS + across, 0)
    return Observed(
        top + fv * (bottom - top),
        jnp.where(seen, jnp.minimum(length_px, LONGEST_PX), 0.0),
        cell.astype(jnp.int32),
        jnp.where(seen, range_m, 0.0),
    )


def _at(usable: Array, column: Array, row: Array) -> Array:
    height, width = usable.shape
    column = jnp.clip(jnp.nan_to_num(column), 0, width - 1).astype(jnp.int32)
    row = jnp.clip(jnp.nan_to_num(row), 0, height - 1).astype(jnp.int32)
    return usable.reshape(-1).at[row * width + column].get(mode="promise_in_bounds")


class CoarseSamples(NamedTuple):
    """Samples for a first look: each stands for the same length in the image."""

    p_map: Float[Array, "part 3 p"]
    channel: Int[Array, "part p"]
    weight: Float[Array, "part p"]
    """Observations that a sample stands for; 0 for padding."""


COARSE_CHUNK = 16
"""Poses of a first look side by side."""


@stored_program("config", "chunk", fused=True)
def coarse_evidence(
    Ts_local_base: Float[Array, "n 4 4"],
    num: Int[Array, ""],
    samples: CoarseSamples,
    num_parts: Int[Array, ""],
    rig: Rig,
    gain: Float[Array, "cam channel h w"],
    stride: Float[Array, ""],
    config: ObserveConfig,
    chunk: int = COARSE_CHUNK,
) -> Float[Array, " n"]:
    """Nats that the masks hold for every pose against seeing the map elsewhere, from few samples.

    How many poses and samples are asked for is data: many poses by few samples and few poses by all are one program.

    Args:
        Ts_local_base: Poses relative to the local origin; their number is a multiple of `chunk`.
        num: How many of them are asked for, a multiple of `chunk`; the others stay zero.
        samples: Which samples, and how much each counts.
        num_parts: Parts of the samples that count, from the first on.
        rig: Cameras.
        gain: Nats of one observation by the pixel that it falls on; 0 where pixels are not usable.
        stride: Pixels of the full mask in one of `gain`.
        config: Range and border.
        chunk: Poses side by side.
    """
    height, width = gain.shape[2:]

    def of_part(part: Array, T_local_base: Array) -> Array:
        p_map, channel, weight = jax.tree.map(lambda leaf: leaf[part], samples)
        total = jnp.zeros((), T_local_base.dtype)
        for index, (camera, T_base_cam) in enumerate(zip(rig.cameras, rig.T_base_cam, strict=True)):
            T_cam_local = lie.inverse(T_local_base @ jnp.asarray(T_base_cam, T_local_base.dtype))
            x, y, z = (T_cam_local[k, :3] @ p_map + T_cam_local[k, 3] for k in range(3))
            camera = camera.astype(T_local_base.dtype)
            u, v, valid = camera.project_xyz(x, y, z)
            seen = valid & camera.in_image(u, v, config.border_px) & (x * x + y * y + z * z < config.max_range_m**2)
            column = jnp.clip(jnp.nan_to_num(u / stride), 0, width - 1).astype(jnp.int32)
            row = jnp.clip(jnp.nan_to_num(v / stride), 0, height - 1).astype(jnp.int32)
            where = (channel * height + row) * width + column
            nats = gain[index].reshape(-1).at[where].get(mode="promise_in_bounds")
            total = total + jnp.sum(jnp.where(seen, nats * weight, 0.0))
        return total

    def of_chunk(Ts: Array) -> Array:
        def with_part(part: Array, total: Array) -> Array:
            return total + jax.vmap(lambda T: of_part(part, T))(Ts)

        return jax.lax.fori_loop(0, num_parts, with_part, jnp.zeros(chunk, Ts.dtype))

    return map_filled(of_chunk, Ts_local_base.reshape(-1, chunk, 4, 4), num // chunk).reshape(-1)
