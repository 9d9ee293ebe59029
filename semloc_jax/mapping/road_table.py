"""Which pixel of a camera shows each place on the road around the vehicle, and how finely (room: mapping; host).

In: a camera and its pose above the road. Out: RoadTable, and its places moved onto a road that is not a plane.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from semloc_jax.cameras import Camera

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
_SWAY_M = 8.0
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

    def on_road(self, heights: "RoadHeights") -> Float[np.ndarray, "n 2"]:
        """The places [m] moved along the line of sight to where it meets a road with these heights."""
        camera_xy, camera_z = self.camera_base[:2].astype(np.float32), np.float32(self.camera_base[2])
        moved = self.xy_base
        for _ in range(2):  # the second time with the height of the place that was found
            moved = self.xy_base + (heights.at(moved) / camera_z)[:, None] * (camera_xy - self.xy_base)
        return moved

    def rows_of(self, xy_base: Float[np.ndarray, "n 2"], heights: "RoadHeights") -> Int[np.ndarray, " n"]:
        """Row of the table that shows each place on a road with these heights, -1 for those not shown."""
        if not len(self.pixel):
            return np.full(len(xy_base), -1, np.int32)
        rise = heights.at(xy_base.astype(np.float32)) / self.camera_base[2]
        on_plane = self.camera_base[:2] + (xy_base - self.camera_base[:2]) / np.maximum(1.0 - rise, 0.1)[:, None]
        cell = np.rint((on_plane - self.low_m) / self.spacing_m).astype(np.int64)
        inside = ((cell >= 0) & (cell < self.row.shape[::-1])).all(axis=1)
        cell = np.where(inside[:, None], cell, 0)
        return np.where(inside, self.row[cell[:, 1], cell[:, 0]], -1)


@dataclass(frozen=True)
class RoadHeights:
    """Height of the road above the plane of the vehicle, from where it drives before and after.

    Attributes:
        ahead_m: `float64[k]` where wheels stand, along the base frame, ascending [m].
        left_m: `float64[k]` the same across it [m].
        height_m: `float64[k]` [m].
        bank: `float64[k]` slope across the way [m/m].
    """

    ahead_m: Float[np.ndarray, " k"]
    left_m: Float[np.ndarray, " k"]
    height_m: Float[np.ndarray, " k"]
    bank: Float[np.ndarray, " k"]

    @classmethod
    def of(cls, Ts_map_base: Float[np.ndarray, "n 4 4"], index: int, reach_m: float) -> "RoadHeights":
        """The road around one pose of a drive.

        Args:
            Ts_map_base: every pose of the drive.
            index: which one.
            reach_m: poses farther along the way do not count.
        """
        T = Ts_map_base[index]
        away_m = np.linalg.norm(Ts_map_base[:, :2, 3] - T[:2, 3], axis=1)
        first, last = index, index
        while first > 0 and away_m[first - 1] < reach_m and index - first < len(away_m):
            first -= 1
        while last < len(away_m) - 1 and away_m[last + 1] < reach_m:
            last += 1
        near = np.linalg.inv(T) @ Ts_map_base[first : last + 1]
        forward = near[:, 0, 0] > 0.5
        near = near[forward]
        order = np.argsort(near[:, 0, 3], kind="stable")
        near = near[order]
        keep = np.append(True, np.diff(near[:, 0, 3]) > 0.05)
        near = near[keep]
        # Past the last pose the road goes on as it lies there.
        slope = -near[[0, -1], 2, 0] / np.maximum(near[[0, -1], 0, 0], 0.5) * [1.0, -1.0]
        ends = near[[0, -1], 0, 3] + [-reach_m, reach_m]
        heights = np.concatenate(
            [[near[0, 2, 3] + slope[0] * reach_m], near[:, 2, 3], [near[-1, 2, 3] + slope[1] * reach_m]]
        )
        bank = _averaged(near[:, 2, 1] / np.maximum(near[:, 1, 1], 0.5), near[:, 0, 3])
        return cls(
            np.concatenate([ends[:1], near[:, 0, 3], ends[1:]]),
            np.concatenate([near[:1, 1, 3], near[:, 1, 3], near[-1:, 1, 3]]),
            heights,
            np.concatenate([bank[:1], bank, bank[-1:]]),
        )

    def at(self, xy_base: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Height of the road at places [m]."""
        start, step, values, slopes = self._table
        at = np.clip((xy_base[:, 0] - start) / step, 0, len(values[0]) - 1.001)
        row = at.astype(np.int32)
        share = at - row
        height_m, bank, left_m = (value[row] + share * slope[row] for value, slope in zip(values, slopes, strict=True))
        return height_m + bank * (xy_base[:, 1] - left_m)

    @cached_property
    def _table(self) -> tuple[np.float32, np.float32, np.ndarray, np.ndarray]:
        """First place and step along the way [m]; height, bank and side every step, and by how much they grow."""
        knots = np.linspace(self.ahead_m[0], self.ahead_m[-1], 257)
        columns = [np.interp(knots, self.ahead_m, values) for values in (self.height_m, self.bank, self.left_m)]
        return np.float32(knots[0]), np.float32(knots[1] - knots[0]), *_with_growth(np.stack(columns))


def _with_growth(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return rows.astype(np.float32), np.diff(rows, axis=1, append=rows[:, -1:]).astype(np.float32)


def _averaged(values: np.ndarray, at_m: np.ndarray) -> np.ndarray:
    """Values averaged over the way around each: a vehicle sways on its springs, the road below does not."""
    near = np.exp(-0.5 * ((at_m[:, None] - at_m) / _SWAY_M) ** 2)
    return near @ values / near.sum(axis=1)


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
