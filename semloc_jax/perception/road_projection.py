"""Pixels on the plane of the road: by a calibration, or by four points that somebody clicked (room: perception; host).

In: a camera and its pose, or four pixels and their places. Out: RoadProjection: pixels to places in the base frame.
"""

import csv
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.cameras import Camera
from semloc_jax.errors import SemlocError
from semloc_jax.storage import reading

NUM_POINTS = 4
COLUMNS = ("camera", "u_px", "v_px", "x_m", "y_m")
_LEAST_TRIANGLE = 1e-3
"""Four points of which three span a triangle with a smaller share of the square of their extent lie on one line."""


@runtime_checkable
class RoadProjection(Protocol):
    """Pixels to places on the road."""

    def on_road(self, uv: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
        """Places in the base frame [m], and whether a pixel shows the road at all."""
        ...


@dataclass(frozen=True)
class CalibratedRoad:
    """The road as a calibration has it: the plane z = 0 of the base frame."""

    camera: Camera
    T_base_cam: Float[np.ndarray, "4 4"]

    @cached_property
    def _table(self) -> tuple[Float[np.ndarray, "h w 2"], Bool[np.ndarray, "h w"]]:
        """Place and validity of every pixel."""
        width, height = self.camera.resolution
        uv = np.stack(np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)), axis=-1)
        T = np.asarray(self.T_base_cam, np.float64)
        rays, valid = (np.asarray(part) for part in self.camera.unproject(uv))
        rays = rays.astype(np.float64) @ T[:3, :3].T
        falls = rays[..., 2] < -1e-6
        reach = T[2, 3] / np.where(falls, -rays[..., 2], 1.0)
        return T[:2, 3] + reach[..., None] * rays[..., :2], valid & falls

    def on_road(self, uv: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
        """See `RoadProjection`; pixels are taken whole, as contours run."""
        (u, v), (xy, valid) = np.rint(uv).astype(np.int64).T, self._table
        return xy[v, u], valid[v, u]


@dataclass(frozen=True)
class FourPointRoad:
    """The road by a homography of four points: of a camera without distortion, nothing else need be known."""

    H_road_image: Float[np.ndarray, "3 3"]

    @classmethod
    def of(cls, uv: Float[np.ndarray, "4 2"], xy_base: Float[np.ndarray, "4 2"]) -> "FourPointRoad":
        """The homography of four points.

        Args:
            uv: pixels.
            xy_base: their places on the road, x forward and y left of the rear axle [m].

        Raises:
            SemlocError: three of the points lie on one line, or something is not finite.
        """
        uv, xy = np.asarray(uv, np.float64), np.asarray(xy_base, np.float64)
        if uv.shape != (NUM_POINTS, 2) or xy.shape != (NUM_POINTS, 2) or not np.isfinite([uv, xy]).all():
            raise SemlocError(f"top view: points of shape {uv.shape} and {xy.shape}; expected four finite pairs each")
        if min(_smallest_triangle(uv), _smallest_triangle(xy)) < _LEAST_TRIANGLE:
            raise SemlocError("top view: three of the four points lie on one line; click the corners of a rectangle")
        H = cv2.getPerspectiveTransform(uv.astype(np.float32), xy.astype(np.float32))
        # The sign of the scale tells the road before the camera from its mirror image behind it.
        scale = (H @ np.append(uv.mean(axis=0), 1.0))[2]
        return cls(H / scale)

    def on_road(self, uv: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
        """See `RoadProjection`."""
        p = np.column_stack([uv, np.ones(len(uv))]) @ self.H_road_image.T
        before = p[:, 2] > 1e-6
        return p[:, :2] / np.where(before, p[:, 2], 1.0)[:, None], before


def _smallest_triangle(points: np.ndarray) -> float:
    size = np.ptp(points, axis=0).max() ** 2
    rows = [[j for j in range(NUM_POINTS) if j != k] for k in range(NUM_POINTS)]
    sides = np.array([points[row][1:] - points[row][0] for row in rows])
    return float(np.abs(np.linalg.det(sides)).min() / max(size, 1e-12))


def read_four_points(path: Path) -> dict[str, FourPointRoad]:
    """The homography of each camera in a csv file with the columns camera, u_px, v_px, x_m, y_m and four rows for each.

    Raises:
        SemlocError: the file is missing, has other columns, or not four good points for a camera.
    """
    where = f"points {path}"
    if not path.is_file():
        raise SemlocError(f"{where}: no such file; expected a csv file with the columns {', '.join(COLUMNS)}")
    rows: dict[str, list[list[float]]] = {}
    with reading(where), path.open(newline="", encoding="utf-8") as file:
        table = csv.DictReader(file)
        if set(table.fieldnames or ()) != set(COLUMNS):
            raise SemlocError(f"{where}: columns {table.fieldnames}; expected {', '.join(COLUMNS)}")
        for row in table:
            rows.setdefault(str(row["camera"]), []).append([float(row[name]) for name in COLUMNS[1:]])
    found = {}
    for camera, points in rows.items():
        if len(points) != NUM_POINTS:
            raise SemlocError(f"{where}: {len(points)} points of camera {camera}; expected four")
        try:
            found[camera] = FourPointRoad.of(np.array(points)[:, :2], np.array(points)[:, 2:])
        except SemlocError as error:
            raise SemlocError(f"{where}: camera {camera}: {error}") from error
    return found
