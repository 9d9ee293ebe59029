"""Where vehicles drive: directed centre lines of the lanes that a map format knows (room: maps; host).

In: the path of a map. Out: polylines in the frame of `read_map`; none for formats that know paint only: GeoJSON,
GeoPackage, the compact form.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from semloc_jax.geometry.polyline import arc_length
from semloc_jax.maps.curves import without_repeats
from semloc_jax.maps.elements import GeoOrigin
from semloc_jax.maps.io import apollo
from semloc_jax.maps.io.argoverse2 import find_archive, is_argoverse2, lane_bounds
from semloc_jax.maps.io.json_stream import JsonFile
from semloc_jax.maps.io.lanelet2 import lanelet_bounds
from semloc_jax.maps.io.ngii import is_ngii, link_lines
from semloc_jax.maps.io.nuscenes import is_nuscenes, lane_lines
from semloc_jax.maps.io.opendrive import driving_lane_bounds

_SPACING_M = 0.5
"""Places at which a line is put half-way between two bounds; they follow curves of 10 m radius to 3 mm."""

Bounds = tuple[np.ndarray, np.ndarray]
"""Left and right bound of a lane in its direction of travel, `[k 3]` and `[j 3]`."""


def read_lane_centers(path: str | Path, origin: GeoOrigin | None) -> list[np.ndarray]:
    """Returns the centre lines of all lanes for vehicles, each `float64[k 3]` in its direction of travel [m].

    Args:
        path: a map that `read_map` reads.
        origin: that of the map that `read_map` made of it.

    Raises:
        SemlocError: the file is broken.
    """
    path = Path(path)
    if path.is_dir():
        path = find_archive(path) or path
    between = (_center(*bounds) for bounds in _bounds(path, origin))
    return [center for center in (*between, *_drawn(path, origin)) if len(center) > 1]


def _bounds(path: Path, origin: GeoOrigin | None) -> Iterator[Bounds]:
    suffix = path.suffix.lower()
    if suffix in (".osm", ".xml"):
        yield from lanelet_bounds(path)
    elif suffix == ".xodr":
        yield from driving_lane_bounds(path, origin)
    elif suffix == ".json" and is_argoverse2(document := JsonFile(path)):
        yield from lane_bounds(document, path.name)
    elif suffix in apollo.SUFFIXES:
        yield from apollo.lane_bounds(path, origin)


def _drawn(path: Path, origin: GeoOrigin | None) -> Iterator[np.ndarray]:
    """Yields the centre lines of formats that hold them as lines."""
    if is_ngii(path):
        yield from link_lines(path, origin)
    elif path.suffix.lower() == ".json" and is_nuscenes(document := JsonFile(path)):
        yield from lane_lines(document, path.name)


def _center(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Returns the line half-way between two bounds: each step pairs equal shares of their lengths."""
    left, right = (without_repeats(np.asarray(side, dtype=np.float64)) for side in (left, right))
    if min(len(left), len(right)) < 2:
        return np.zeros((0, 3))
    along = [arc_length(side) for side in (left, right)]
    count = max(2, int(max(part[-1] for part in along) / _SPACING_M) + 1)
    share = np.linspace(0.0, 1.0, count)
    pair = [
        np.column_stack([np.interp(share * part[-1], part, side[:, axis]) for axis in range(3)])
        for part, side in zip(along, (left, right), strict=True)
    ]
    return without_repeats(0.5 * (pair[0] + pair[1]))
