"""Where an Apollo HD map lies on the earth (room: maps; host).

In: elements in the metres of the file and the PROJ text of its header. Out: the elements in an ENU frame.
Headers can be wrong: the first public maps name a grid about their own middle but hold UTM coordinates.
"""

import logging
import re

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.geometry.geodesy import enu_from_projected, utm_crs
from semloc_jax.maps.elements import GeoOrigin, MapElement

_log = logging.getLogger(__name__)
_NEAR_DEG = 2.0
"""A grid about a place is accepted if the middle of the coordinates lies within this distance of it; our choice."""


def placed(
    elements: list[MapElement], projection: str, origin: GeoOrigin | None, name: str
) -> tuple[list[MapElement], GeoOrigin | None, str]:
    """Returns the elements in the ENU frame of an origin, that origin, and the name of the frame.

    Args:
        elements: in the metres of the file.
        projection: PROJ text of the header, braces of templates allowed; empty where there is none.
        origin: place of the frame; None takes the middle of the elements.
        name: of the file, for messages.

    Raises:
        SemlocError: an origin is wanted and the grid is not known.
    """
    text = re.sub(r"[{}]", "", projection).strip()
    middle = _middle(elements) if elements else np.zeros(3)
    grid = _true_grid(text, middle, name) if text and elements else None
    if grid is None:
        if origin is not None:
            raise SemlocError(f"map {name}: its header names no grid that fits, so it cannot be placed at an origin")
        return elements, None, "metres of the file"
    crs, (lat, lon) = grid
    origin = origin or GeoOrigin(round(lat, 5), round(lon, 5), round(float(middle[2]), 1))
    heights = [e.has_height for e in elements]
    points = np.vstack([e.points for e in elements])
    bounds = np.cumsum([len(e.points) for e in elements])[:-1]
    # Points without a height get that of the origin, which becomes 0.
    lifted = np.repeat(np.where(heights, 0.0, origin.alt_m), [len(e.points) for e in elements])
    moved = enu_from_projected(points + np.column_stack([np.zeros((len(points), 2)), lifted]), crs, origin)
    flat = np.repeat(heights, [len(e.points) for e in elements])
    moved[:, 2] = np.where(flat, moved[:, 2], 0.0)
    parts = zip(elements, np.split(moved, bounds), strict=True)
    return [e.with_points(part) for e, part in parts], origin, f"ENU, from {crs}"


def _middle(elements: list[MapElement]) -> np.ndarray:
    points = np.vstack([e.points for e in elements])
    high = np.concatenate([e.points[:, 2] for e in elements if e.has_height] or [np.zeros(1)])
    return np.append(0.5 * (points.min(axis=0) + points.max(axis=0))[:2], np.median(high))


def _true_grid(text: str, middle: np.ndarray, name: str) -> tuple[str, tuple[float, float]] | None:
    """Returns the grid of a header, or the UTM grid of the place that it names, and the middle in degrees."""
    stated = re.search(r"\+lat_0=([-+.\deE]+).*?\+lon_0=([-+.\deE]+)", text)
    try:
        about = (float(stated.group(1)), float(stated.group(2))) if stated else None
    except ValueError:
        about = None
    candidates = [text] + ([utm_crs(*about)] if about and abs(about[0]) <= 84.0 and abs(about[1]) <= 180.0 else [])
    for crs in candidates:
        place = _degrees(crs, middle)
        if place is not None and (about is None or np.abs(np.subtract(place, about)).max() < _NEAR_DEG):
            if crs != text:
                _log.warning("map %s: its coordinates are not those of the grid in its header; taken as %s", name, crs)
            return crs, place
    _log.warning("map %s: its coordinates do not fit the grid in its header; kept in the metres of the file", name)
    return None


def _degrees(crs: str, point: np.ndarray) -> tuple[float, float] | None:
    import pyproj

    try:
        lon, lat = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(point[0], point[1])
    except pyproj.exceptions.ProjError:
        return None
    return (lat, lon) if np.isfinite([lat, lon]).all() and abs(lat) <= 90.0 else None
