"""What masks show of poles, pillars, signs and traffic lights: directions in which they stand (room: mapping; host).

In: masks, their cameras, poses. Out: Sightings: for each thing in each image its bearing, elevations and width.
A pole is upright, so that all its pixels lie in one vertical plane through the camera, whatever the lens.
"""

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.cameras import Camera
from semloc_jax.errors import SemlocError
from semloc_jax.perception import ClassTable
from semloc_jax.storage import npz_arrays, write_npz
from semloc_jax.structs import ElementClass

UPRIGHT = (ElementClass.POLE, ElementClass.SIGN, ElementClass.TRAFFIC_LIGHT, ElementClass.PILLAR)
_MAY_BE_CUT = (ElementClass.POLE, ElementClass.PILLAR)
"""What is told by a part of it."""
COLUMNS = (
    "label",
    "frame",
    "x_m",
    "y_m",
    "z_m",
    "bearing",
    "sigma",
    "low",
    "high",
    "width",
    "fill",
    "is_foot",
    "is_top",
)
"""Class; frame; place of the camera in the map [m]; bearing, its standard deviation, lowest and highest elevation and
width [rad]; share of its box that it fills; whether its low and its high end were seen."""
_BIN_RAD = np.deg2rad(0.3)
_RIM_PX = 2
_POLE_PX = (2, 4, 8, 16)
"""Widths of poles that stand before the board which they carry; ours."""
_ONE_SIDE = 0.6
"""Share of the heights of a pillar at which it must be as wide as at most."""


@dataclass(frozen=True)
class SightConfig:
    """What a mask must show of something upright. All values are ours.

    Args:
        min_px: pixels of one.
        min_height_deg: a lower piece of a pole has no direction.
        slender: a pole is so many times higher than wide.
        border_px: standard deviation of its middle in a mask.
        heading_deg: error of the heading of a pose that neighbours do not share.
    """

    min_px: int = 12
    min_height_deg: float = 1.5
    slender: float = 3.0
    border_px: float = 0.7
    heading_deg: float = 0.1


