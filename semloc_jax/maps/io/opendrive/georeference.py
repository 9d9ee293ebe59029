"""Where on the earth an OpenDRIVE file lies: <geoReference> and <offset> (room: maps; host).

In: the <header>. Out: Georeference, which maps the file's metres to the ENU frame of an origin where that is possible.
"""

import logging
import re
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.geometry.geodesy import enu_from_projected
from semloc_jax.maps.elements import GeoOrigin
from semloc_jax.maps.io.xml_stream import numbers

_log = logging.getLogger(__name__)
_TRUE_SCALE = 2e-3
"""A grid scale farther from one than this means a reference that is not true (UTM stays below 1e-3)."""
_LONGEST_TEXT = 4096
_PROJ_WORD = re.compile(r"\+[a-z_0-9]+(=[^\s/\\+]*)?", re.IGNORECASE)
_VERTICAL = re.compile(r"\+(geoidgrids|vunits|nadgrids)=\S+\s*")


@dataclass(frozen=True)
class Georeference:
    """The grid of a file.

    Attributes:
        crs: PROJ text or name, without vertical parts; empty where the file has none.
        offset: added to the file's x, y, z to reach the grid, after a turn by `turn_rad`, `float64[3]` [m].
        turn_rad: rotation about z of the file's frame into the grid.
    """

    crs: str
    offset: np.ndarray
    turn_rad: float

    @classmethod
    def from_header(cls, header: Element | None, where: str) -> "Georeference":
        """Returns the reference in a <header>; an unusable one counts as none and is logged."""
        text = "" if header is None else " ".join((header.findtext("geoReference") or "").split())
        offset = None if header is None else header.find("offset")
        x, y, z, turn = (0.0,) * 4 if offset is None else numbers(offset, "x y z hdg", where)
        if text and not _is_crs(text):
            _log.warning("%s: geoReference '%s' is not understood; the map stays local", where, text[:80])
            text = ""
        return cls(_VERTICAL.sub("", text).strip(), np.array([x, y, z]), turn)

    def to_grid(self, points: np.ndarray) -> np.ndarray:
        """Returns grid coordinates of points `[n 3]` of the file."""
        c, s = np.cos(self.turn_rad), np.sin(self.turn_rad)
        return points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + self.offset

    def to_enu(self, points: np.ndarray, origin: GeoOrigin) -> np.ndarray:
        """Returns points `[n 3]` of the file in the ENU frame of an origin."""
        return enu_from_projected(self.to_grid(points), self.crs, origin)

    def place(self, points: np.ndarray, where: str) -> GeoOrigin | None:
        """Returns the middle of points `[n 3]` of the file on the earth; None where the reference cannot be true."""
        if not self.crs or len(points) == 0:
            return None
        import pyproj

        grid = self.to_grid(points)
        middle = 0.5 * (grid.min(axis=0) + grid.max(axis=0))
        try:
            projection = pyproj.Proj(self.crs)
            lon, lat = projection(middle[0], middle[1], inverse=True)
            factors = projection.get_factors(lon, lat)
            scales = (factors.meridional_scale, factors.parallel_scale)
        except pyproj.exceptions.ProjError as error:
            _log.warning("%s: geoReference '%s' cannot be used (%s); the map stays local", where, self.crs[:80], error)
            return None
        if not (np.isfinite([lon, lat]).all() and max(abs(scale - 1.0) for scale in scales) < _TRUE_SCALE):
            _log.warning("%s: lies outside of the grid of its geoReference; the map stays local", where)
            return None
        return GeoOrigin(round(float(lat), 5), round(float(lon), 5), round(float(middle[2]), 1))

    def require(self, where: str) -> None:
        """Raises where an origin was given and the file has no grid."""
        if not self.crs:
            raise SemlocError(f"{where}: has no geoReference: its place on the earth is unknown; leave the origin out")


def _is_crs(text: str) -> bool:
    """Returns whether a text names a grid without reaching for files."""
    if len(text) > _LONGEST_TEXT:
        return False
    if text.startswith("+"):
        words = text.split()
        return "+proj=" in text and "+init" not in text and all(_PROJ_WORD.fullmatch(word) for word in words)
    return re.fullmatch(r"EPSG:\d{4,6}", text) is not None or text.startswith(("PROJCS[", "PROJCRS["))
