"""Which pixel of a camera shows each place on the road around the vehicle, and how finely (room: mapping; host).

In: a camera and its pose above the road. Out: RoadTable, and its places moved onto a road that is not a plane.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from semloc_jax.cameras import Camera
from semloc_jax.mapping.road_heights import RoadHeights

COARSEST_PX_PER_M = 4.0
"""Where a metre of road is fewer pixels in the coarser direction, a mask says little about paint; our choice."""
_LEAST_PX_PER_M = 1.5
"""The same where a drive shows no place finely often enough; lines across the view are not to be told any more."""
_LOOKS = 4
"""Frames that shall show a place as the vehicle drives towards it: those that must, and one in which it is hidden."""
FINE_PX_PER_M = 25.0
"""Where one pixel covers 4 cm or less, finer views count no more: several looks say more than the nearest one alone."""
_DELTA_M = 0.01
_MOST_PX_PER_M = 1e5
_COARSE_M = 0.4
"""Spacing at which it is looked for what a camera shows at all."""


@dataclass(frozen=True)
class RoadTable:
    """Places on the plane z = 0 of the base frame that a camera shows well.

    Attributes:
        xy_base: `float32[n 2]` [m].
        pixel: `int32[n]`, place in the flattened mask.
        coarse_px_per_m: `float32[n]`, pixels for a metre of road in the coarser direction, away from the camera.
        fine_px_per_m: `float32[n]`, the same in the finer direction, to the side.
        row: `int32[h w]`, place in the arrays above of each cell of a grid, -1 where the camera shows nothing.
        low_m: `float64[2]`, x and y of the first cell of that grid.
        spacing_m: side of its cells.
        camera_base: `float64[3]`, place of the camera [m].
    """

    xy_base: Float[np.ndarray, "n 2"]
    pixel: Int[np.ndarray, " n"]
    coarse_px_per_m: Float[np.ndarray, " n"]
    fine_px_per_m: Float[np.ndarray, " n"]
    row: Int[np.ndarray, "h w"]
    low_m: Float[np.ndarray, " 2"]
    spacing_m: float
    camera_base: Float[np.ndarray, " 3"]

    @classmethod
    def of(
        cls,
        camera: Camera,
        T_base_cam: Float[np.ndarray, "4 4"],
        range_m: float,
        spacing_m: float,
        step_m: float = 0.0,
    ) -> "RoadTable":
        """The table of a camera.

        Args:
            camera: the camera of the masks.
            T_base_cam: its pose; z of the base frame is 0 on the road.
            range_m: reach on the road around the base frame.
            spacing_m: distance of neighbouring places.
            step_m: way from frame to frame: a vehicle that passes fast what a small image shows near it looks farther.
        """
        T_base_cam = np.asarray(T_base_cam, dtype=np.float64)
        coarsest = _coarsest_px_per_m(camera, T_base_cam, range_m, step_m)
        line = np.arange(-range_m, range_m, spacing_m)
        skipped = max(round(_COARSE_M / spacing_m), 1)
        coarse = np.stack(np.meshgrid(line[::skipped], line[::skipped]), axis=-1).reshape(-1, 2)
        near = coarse[_shown(camera, T_base_cam, coarse, coarsest)[1]]
        low, high = (near.min(axis=0), near.max(axis=0)) if len(near) else (np.zeros(2), np.zeros(2))
        axes = [np.arange(low[k] - _COARSE_M, high[k] + _COARSE_M, spacing_m) for k in (0, 1)]
        xy = np.stack(np.meshgrid(*axes), axis=-1)
        uv, shown, scales = _shown(camera, T_base_cam, xy.reshape(-1, 2), coarsest)
        row = np.where(shown, np.cumsum(shown) - 1, -1).astype(np.int32).reshape(xy.shape[:2])
        width, _ = camera.resolution
        pixel = np.rint(uv[shown, 1]).astype(np.int32) * width + np.rint(uv[shown, 0]).astype(np.int32)
        xy = xy.reshape(-1, 2)[shown].astype(np.float32)
        coarse_scale, fine_scale = scales[:, shown].astype(np.float32)
        low_m = np.array([axes[0][0], axes[1][0]])
        return cls(xy, pixel, coarse_scale, fine_scale, row, low_m, spacing_m, T_base_cam[:3, 3])

    @cached_property
    def weight(self) -> Float[np.ndarray, " n"]:
        """How much a look counts: the square of the coarser scale, 1 at FINE_PX_PER_M."""
        return np.minimum(self.coarse_px_per_m / np.float32(FINE_PX_PER_M), np.float32(1.0)) ** 2

    def on_road(self, heights: RoadHeights) -> Float[np.ndarray, "n 2"]:
        """The places [m] moved along the line of sight to where it meets a road with these heights."""
        camera_xy, camera_z = self.camera_base[:2].astype(np.float32), np.float32(self.camera_base[2])
        moved = self.xy_base
        for _ in range(2):  # the second time with the height of the place that was found
            moved = self.xy_base + (heights.at(moved) / camera_z)[:, None] * (camera_xy - self.xy_base)
        return moved

    def rows_of(self, xy_base: Float[np.ndarray, "n 2"], heights: RoadHeights) -> Int[np.ndarray, " n"]:
        """Row of the table that shows each place on a road with these heights, -1 for those not shown."""
        if not len(self.pixel):
            return np.full(len(xy_base), -1, np.int32)
        rise = heights.at(xy_base.astype(np.float32)) / self.camera_base[2]
        on_plane = self.camera_base[:2] + (xy_base - self.camera_base[:2]) / np.maximum(1.0 - rise, 0.1)[:, None]
        cell = np.rint((on_plane - self.low_m) / self.spacing_m).astype(np.int64)
        inside = ((cell >= 0) & (cell < self.row.shape[::-1])).all(axis=1)
        cell = np.where(inside[:, None], cell, 0)
        return np.where(inside, self.row[cell[:, 1], cell[:, 0]], -1)


def _coarsest_px_per_m(camera: Camera, T_base_cam: np.ndarray, range_m: float, step_m: float) -> float:
    """How coarsely a place may be shown, so that enough frames show each place on the way of the vehicle."""
    way_m = np.arange(0.0, range_m, _COARSE_M)
    _, seen, scales = _shown(camera, T_base_cam, np.column_stack([way_m, np.zeros(len(way_m))]), 0.0)
    if not seen.any():  # a camera to the side or to the back: what it shows is near
        return COARSEST_PX_PER_M
    needed = seen & (way_m <= way_m[seen][0] + _LOOKS * step_m)
    return float(np.clip(scales[0, needed].min(), _LEAST_PX_PER_M, COARSEST_PX_PER_M))


def _shown(
    camera: Camera, T_base_cam: np.ndarray, xy: np.ndarray, coarsest_px_per_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels of places on the plane, whether they are shown finely enough, and pixels per metre, coarse and fine."""
    ahead = _pixels(camera, T_base_cam, xy + [_DELTA_M, 0.0])[0]
    aside = _pixels(camera, T_base_cam, xy + [0.0, _DELTA_M])[0]
    uv, seen = _pixels(camera, T_base_cam, xy)
    a, b = (np.clip((moved - uv) / _DELTA_M, -_MOST_PX_PER_M, _MOST_PX_PER_M) for moved in (ahead, aside))
    trace = (a * a).sum(axis=1) + (b * b).sum(axis=1)
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    spread = np.sqrt(np.maximum(trace**2 - 4.0 * area**2, 0.0))
    scales = np.sqrt(np.maximum(0.5 * np.stack([trace - spread, trace + spread]), 0.0))
    return uv, seen & (scales[0] >= coarsest_px_per_m), scales


def _pixels(camera: Camera, T_base_cam: np.ndarray, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    p_base = np.column_stack([xy, np.zeros(len(xy))])
    uv, valid = (np.asarray(part) for part in camera.project((p_base - T_base_cam[:3, 3]) @ T_base_cam[:3, :3]))
    return uv, valid & np.asarray(camera.in_image(uv[:, 0], uv[:, 1], 0.5))