@dataclass(frozen=True)
class RayTable:
    """The directions of the pixels of one camera.

    Attributes:
        rays_base: unit `float32[h w 3]` in the base frame; zero where the camera shows nothing.
        camera_base: `float64[3]` its place [m].
        px_rad: angle of a pixel in the middle of the image.
        camera: the camera of the masks.
        T_base_cam: its pose.
    """

    rays_base: Float[np.ndarray, "h w 3"]
    camera_base: Float[np.ndarray, " 3"]
    px_rad: float
    camera: Camera
    T_base_cam: Float[np.ndarray, "4 4"]

    @classmethod
    def of(cls, camera: Camera, T_base_cam: Float[np.ndarray, "4 4"]) -> "RayTable":
        """The table of a camera."""
        width, height = camera.resolution
        uv = np.stack(np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)), axis=-1)
        rays, valid = (np.asarray(part) for part in camera.unproject(uv))
        rays = rays / np.maximum(np.linalg.norm(rays, axis=-1, keepdims=True), 1e-12)
        T_base_cam = np.asarray(T_base_cam, dtype=np.float64)
        rays = np.where(valid[..., None], rays @ T_base_cam[:3, :3].T, 0.0).astype(np.float32)
        middle = rays[height // 2, width // 2 : width // 2 + 2]
        px_rad = float(np.arccos(np.clip(middle[0] @ middle[1], -1.0, 1.0)))
        return cls(rays, T_base_cam[:3, 3], max(px_rad, 1e-5), camera, T_base_cam)


@dataclass
class Sightings:
    """Sightings of a drive, a row for each.

    Attributes:
        table: of the masks.
        config: what counts.
        rows: `float64[n 13]`, see COLUMNS, part by part.
    """

    table: ClassTable
    config: SightConfig = field(default_factory=SightConfig)
    rows: list[Float[np.ndarray, "n 13"]] = field(default_factory=list)
    _new: list[Float[np.ndarray, "n 13"]] = field(default_factory=list)

    def add(
        self, mask: UInt8[np.ndarray, "h w"], table: RayTable, frame: int, T_map_base: Float[np.ndarray, "4 4"]
    ) -> None:
        """Adds what one mask shows.

        Args:
            mask: class ids.
            table: of its camera.
            frame: index of the pose.
            T_map_base: the pose.
        """
        ids = {label: self._ids(label) for label in UPRIGHT if self.table.channel_of(label) >= 0}
        for label, own in ids.items():
            blocks = self._unusable
            if label in _MAY_BE_CUT:
                # A sign on a pole cuts it in two.
                blocks = np.any([blocks, *(other for key, other in ids.items() if key != label)], axis=0)
            shows = own[mask]
            if label == ElementClass.SIGN and ElementClass.POLE in ids:
                shows = _behind_pole(shows, ids[ElementClass.POLE][mask])
            found = _things(shows, blocks[mask], table, T_map_base, label, self.config)
            if len(found):
                place = T_map_base[:3, :3] @ table.camera_base + T_map_base[:3, 3]
                head = np.broadcast_to([float(label), float(frame), *place], (len(found), 5))
                self._new.append(np.column_stack([head, found]))

    @property
    def _unusable(self) -> Bool[np.ndarray, " 256"]:
        return np.isin(np.arange(256), self.table.unusable_ids)

    def _ids(self, label: ElementClass) -> Bool[np.ndarray, " 256"]:
        return np.isin(np.arange(256), self.table.channels[self.table.channel_of(label)].mask_ids)

    def all(self) -> Float[np.ndarray, "n 13"]:
        """Every row so far."""
        return np.concatenate([np.zeros((0, len(COLUMNS))), *self.rows, *self._new])

    def store(self, path: Path) -> None:
        """Writes what was added since the last part and takes it out; `attach` takes it in."""
        write_npz(path, {"rows": np.concatenate([np.zeros((0, len(COLUMNS))), *self._new])})
        self._new = []

    def attach(self, path: Path) -> None:
        """Takes a part in that `store` wrote.

        Raises:
            SemlocError: it is none.
        """
        rows = npz_arrays(path, f"part of a map {path}").get("rows", np.zeros(0))
        if rows.ndim != 2 or rows.shape[1] != len(COLUMNS) or rows.dtype != np.float64:
            raise SemlocError(f"part of a map {path}: holds no sightings; begin anew with another --out")
        self.rows.append(rows)


def column(sightings: Float[np.ndarray, "n 13"], name: str) -> Float[np.ndarray, " n"]:
    """One column of sightings by its name."""
    return sightings[:, COLUMNS.index(name)]


def _things(
    shows: Bool[np.ndarray, "h w"],
    unusable: Bool[np.ndarray, "h w"],
    table: RayTable,
    T_map_base: np.ndarray,
    label: ElementClass,
    config: SightConfig,
) -> Float[np.ndarray, "k 8"]:
    """Bearing, sigma, low, high, width, fill, is_foot and is_top of every patch of one class."""
    if not shows.any():
        return np.zeros((0, 8))
    num, labels, stats, _ = cv2.connectedComponentsWithStats(shows.astype(np.uint8), connectivity=8)
    found = []
    for index in range(1, num):
        x, y, width, height, area = (int(v) for v in stats[index])
        if area < config.min_px:
            continue
        box = slice(y, y + height), slice(x, x + width)
        own = labels[box] == index
        ends = _ends(own, (x, y), shows.shape, unusable)
        if label == ElementClass.PILLAR:
            own = _uncut(own, (x, y), unusable)
            if np.count_nonzero(own) < config.min_px:
                continue
        rays = table.rays_base[box][own] @ T_map_base[:3, :3].T.astype(np.float32)
        if not rays.any(axis=1).all():
            continue
        row = _ROWS[label](rays, table, config)
        if row is not None and (label in _MAY_BE_CUT or all(ends)):
            found.append([*row, *ends])
    return np.array(found).reshape(-1, 8)


def _behind_pole(shows: np.ndarray, is_pole: np.ndarray) -> np.ndarray:
    """A board with what its pole hides of it: seen from behind it is cut in two, and neither half is a board.

    A pole that is no wider than either half beside it stands before the board; a wider one is the end of two boards.
    """
    whole = shows.copy()
    columns = np.flatnonzero(shows.any(axis=0))
    if len(columns) < 2:
        return whole
    box = slice(columns[0], columns[-1] + 1)
    board, pole = shows[:, box].astype(np.uint8), is_pole[:, box]
    for width_px in _POLE_PX:
        wide = cv2.morphologyEx(board, cv2.MORPH_OPEN, np.ones((1, width_px), np.uint8))
        closed = cv2.morphologyEx(wide, cv2.MORPH_CLOSE, np.ones((1, width_px + 1), np.uint8))
        whole[:, box] |= (closed > 0) & pole
    return whole


def _ends(own: np.ndarray, corner: tuple[int, int], shape: tuple, unusable: np.ndarray) -> tuple[bool, bool]:
    """Whether the lowest and highest pixels of a patch are its ends: not cut by the image or something before it."""
    x, y = corner
    ends = []
    for row in (own.shape[0] - 1, 0):
        column = int(np.flatnonzero(own[row]).mean()) + x
        beyond = y + row + (_RIM_PX if row else -_RIM_PX)
        inside = _RIM_PX <= column < shape[1] - _RIM_PX and 0 <= beyond < shape[0]
        ends.append(bool(inside and not unusable[beyond, column]))
    return ends[0], ends[1]


def _uncut(own: np.ndarray, corner: tuple[int, int], unusable: np.ndarray) -> np.ndarray:
    """The rows of a patch whose first and last pixels are its sides: nothing beside them can stand before it."""
    left = own.argmax(axis=1) + corner[0] - _RIM_PX
    right = own.shape[1] - 1 - own[:, ::-1].argmax(axis=1) + corner[0] + _RIM_PX
    rows, last = corner[1] + np.arange(len(own)), unusable.shape[1] - 1
    is_inside = (left >= 0) & (right <= last)
    is_cut = unusable[rows, np.maximum(left, 0)] | unusable[rows, np.minimum(right, last)]
    return own & (is_inside & ~is_cut)[:, None]


def _angles(rays: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Bearings about their middle, elevations, and that middle [rad]."""
    middle = float(np.arctan2(*rays[:, 1::-1].mean(axis=0)))
    c, s = np.cos(middle), np.sin(middle)
    off = np.arctan2(c * rays[:, 1] - s * rays[:, 0], c * rays[:, 0] + s * rays[:, 1])
    return off, np.arctan2(rays[:, 2], np.hypot(rays[:, 0], rays[:, 1])), middle


def _pole(rays: np.ndarray, table: RayTable, config: SightConfig) -> tuple[float, ...] | None:
    """The shaft: what is wider at some height, an arm or a lamp, does not move its middle."""
    off, elevation, middle = _angles(rays)
    low, high = float(elevation.min()), float(elevation.max())
    if high - low < np.deg2rad(config.min_height_deg):
        return None
    bins = ((elevation - low) / _BIN_RAD).astype(int)
    count = np.bincount(bins)
    mean = np.bincount(bins, off) / np.maximum(count, 1)
    variance = np.maximum(np.bincount(bins, off**2) / np.maximum(count, 1) - mean**2, 0.0)
    # Pixels in a row of width w have the variance (w^2 - 1) / 12.
    wide = np.sqrt(12.0 * variance + table.px_rad**2)
    typical = float(np.median(wide[count > 0]))
    shaft = (count > 0) & (wide <= 1.5 * typical + table.px_rad)
    axis = float(np.median(mean[shaft]))
    # A thing whose slices do not lie above each other is no upright pole.
    straight = np.abs(mean[shaft] - axis) <= 0.5 * typical + 2.0 * table.px_rad
    if high - low < config.slender * typical or straight.mean() < 0.7:
        return None
    sigma = np.hypot(config.border_px * table.px_rad, np.deg2rad(config.heading_deg))
    return middle + axis, float(sigma), low, high, typical, 1.0


def _board(rays: np.ndarray, table: RayTable, config: SightConfig) -> tuple[float, ...]:
    """A board or a box: its middle and its size."""
    off, elevation, middle = _angles(rays)
    low, high = float(elevation.min()) - 0.5 * table.px_rad, float(elevation.max()) + 0.5 * table.px_rad
    left, right = float(off.min()) - 0.5 * table.px_rad, float(off.max()) + 0.5 * table.px_rad
    fill = len(rays) * table.px_rad**2 / max((high - low) * (right - left), 1e-12)
    sigma = np.hypot(config.border_px * table.px_rad, np.deg2rad(config.heading_deg))
    return middle + 0.5 * (left + right), float(sigma), low, high, right - left, min(float(fill), 1.0)


def _pillar(rays: np.ndarray, table: RayTable, config: SightConfig) -> tuple[float, ...] | None:
    """A box: the bearings of its two sides, which are as straight as those of a pole."""
    off, elevation, middle = _angles(rays)
    low, high = float(elevation.min()), float(elevation.max())
    if high - low < np.deg2rad(config.min_height_deg):
        return None
    bins = ((elevation - low) / _BIN_RAD).astype(int)
    left, right = np.full(bins.max() + 1, -np.inf), np.full(bins.max() + 1, np.inf)
    np.maximum.at(left, bins, off)
    np.minimum.at(right, bins, off)
    left, right = left[np.isfinite(left)], right[np.isfinite(right)]
    edges = float(np.median(left)), float(np.median(right))
    # Something before it, or another one behind it, makes it narrower or wider at some heights.
    off_rad = np.maximum(np.abs(left - edges[0]), np.abs(right - edges[1]))
    share = float((off_rad <= 2.0 * table.px_rad).mean())
    if share < _ONE_SIDE:
        return None
    sigma = np.hypot(config.border_px * table.px_rad, np.deg2rad(config.heading_deg))
    width = edges[0] - edges[1] + table.px_rad
    return middle + 0.5 * (edges[0] + edges[1]), float(sigma), low, high, width, share


_ROWS = {
    ElementClass.POLE: _pole,
    ElementClass.SIGN: _board,
    ElementClass.TRAFFIC_LIGHT: _board,
    ElementClass.PILLAR: _pillar,
}
