"""The road that a drive has looked at: where it would have seen paint, had there been any (room: mapping; host).

In: a MadeMap, the poses of the drive. Out: rings in the map frame, and the file seen_area.json, which also says what is
known of that frame.
What other vehicles hid is not in it: an element there was not missed, it was not looked at.
"""

import json
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from semloc_jax.mapping.mapper import MadeMap
from semloc_jax.maps.io.packed_drive import MOST_SCALE
from semloc_jax.storage import json_document, reading, write_text

FILE = "seen_area.json"
_STEP_M = 0.5
_REACH_M = 24.0
_LEAST_M2 = 4.0
_THIN_M = 0.35
_STILL_M = 1.0
Ring = Float[np.ndarray, "k 2"]


def seen_area(made: MadeMap, Ts_map_base: Float[np.ndarray, "n 4 4"], num_looks: int) -> list[Ring]:
    """Outlines of the road that was looked at in at least so many frames [m]."""
    way = Ts_map_base[:, :2, 3]
    low = way.min(axis=0) - _REACH_M
    width, height = np.ceil((way.max(axis=0) + _REACH_M - low) / _STEP_M).astype(int).tolist()
    picture = np.zeros((height, width), np.uint8)
    x = low[0] + (np.arange(width) + 0.5) * _STEP_M
    for row in range(height):
        y = low[1] + (row + 0.5) * _STEP_M
        near = np.abs(way[:, 1] - y).min() < _REACH_M
        if near:
            picture[row] = made.seen(np.column_stack([x, np.full(width, y)]), num_looks)
    picture = cv2.morphologyEx(picture, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    picture = cv2.morphologyEx(picture, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    rings = cv2.findContours(picture, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]
    large = [ring for ring in rings if cv2.contourArea(ring) * _STEP_M**2 >= _LEAST_M2]
    thin = [cv2.approxPolyDP(ring, _THIN_M / _STEP_M, True)[:, 0] for ring in large]
    return [low + (ring + 0.5) * _STEP_M for ring in thin if len(ring) >= 3]


class MadeFrame(NamedTuple):
    """What is known of the frame of a map that a drive made."""

    gauge: str
    """What fixed it; see `mapping.gauge`."""
    scale: float
    """How many times as large wheels and fixes alone have the way as the map does, whose scale images decide."""


def sensor_scale(Ts_map_base: Float[np.ndarray, "n 4 4"], Ts_sensors: Float[np.ndarray, "n 4 4"]) -> float:
    """How many times as far poses lie from their middle by wheels and fixes as they do in the map; 1 for one place."""
    own, other = (T[:, :2, 3] - T[:, :2, 3].mean(axis=0) for T in (Ts_map_base, Ts_sensors))
    size = float(np.linalg.norm(own))
    return float(np.linalg.norm(other)) / size if size > _STILL_M else 1.0


def write_seen_area(rings: list[Ring], frame: MadeFrame, path: Path) -> None:
    """Writes the outlines, to the centimetre, and what is known of the frame they are in."""
    stated = {"gauge": frame.gauge, "scale": round(frame.scale, 6), "rings": [ring.round(2).tolist() for ring in rings]}
    write_text(path, json.dumps(stated) + "\n")


def read_seen_area(path: Path) -> tuple[list[Ring], MadeFrame]:
    """The outlines of a file, and what is known of the frame they are in.

    Raises:
        SemlocError: it holds something else.
    """
    document = json_document(path.read_bytes(), f"seen area {path}")
    with reading(f"seen area {path}"):
        frame = MadeFrame(str(document["gauge"]), float(document.get("scale", 1.0)))
        rings = [np.array(ring, dtype=np.float64).reshape(-1, 2) for ring in document["rings"]]
        if not all(len(ring) >= 3 and np.isfinite(ring).all() for ring in rings):
            raise ValueError("a ring of fewer than three places, or places that are not finite")
        if not abs(frame.scale - 1.0) < MOST_SCALE:
            raise ValueError(f"scale {frame.scale}; expected a number near 1")
    return rings, frame
