"""The samples of the map that poses see, and how far each lies from the borders of its masks (room: alignment; host).

In: poses, map samples, cameras, distances to mask borders. Out: SeenSamples: one row for each that is seen.
Most samples of a map lie out of view. The kernels write nothing of these; without kernels `observed.observe` says the
same of all of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from semloc_jax.alignment.observed import (
    CELL_COLUMNS,
    COARSE_CHUNK,
    Borders,
    CoarseSamples,
    ObserveConfig,
    Observed,
    coarse_evidence,
    observe,
)
from semloc_jax.cameras import Rig
from semloc_jax.cameras.models import native_class_of
from semloc_jax.native.seen_rows import Field, add_gains, rows_seen
from semloc_jax.residuals import native_kernels
from semloc_jax.residuals.robust import LOSSES
from semloc_jax.residuals.view import GROUND_CLASSES
from semloc_jax.structs import MapSamples

_BATCH, COARSE_BATCH = 64, 2048
"""Most poses that JAX looks at in one call, closely and coarsely; of fewer, only those asked for cost time."""


@dataclass(frozen=True)
class SeenSamples:
    """What poses see, one row for each pose, camera and sample, in this order.

    Attributes:
        num_poses, num_cameras: how many there are.
        pose, camera, sample: `int[row]`.
        signed_px: distance to the border of the sample's class, negative inside of the mask, `float[row]`.
        length_px: length in the image that the sample stands for.
        cell: cell of the image, `int[row]`.
        range_m: how far away.
    """

    num_poses: int
    num_cameras: int
    pose: Int[np.ndarray, " row"]
    camera: Int[np.ndarray, " row"]
    sample: Int[np.ndarray, " row"]
    signed_px: Float[np.ndarray, " row"]
    length_px: Float[np.ndarray, " row"]
    cell: Int[np.ndarray, " row"]
    range_m: Float[np.ndarray, " row"]

    @classmethod
    def of(cls, observed: Observed) -> "SeenSamples":
        """What is seen of all that was looked at."""
        rows = np.nonzero(observed.length_px > 0)
        num_poses, num_cameras = observed.length_px.shape[:2]
        values = {name: getattr(observed, name)[rows] for name in Observed._fields}
        return cls(num_poses, num_cameras, *rows, **values)

    def joined(self, other: "SeenSamples") -> "SeenSamples":
        """These poses and others after them."""
        other = replace(other, pose=other.pose + self.num_poses, num_poses=self.num_poses + other.num_poses)
        pairs = {name: (getattr(self, name), getattr(other, name)) for name in _ROWS}
        return replace(other, **{name: np.concatenate(pair) for name, pair in pairs.items()})

    def only(self, part: Bool[np.ndarray, " p"]) -> "SeenSamples":
        """What is seen of a part of the samples."""
        kept = part[self.sample]
        return replace(self, **{name: getattr(self, name)[kept] for name in _ROWS})


_ROWS = tuple(field.name for field in fields(SeenSamples) if not field.name.startswith("num_"))


def seen_from(
    Ts_map_base: Float[np.ndarray, "n 4 4"],
    samples: MapSamples,
    rig: Rig,
    channel_of_label: Int[np.ndarray, " label"],
    borders: Borders,
    config: ObserveConfig,
) -> SeenSamples:
    """What each pose sees; arguments as `observe`, all of them arrays of the host."""
    known = samples, rig, channel_of_label, borders, config
    return _by_kernels(Ts_map_base, *known) if _has_kernels(rig, config) else _by_jax(Ts_map_base, *known)


def _has_kernels(rig: Rig, config: ObserveConfig) -> bool:
    return all(native_kernels.use(config.path, c, LOSSES["tukey"], np.float32) == "analytic" for c in rig.cameras)


def _by_kernels(
    Ts_map_base: np.ndarray,
    samples: MapSamples,
    rig: Rig,
    channel_of_label: np.ndarray,
    borders: Borders,
    config: ObserveConfig,
) -> SeenSamples:
    columns, parts = jax.tree.leaves(samples), []
    strides = float(borders.stride), float(borders.usable_stride)
    limits = config.border_px, config.max_range_m, config.min_ground_px_per_m, config.cell_px
    for index, (camera, T_base_cam) in enumerate(zip(rig.cameras, rig.T_base_cam, strict=True)):
        leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(camera)]
        known = native_class_of(camera), leaves, T_base_cam, Ts_map_base, columns
        field = Field(borders.signed_px[index], strides[0], borders.usable[index], strides[1])
        parts.append(rows_seen(*known, channel_of_label, len(GROUND_CLASSES), field, limits, CELL_COLUMNS))
    camera = np.repeat(np.arange(len(parts)), [len(part.pose) for part in parts])
    rows = {name: _in_order([getattr(part, name) for part in parts], parts) for name in parts[0]._fields}
    return SeenSamples(len(Ts_map_base), len(parts), camera=_in_order([camera], parts), **rows)


def _in_order(columns: Sequence[np.ndarray], parts: Sequence) -> np.ndarray:
    """Columns of several cameras one after another, as one column by pose."""
    if len(parts) == 1:
        return columns[0]
    order = np.argsort(np.concatenate([part.pose for part in parts]), kind="stable")
    return np.concatenate(columns)[order]


def _by_jax(
    Ts_map_base: np.ndarray,
    samples: MapSamples,
    rig: Rig,
    channel_of_label: np.ndarray,
    borders: Borders,
    config: ObserveConfig,
) -> SeenSamples:
    found: SeenSamples | None = None
    for first in range(0, len(Ts_map_base), _BATCH):
        own = Ts_map_base[first : first + _BATCH]
        poses = np.resize(np.asarray(own, np.float32), (_BATCH, 4, 4))
        seen = observe(poses, np.int32(len(own)), samples, rig, channel_of_label, borders, config)
        part = SeenSamples.of(jax.tree.map(lambda leaf, own=own: np.asarray(leaf)[: len(own)], seen))
        found = part if found is None else found.joined(part)
    return found


def coarse_nats(
    Ts_map_base: Float[np.ndarray, "n 4 4"],
    samples: CoarseSamples,
    num_parts: int,
    rig: Rig,
    gain: Float[np.ndarray, "cam channel h w"],
    stride: float,
    config: ObserveConfig,
) -> Float[np.ndarray, " n"]:
    """`coarse_evidence` of any number of poses, on the host; `num_parts` of the samples count."""
    if not _has_kernels(rig, config):
        return _coarse_by_jax(Ts_map_base, samples, num_parts, rig, gain, stride, config)
    nats = np.zeros(len(Ts_map_base), np.float32)
    p_map = np.concatenate(samples.p_map[:num_parts], axis=1)
    channel, weight = (leaf[:num_parts].reshape(-1) for leaf in (samples.channel, samples.weight))
    numbers = stride, config.border_px, config.max_range_m
    for index, (camera, T_base_cam) in enumerate(zip(rig.cameras, rig.T_base_cam, strict=True)):
        known = native_class_of(camera), jax.tree.leaves(camera), T_base_cam, Ts_map_base
        add_gains(*known, (p_map, channel, weight), gain[index], numbers, nats)
    return nats


def _coarse_by_jax(
    Ts_map_base: np.ndarray,
    samples: CoarseSamples,
    num_parts: int,
    rig: Rig,
    gain: np.ndarray,
    stride: float,
    config: ObserveConfig,
) -> np.ndarray:
    found = []
    for first in range(0, len(Ts_map_base), COARSE_BATCH):
        own = Ts_map_base[first : first + COARSE_BATCH]
        poses = np.resize(np.asarray(own, np.float32), (COARSE_BATCH, 4, 4))
        num = np.int32(-(-len(own) // COARSE_CHUNK) * COARSE_CHUNK)
        known = samples, np.int32(num_parts), rig, gain, np.float32(stride), config
        found.append(np.asarray(coarse_evidence(poses, num, *known))[: len(own)])
    return np.concatenate(found)
