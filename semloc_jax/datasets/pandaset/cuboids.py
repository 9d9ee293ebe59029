"""Annotated boxes of PandaSet: read without pandas, drawn as masks (room: datasets; host).

In: annotations/cuboids/NN.pkl.gz. Out: Cuboids, bool masks of what may move.
"""

import io
import pickle
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.cameras import Camera
from semloc_jax.datasets.pandaset.projection import project
from semloc_jax.errors import SemlocError
from semloc_jax.storage import FARTHEST_M, decompressed

MOVABLE = (
    "Car",
    "Pickup Truck",
    "Medium-sized Truck",
    "Semi-truck",
    "Towed Object",
    "Motorcycle",
    "Other Vehicle",
    "Bus",
    "Bicycle",
    "Motorized Scooter",
    "Personal Mobility Device",
    "Pedestrian",
    "Train",
    "Tram",
    "Animals",
)
"""How the labels of things that may move begin, parked ones included: they hide the road and belong to no map."""

_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
_NEAR_M = 0.5
_MOST_BYTES = 64 << 20
"""Of an unpacked table; one of a hundred boxes has 20 kB."""


@dataclass(frozen=True)
class Cuboids:
    """Boxes of one sweep in the map frame.

    Args:
        label: kind of each box.
        center: centres [m].
        size_m: extent along the box's own x, y, z [m].
        yaw_rad: turn about z.
    """

    label: tuple[str, ...]
    center: Float[np.ndarray, "n 3"]
    size_m: Float[np.ndarray, "n 3"]
    yaw_rad: Float[np.ndarray, " n"]

    def movable(self) -> "Cuboids":
        """The boxes that may move."""
        keep = np.array([label.startswith(MOVABLE) for label in self.label], dtype=bool)
        labels = tuple(label for label, kept in zip(self.label, keep, strict=True) if kept)
        return Cuboids(labels, self.center[keep], self.size_m[keep], self.yaw_rad[keep])

    def corners(self) -> Float[np.ndarray, "n 8 3"]:
        """Corners in the map frame [m]."""
        local = _CORNERS * self.size_m[:, None]
        cos, sin = np.cos(self.yaw_rad)[:, None], np.sin(self.yaw_rad)[:, None]
        turned = [cos * local[..., 0] - sin * local[..., 1], sin * local[..., 0] + cos * local[..., 1], local[..., 2]]
        return self.center[:, None] + np.stack(turned, axis=-1)


def read_cuboids(path: Path) -> Cuboids:
    """Boxes of one file.

    Raises:
        SemlocError: the file is missing or is not such a table.
    """
    try:
        table = _read_table(path)
        column = [[float(v) for v in table[name]] for name in _NUMBERS]
        labels = tuple(str(label) for label in table["label"])
    except SemlocError:
        raise
    except Exception as error:  # a damaged pickle stumbles over anything
        raise SemlocError(
            f"cuboids {path}: cannot be read ({error}); expected annotations/cuboids of PandaSet"
        ) from error
    numbers = np.array(column).T.reshape(-1, len(_NUMBERS))
    if not (np.abs(numbers) < FARTHEST_M).all():
        raise SemlocError(
            f"cuboids {path}: a box has a place, size or heading that is NaN, infinite or beyond the earth; expected "
            "metres and radians; get the file again"
        )
    return Cuboids(labels, numbers[:, :3], numbers[:, 3:6], numbers[:, 6])


def draw_cuboids(cuboids: Cuboids, camera: Camera, T_cam_map: Float[np.ndarray, "4 4"]) -> Bool[np.ndarray, "h w"]:
    """True where the image shows one of the boxes; each face is clipped in front of the camera and filled."""
    width, height = camera.resolution
    mask = np.zeros((height, width), dtype=np.uint8)
    p_cam = cuboids.corners() @ T_cam_map[:3, :3].T + T_cam_map[:3, 3]
    faces = [corners[list(face)] for corners in p_cam if corners[:, 2].max() >= _NEAR_M for face in _FACES]
    outlines = [outline for face in faces if len(outline := _clip_near(face)) >= 3]
    if not outlines:
        return mask > 0
    points = np.vstack(outlines)
    # Far outside the image whole numbers would overflow in OpenCV.
    uv = np.clip(project(camera, points), -10_000.0, 10_000.0)
    ends = np.cumsum([len(outline) for outline in outlines])[:-1]
    for outline in np.split(np.round(uv * 16.0).astype(np.int32), ends):
        cv2.fillConvexPoly(mask, outline, 1, shift=4)
    return mask > 0


def _clip_near(outline: np.ndarray) -> np.ndarray:
    """The part of a convex outline [k 3] of the camera frame in front of the near plane."""
    kept = []
    for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        if start[2] >= _NEAR_M:
            kept.append(start)
        if (start[2] >= _NEAR_M) != (end[2] >= _NEAR_M):
            share = (_NEAR_M - start[2]) / (end[2] - start[2])
            kept.append(start + share * (end - start))
    return np.array(kept).reshape(-1, 3)


_NUMBERS = (
    "position.x",
    "position.y",
    "position.z",
    "dimensions.x",
    "dimensions.y",
    "dimensions.z",
    "yaw",
)


class _Part:
    """Replaces a pandas class: keeps what the pickle passes to it."""

    def __init__(self, *arguments: object):
        self.arguments = arguments
        self.state: object = None

    def __setstate__(self, state: object) -> None:
        self.state = state


def _new_index(_: type, content: Mapping[str, object]) -> _Part:
    return _Part(content)


class _TableUnpickler(pickle._Unpickler):
    """Reads the tables of PandaSet and nothing else: a pickle may name any function, this one may not call it.

    It is that of pickle in Python: the one in C takes gigabytes for a damaged place in its list of things seen.
    """

    _ALLOWED = frozenset(
        {
            ("pandas.core.frame", "DataFrame"),
            ("pandas.core.internals.managers", "BlockManager"),
            ("pandas.core.indexes.base", "Index"),
            ("pandas.core.indexes.range", "RangeIndex"),
        }
    )

    def find_class(self, module: str, name: str) -> object:
        if (module, name) in self._ALLOWED:
            return _Part
        if (module, name) == ("pandas.core.indexes.base", "_new_Index"):
            return _new_index
        if module in ("numpy.core.multiarray", "numpy._core.multiarray") and name in ("_reconstruct", "scalar"):
            return super().find_class("numpy._core.multiarray", name)
        if (module, name) in (("numpy", "ndarray"), ("numpy", "dtype"), ("builtins", "slice")):
            return super().find_class(module, name)
        raise pickle.UnpicklingError(f"{module}.{name} is not part of a table of boxes")


def _read_table(path: Path) -> dict[str, np.ndarray]:
    """Columns of a pickled pandas table: blocks of one type each, with the columns they hold."""
    frame = _TableUnpickler(io.BytesIO(decompressed(path.read_bytes(), f"cuboids {path}", _MOST_BYTES))).load()
    manager = frame.state["_data"] if "_data" in frame.state else frame.state["_mgr"]
    content = manager.state[3]["0.14.1"]
    names = [str(name) for name in content["axes"][0].arguments[0]["data"]]
    columns = {}
    for block in content["blocks"]:
        placed = block["mgr_locs"]
        index = np.arange(placed.start, placed.stop, placed.step or 1) if isinstance(placed, slice) else placed
        for row, column in zip(block["values"], index, strict=True):
            columns[names[int(column)]] = row
    return columns
