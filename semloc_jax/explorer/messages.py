"""What page and session say to each other (room: explorer; host).

In: JSON of the page. Out: PoseQuery, checked; numbers packed for the page: a JSON head and raw little-endian arrays.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.explorer.placement import Placement

FARTHEST_M = 1e7
MOST_HEIGHT_M, MOST_TILT_DEG = 5.0, 30.0
GRIDS = ("coarse", "fine", "none")
MIN_ZOOM, MAX_ZOOM = 1 / 16, 16.0


@dataclass(frozen=True)
class PoseQuery:
    """One pose that the page requests."""

    placement: Placement
    level: int
    """Level of the cost maps."""
    channels: tuple[str, ...]
    """Names of the mask channels that count."""
    grid: Literal["coarse", "fine", "none"] = "coarse"
    """Resolution of the slices; `none` leaves them out."""
    zoom: float = 1.0
    """Factor on the extents of the slices."""
    with_path: bool = True
    """Whether the solve from the pose is wanted."""
    prior: Literal["start", "drive"] = "start"
    """Centre of the solver's prior: the pose itself set on the road, or the first guess of the drive."""


def read_query(content: Any, num_levels: int, channel_names: Sequence[str]) -> PoseQuery:
    """The query of a JSON object.

    Raises:
        SemlocError: a member is missing, of a wrong type or out of its range.
    """
    if not isinstance(content, Mapping):
        raise SemlocError(f"query: got {type(content).__name__}; expected a JSON object with 'pose' and 'level'")
    channels = content.get("channels", list(channel_names))
    if not isinstance(channels, list) or not all(isinstance(name, str) for name in channels):
        raise SemlocError("query: 'channels' must be a list of names")
    unknown = sorted(set(channels) - set(channel_names))
    if unknown:
        raise SemlocError(f"query: no channel '{unknown[0][:40]}'; expected some of {', '.join(channel_names)}")
    level = content.get("level")
    if isinstance(level, bool) or not isinstance(level, int) or not 0 <= level < num_levels:
        raise SemlocError(f"query: level {str(level)[:40]}; expected 0 (coarse) to {num_levels - 1}")
    with_path = content.get("path", True)
    if not isinstance(with_path, bool):
        raise SemlocError(f"query: path {str(with_path)[:40]}; expected true or false")
    return PoseQuery(
        _placement(content.get("pose")),
        level,
        tuple(channels),
        _choice(content, "grid", GRIDS),
        _number(content, "zoom", MIN_ZOOM, MAX_ZOOM, 1.0),
        with_path,
        _choice(content, "prior", ("start", "drive")),
    )


def read_frame_index(content: Any, num_frames: int) -> int:
    """The index of a frame in a JSON object.

    Raises:
        SemlocError: there is none, or no such frame.
    """
    index = content.get("index") if isinstance(content, Mapping) else None
    if isinstance(index, bool) or not isinstance(index, int) or not 0 <= index < num_frames:
        raise SemlocError(f"frame {str(index)[:40]}; expected an index from 0 to {num_frames - 1}")
    return index


def packed(head: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> bytes:
    """Length of the head (uint32), the head as JSON, then the arrays, each aligned to 4 bytes; all little-endian.

    The head gets a member `arrays`: name -> {dtype, shape, offset in bytes after the head}. NaN becomes null.
    """
    parts, table, offset = [], {}, 0
    for name, array in arrays.items():
        array = np.ascontiguousarray(array)
        kind = np.dtype(array.dtype).newbyteorder("<")
        raw = array.astype(kind, copy=False).tobytes()
        raw += b"\0" * (-len(raw) % 4)
        table[name] = {"dtype": kind.name, "shape": list(array.shape), "offset": offset}
        parts.append(raw)
        offset += len(raw)
    text = to_json({**head, "arrays": table})
    text += b" " * (-len(text) % 4)
    return b"".join([np.uint32(len(text)).astype("<u4").tobytes(), text, *parts])


def to_json(content: Any) -> bytes:
    """JSON text in which what is not finite is null."""
    return json.dumps(_plain(content), allow_nan=False, separators=(",", ":")).encode()


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def _placement(content: Any) -> Placement:
    if not isinstance(content, Mapping):
        raise SemlocError(
            "query: no 'pose'; expected an object with x_m, y_m, yaw_deg and height_m, roll_deg, pitch_deg"
        )
    limits = {"x_m": FARTHEST_M, "y_m": FARTHEST_M, "yaw_deg": 1e4, "height_m": MOST_HEIGHT_M}
    values = {}
    for field in fields(Placement):
        most = limits.get(field.name, MOST_TILT_DEG)
        values[field.name] = _number(content, field.name, -most, most, 0.0 if field.name not in _NEEDED else None)
    return Placement(**values)


_NEEDED = ("x_m", "y_m", "yaw_deg")


def _number(content: Mapping, name: str, low: float, high: float, default: float | None) -> float:
    value = content.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise SemlocError(f"query: {name} {str(value)[:40]}; expected a number from {low:g} to {high:g}")
    return float(value)


def _choice(content: Mapping, name: str, choices: Sequence[str]) -> Any:
    value = content.get(name, choices[0])
    if value not in choices:
        raise SemlocError(f"query: {name} {str(value)[:40]}; expected one of {', '.join(choices)}")
    return value
