"""Points of an element as a GeoPackage blob and back (room: maps; host).

In: `float64[k 3]` or a blob. Out: the other: header, then WKB of a LINESTRING Z, POLYGON Z or POINT Z, little-endian.
"""

import struct

import numpy as np
import shapely

from semloc_jax.errors import SemlocError

_HEADER = struct.Struct("<2sBBi")
_LITTLE_ENDIAN = 1
_POINT, _LINE, _POLYGON = 1001, 1002, 1003
_ENVELOPE_BYTES = (0, 32, 48, 48, 64)


def to_blob(points: np.ndarray, closed: bool, srs_id: int) -> bytes:
    """Returns the blob of points `[k 3]`; an outline of three or more becomes a polygon."""
    head = _HEADER.pack(b"GP", 0, _LITTLE_ENDIAN, srs_id)
    body = np.ascontiguousarray(points, dtype="<f8").tobytes()
    if len(points) == 1:
        return head + struct.pack("<BI", 1, _POINT) + body
    if closed and len(points) > 2:
        return head + struct.pack("<BIII", 1, _POLYGON, 1, len(points) + 1) + body + body[:24]
    return head + struct.pack("<BII", 1, _LINE, len(points)) + body


def from_blob(blob: bytes, where: str) -> tuple[np.ndarray, bool, bool]:
    """Returns points `float64[k 3]` of a blob, whether they are an outline, and whether they have heights.

    Raises:
        SemlocError: not a geometry of one line, outline or point.
    """
    if not isinstance(blob, bytes) or len(blob) < 13 or blob[:2] != b"GP":
        raise SemlocError(f"{where}: its geometry is no GeoPackage geometry; expected a line, an outline or a point")
    if blob[3] == _LITTLE_ENDIAN and blob[8] == 1:
        own = _own_form(blob)
        if own is not None:
            return own
    return _any_form(blob, where)


def _own_form(blob: bytes) -> tuple[np.ndarray, bool, bool] | None:
    """Returns what `to_blob` wrote; None if another program wrote it."""
    kind = int.from_bytes(blob[9:13], "little")
    start = {_POINT: 13, _LINE: 17, _POLYGON: 21}.get(kind)
    if start is None or (len(blob) - start) % 24 or len(blob) == start:
        return None
    points = np.frombuffer(blob, dtype="<f8", offset=start).reshape(-1, 3).astype(np.float64)
    if kind == _POINT:
        return (points, False, True) if len(points) == 1 else None
    if int.from_bytes(blob[start - 4 : start], "little") != len(points):
        return None
    if kind == _POLYGON:
        is_ring = blob[13:17] == b"\1\0\0\0" and len(points) > 3
        return (points[:-1], True, True) if is_ring else None
    return points, False, True


def _any_form(blob: bytes, where: str) -> tuple[np.ndarray, bool, bool]:
    envelope = blob[3] >> 1 & 7
    start = 8 + (_ENVELOPE_BYTES[envelope] if envelope < len(_ENVELOPE_BYTES) else 1 << 30)
    try:
        geometry = shapely.from_wkb(blob[start:])
    except (shapely.errors.GEOSException, ValueError) as error:
        raise SemlocError(f"{where}: its geometry cannot be read ({str(error)[:60]})") from error
    parts = shapely.get_parts(geometry)
    if len(parts) != 1 or parts[0].geom_type not in ("Point", "LineString", "Polygon") or parts[0].is_empty:
        kind = "nothing" if len(parts) == 0 else f"{len(parts)} of {parts[0].geom_type}"
        raise SemlocError(f"{where}: its geometry is {kind}; expected one line, outline or point")
    closed = parts[0].geom_type == "Polygon"
    line = parts[0].exterior if closed else parts[0]
    points = shapely.get_coordinates(line, include_z=True)
    has_height = bool(np.isfinite(points[:, 2]).all())
    points = points if has_height else np.column_stack([points[:, :2], np.zeros(len(points))])
    return (points[:-1] if closed else points), closed, has_height
