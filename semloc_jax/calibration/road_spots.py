"""Spots of the road that two pictures show, laid onto each other by their grey levels (room: calibration; host).

In: images, masks of what hides the road, mounts within a few centimetres. Out: Spots, lines of sight in pairs. Each
small patch finds its own shift by the brightness around it (Lucas and Kanade). That has no basin of a degree, so lines
go before.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.calibration.road_graph import Spots
from semloc_jax.calibration.road_rows import WORTH, Eye
from semloc_jax.cameras import Rig
from semloc_jax.datasets import Frame
from semloc_jax.datasets.base import IMAGE
from semloc_jax.geometry import rigid
from semloc_jax.geometry.polyline import arc_length
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.mapping.looking import hiding_ids
from semloc_jax.perception.ground_contact import SightErrors, ground_covariance

_CELL_M, _HALF_M = 0.02, 6.5
_REACH_M = 4.5
"""A place farther from its camera is smeared over the top view."""
_WINDOW_PX, _LEVELS = 21, 2
_MOST_SPOTS = 40
"""Of a pair of pictures, well spread."""
_APART_PX = 12
_BACK_PX = 0.5
"""A patch that is followed there and back returns within this."""
_FARTHEST_M = 0.15
"""Lines leave less than this."""
_ALIKE = 0.85
"""Correlation of two patches of one spot."""
_LATER_M = (0.0, 1.0, 2.5, 4.5)
"""Ways driven between two pictures."""
_ERRORS = SightErrors(pixel_px=0.5, pitch_deg=0.1, height_m=0.02)
_RIM_PX = 9


@dataclass(frozen=True)
class TopPicture:
    """What one camera shows of the road, over a grid of places.

    Attributes:
        grey: uint8[h w], local contrast even.
        usable: bool[h w], where it shows the road.
    """

    grey: UInt8[np.ndarray, "h w"]
    usable: Bool[np.ndarray, "h w"]


class SpotFinder:
    """Finds spots in the pictures of some frames."""

    def __init__(self, frames: Sequence[Frame], masks: MaskSource, rig: Rig):
        """Of the frames, with masks of what hides the road; the rig is that of the images."""
        self._frames, self._masks, self._rig = frames, masks, rig
        self._hides = hiding_ids(masks.table)
        self._pictures: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}

    def found(self, Ts_base_cam: Float[np.ndarray, "c 4 4"], Ts_odom_base: Float[np.ndarray, "n 4 4"]) -> Spots | None:
        """Spots of all pairs of pictures; None where the frames have no images, or these show none.

        Args:
            Ts_base_cam: mounts within a few centimetres.
            Ts_odom_base: poses of the frames.
        """
        names = self._rig.names
        if not all(frame.has(IMAGE, name) for frame in self._frames for name in names):
            return None
        eyes = [Eye(float(T[2, 3]), float(c.fx)) for c, T in zip(self._rig.cameras, Ts_base_cam, strict=True)]
        grid, rows = _grid(Ts_base_cam), []
        for first, later in _frames_apart(Ts_odom_base):
            # Pictures that are driven past are not needed again.
            self._pictures = {frame: own for frame, own in self._pictures.items() if frame >= first}
            T_first_later = rigid.inverse(Ts_odom_base[first]) @ Ts_odom_base[later]
            Ts = Ts_base_cam, T_first_later @ Ts_base_cam
            views = [
                [self._view(f, c, grid, T) for c, T in enumerate(own)]
                for f, own in zip((first, later), Ts, strict=True)
            ]
            for a, b in product(range(len(names)), repeat=2):
                if later == first and b <= a:
                    continue
                spots = _shifts(views[0][a], views[1][b])
                for one, other in spots:
                    p, q = (grid[0, 0] + _CELL_M * np.array([at[1], at[0], 0.0]) for at in (one, other))
                    T_a, T_b = Ts[0][a], Ts[1][b]
                    info = _sqrt_info(Ts_odom_base[first], (T_a, p, eyes[a]), (T_b, q, eyes[b]))
                    weight = min(1.0, WORTH / len(spots))
                    rows.append(((a, b), (first, later), (_ray(T_a, p), _ray(T_b, q)), info, weight))
        columns = list(zip(*rows, strict=True))
        return Spots(*(np.array(column) for column in columns)) if rows else None

    def _view(self, frame: int, camera: int, grid: Float[np.ndarray, "h w 3"], T_base_cam: np.ndarray) -> TopPicture:
        """What a camera shows of a grid of places of the road."""
        grey, hidden = self._picture(frame, camera)
        model = self._rig.cameras[camera]
        p_cam = ((grid - T_base_cam[:3, 3]) @ T_base_cam[:3, :3]).astype(np.float32)
        uv, valid = (np.asarray(part) for part in model.project(p_cam))
        near = np.linalg.norm(grid[..., :2] - T_base_cam[:2, 3], axis=-1) < _REACH_M
        shown = valid & near & np.asarray(model.in_image(uv[..., 0], uv[..., 1], 1.0))
        table = np.where(shown[..., None], uv, -10.0).astype(np.float32)
        top = cv2.remap(grey, table, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        covered = cv2.remap(hidden, table, None, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=1)
        rim = np.ones((2 * _RIM_PX + 1, 2 * _RIM_PX + 1), np.uint8)
        usable = cv2.erode(((covered == 0) & shown).astype(np.uint8), rim) > 0
        return TopPicture(_even(top, shown), usable)

    def _picture(self, frame: int, camera: int) -> tuple[np.ndarray, np.ndarray]:
        """Grey image of a camera, and what of it hides the road."""
        if frame not in self._pictures:
            own = self._frames[frame]
            hidden = [self._hides[np.asarray(mask)].astype(np.uint8) for mask in self._masks.masks(own)]
            images = [cv2.cvtColor(own.image(name), cv2.COLOR_BGR2GRAY) for name in self._rig.names]
            sizes = [image.shape[::-1] for image in images]
            hidden = [cv2.resize(h, s, interpolation=cv2.INTER_NEAREST) for h, s in zip(hidden, sizes, strict=True)]
            self._pictures[frame] = list(zip(images, hidden, strict=True))
        return self._pictures[frame][camera]


def _grid(Ts_base_cam: np.ndarray) -> Float[np.ndarray, "h w 3"]:
    """Places of the road around the cameras, x down the rows."""
    line = np.arange(-_HALF_M, _HALF_M, _CELL_M)
    x, y = np.meshgrid(line, line, indexing="ij")
    return np.stack([x, y, np.zeros_like(x)], axis=-1) + np.append(Ts_base_cam[:, :2, 3].mean(axis=0), 0.0)


def _even(top: np.ndarray, shown: np.ndarray) -> UInt8[np.ndarray, "h w"]:
    """The picture with the mean and the contrast around each place taken out: cameras and times differ in both."""
    weight = cv2.GaussianBlur(shown.astype(np.float32), (0, 0), 15) + 1e-3
    values = np.where(shown, top, 0).astype(np.float32)
    mean = cv2.GaussianBlur(values, (0, 0), 15) / weight
    off = np.where(shown, top - mean, 0.0).astype(np.float32)
    spread = np.sqrt(cv2.GaussianBlur(off * off, (0, 0), 15) / weight)
    return np.clip(128.0 + 40.0 * off / (spread + 4.0), 0, 255).astype(np.uint8)


def _frames_apart(Ts_odom_base: Float[np.ndarray, "n 4 4"]) -> Iterator[tuple[int, int]]:
    """Every second frame with itself, and with the frames that come some ways later."""
    way_m = arc_length(Ts_odom_base[:, :2, 3])
    for first in range(0, len(way_m), 2):
        later = {int(np.abs(way_m - way_m[first] - apart_m).argmin()) for apart_m in _LATER_M}
        yield from ((first, one) for one in sorted(later) if one >= first)


def _shifts(first: TopPicture, second: TopPicture) -> list[tuple[np.ndarray, np.ndarray]]:
    """Cells (column, row) of spots as the first picture and as the second has them."""
    both = first.usable & second.usable
    if both.sum() < 4 * _WINDOW_PX**2:
        return []
    corners = cv2.goodFeaturesToTrack(first.grey, _MOST_SPOTS, 0.05, _APART_PX, mask=both.astype(np.uint8))
    if corners is None:
        return []
    how = {"winSize": (_WINDOW_PX, _WINDOW_PX), "maxLevel": _LEVELS}
    there, is_there, _ = cv2.calcOpticalFlowPyrLK(first.grey, second.grey, corners, None, **how)
    back, is_back, _ = cv2.calcOpticalFlowPyrLK(second.grey, first.grey, there, None, **how)
    moved, returned = (np.linalg.norm(at - corners, axis=2)[:, 0] for at in (there, back))
    good = (is_there & is_back)[:, 0].astype(bool) & (returned < _BACK_PX) & (moved < _FARTHEST_M / _CELL_M)
    pairs = zip(corners[good, 0].astype(float), there[good, 0].astype(float), strict=True)
    return [(one, other) for one, other in pairs if _likeness(first.grey, second.grey, one, other) > _ALIKE]


def _likeness(first: np.ndarray, second: np.ndarray, one: np.ndarray, other: np.ndarray) -> float:
    """Correlation of the patches around two places."""
    size = (_WINDOW_PX, _WINDOW_PX)
    a, b = (
        cv2.getRectSubPix(g, size, tuple(map(float, at))).astype(float) for g, at in ((first, one), (second, other))
    )
    a, b = a - a.mean(), b - b.mean()
    return float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum() + 1e-9))


def _ray(T_base_cam: np.ndarray, p_base: np.ndarray) -> Float[np.ndarray, " 3"]:
    p_cam = T_base_cam[:3, :3].T @ (p_base - T_base_cam[:3, 3])
    return p_cam / np.linalg.norm(p_cam)


def _sqrt_info(T_odom_base: np.ndarray, *sights: tuple[np.ndarray, np.ndarray, Eye]) -> Float[np.ndarray, "2 2"]:
    """What whitens the difference in odom of a spot that is seen twice, in heights of the cameras.

    Args:
        T_odom_base: pose of the first sight, in whose base frame the spots are.
        sights: pose of the camera, the spot, what is known of the camera.
    """
    C = sum(ground_covariance(p[:2] - T[:2, 3], eye.height_m, eye.focal_px, _ERRORS) for T, p, eye in sights)
    R = T_odom_base[:2, :2]
    height_m = np.sqrt(np.prod([eye.height_m for *_, eye in sights]))
    return np.linalg.inv(np.linalg.cholesky(R @ C @ R.T)) * height_m
