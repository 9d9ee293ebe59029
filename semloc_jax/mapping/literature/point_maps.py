"""The points that masks show on the road, gathered over stretches of a drive (room: mapping; host).

In: a drive, its masks, its chain. Out: PointMaps: points of frames in `base`, local maps around a frame.
AVP-SLAM (arXiv 2007.01813): pixels of each class by inverse perspective mapping, carried by odometry to a local map of
30 m. The road is where the wheels stand before and after.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from semloc_jax.alignment.class_icp import ClassPoints
from semloc_jax.datasets import Drive
from semloc_jax.geometry import rigid
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.chain import Chain
from semloc_jax.mapping.looking import Looker, RoadLookConfig, paint_layers


@dataclass(frozen=True)
class PointMapConfig:
    """How points are gathered."""

    range_m: float = 12.0
    """Reach on the road; ours."""
    voxel_m: float = 0.1
    """One point for each class and voxel."""
    every_m: float = 1.0
    """Way between the frames that look; ours."""
    stretch_m: float = 30.0
    """Way of a local map."""


@dataclass(frozen=True)
class PointMaps:
    """What the frames of a drive saw, each in its own base frame."""

    chain: Chain
    frames: Int[np.ndarray, " k"]
    """Frames of the chain that looked."""
    points: Sequence[ClassPoints]
    config: PointMapConfig

    def around(self, frame: int, first_m: float, last_m: float) -> ClassPoints:
        """The local map of the frames that looked between two places of the way [m], in the base frame of `frame`.

        It is carried by odometry alone; thinned to one point for each class and voxel.
        """
        way_m = self.chain.way_m[self.frames]
        T_base_odom = rigid.inverse(self.chain.Ts_odom_base[frame])
        rows = np.flatnonzero((way_m >= first_m) & (way_m <= last_m))
        parts = [self.points[row].moved(T_base_odom @ self.chain.Ts_odom_base[self.frames[row]]) for row in rows]
        return ClassPoints.joined(parts).thinned(self.config.voxel_m)

    def in_map(self, Ts_map_base: Float[np.ndarray, "n 4 4"]) -> ClassPoints:
        """All points along poses of all frames, thinned."""
        parts = [points.moved(Ts_map_base[k]) for k, points in zip(self.frames, self.points, strict=True)]
        return ClassPoints.joined(parts).thinned(self.config.voxel_m)


def frames_by_way(way_m: Float[np.ndarray, " n"], every_m: float) -> Int[np.ndarray, " k"]:
    """The first frame on every so many metres of the way: a vehicle that stands sees nothing new."""
    return np.unique(np.floor(way_m / every_m), return_index=True)[1]


def gathered_points(
    drive: Drive,
    masks: MaskSource,
    chain: Chain,
    config: PointMapConfig | None = None,
    told: Callable[[Iterable], Iterable] = iter,
) -> PointMaps:
    """The points of all frames that look.

    Args:
        drive: the drive.
        masks: what its cameras see.
        chain: its way by its own sensors.
        config: None for the defaults.
        told: wraps the frames, to show progress.

    Raises:
        SemlocError: the masks show no paint, or no camera shows the road.
    """
    config = config or PointMapConfig()
    looker = Looker(drive, masks, RoadLookConfig(config.range_m, config.voxel_m))
    layers, layer_of_id = paint_layers(masks.table)
    label_of_plane = {plane: int(layer.label) for layer in layers for plane in layer.planes}
    label_of_id = np.array([label_of_plane.get(int(plane), -1) for plane in layer_of_id])
    frames = frames_by_way(chain.way_m, config.every_m)
    points = []
    for index in told(frames):
        parts = []
        for look in looker.looks(drive.frames[index], int(index), chain.Ts_odom_base):
            label = label_of_id[look.ids]
            paint = (label >= 0) & ~look.hidden
            parts.append(ClassPoints.of(look.table.on_road(look.heights)[paint], label[paint]))
        points.append(ClassPoints.joined(parts).thinned(config.voxel_m))
    return PointMaps(chain, frames, points, config)
