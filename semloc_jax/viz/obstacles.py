"""Obstacles drawn on a top view (room: viz).

In: a top view, obstacles in the base frame. Out: image arrays.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from semloc_jax.perception.surround import SurroundView
from semloc_jax.viz.slots import UNSURE
from semloc_jax.viz.style import SHIFT, rgb

COLOURS = {"cone": "#ff6d00", "pillar": "#ff8a80", "ground_lock": "#ffd600", "no_parking_sign": "#ff1744"}

_ELLIPSE = 32


class DrawnObstacle(NamedTuple):
    """What is drawn of one obstacle."""

    outline_base: np.ndarray
    """float64[k 2]: its footprint [m]."""
    ellipse_base: np.ndarray
    """float64[k 2]: where it may be, two sigmas [m]."""
    kind: str
    name: str
    confirmed: bool


def ellipse(middle: np.ndarray, covariance: np.ndarray, sigmas: float = 2.0) -> np.ndarray:
    """Points of the ellipse of a covariance, `float64[k 2]`."""
    values, axes = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, 2.0 * np.pi, _ELLIPSE, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return middle + sigmas * (circle * np.sqrt(np.maximum(values, 0.0))) @ axes.T


def draw_obstacles(picture: np.ndarray, view: SurroundView, obstacles: Sequence[DrawnObstacle]) -> np.ndarray:
    """A copy of a top view, uint8[h w 3] red green blue, with obstacles by class; not confirmed ones are grey."""
    shown = np.ascontiguousarray(picture).copy()
    thick = max(1, round(shown.shape[1] / 350))
    for thing in sorted(obstacles, key=lambda o: o.confirmed):
        colour = rgb(COLOURS[thing.kind] if thing.confirmed else UNSURE)
        outline, around = (
            np.round(view.pixels(part) * 2**SHIFT).astype(np.int32) for part in (thing.outline_base, thing.ellipse_base)
        )
        filled = shown.copy()
        cv2.fillPoly(filled, [outline], colour, cv2.LINE_AA, SHIFT)
        shown = cv2.addWeighted(filled, 0.6, shown, 0.4, 0.0)
        cv2.polylines(shown, [outline], True, colour, thick, cv2.LINE_AA, SHIFT)
        cv2.polylines(shown, [around], True, (255, 255, 255), max(1, thick // 2), cv2.LINE_AA, SHIFT)
        at = view.pixels(thing.outline_base).max(axis=0).round().astype(int) + [2 * thick, 0]
        for ink, width in (((8, 10, 14), thick + 2), ((240, 244, 248), max(1, thick // 2))):
            place = int(at[0]), int(at[1])
            cv2.putText(shown, thing.name, place, cv2.FONT_HERSHEY_SIMPLEX, 0.24 * thick, ink, width, cv2.LINE_AA)
    return shown
