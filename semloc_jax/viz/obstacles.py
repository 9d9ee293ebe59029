"""Obstacles drawn on a top view, and their boxes on a view on a cylinder (room: viz).

In: a picture, obstacles in the base frame or boxes found and true ones. Out: image arrays.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.perception.networks.obstacle_net import KINDS, FoundObstacles
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


_TRUE, _OPEN = "#ffffff", "#808080"


def draw_boxes(
    picture: UInt8[np.ndarray, "h w 3"],
    found: FoundObstacles,
    true_box: Float[np.ndarray, "n 4"],
    is_asked: Bool[np.ndarray, " n"] | Sequence[bool],
) -> UInt8[np.ndarray, "h w 3"]:
    """The picture, red green blue: truth in white, grey where it is not asked for; what was found in the colour of its
    class with its confidence and a dot where it stands.

    Args:
        picture: blue green red.
        found: what is drawn.
        true_box: left, top, right, lower border [px].
        is_asked: of each of them.
    """
    shown = np.ascontiguousarray(picture[..., ::-1])
    for box, asked in zip(true_box, is_asked, strict=True):
        _frame(shown, box, rgb(_TRUE if asked else _OPEN))
    for kind, box, foot, sure in zip(found.kind, found.box, found.foot_uv, found.confidence, strict=True):
        colour = rgb(COLOURS[KINDS[int(kind)]])
        _frame(shown, box, colour)
        cv2.circle(shown, tuple(np.rint(foot).astype(int).tolist()), 2, colour, -1, cv2.LINE_AA)
        at = tuple(np.rint(box[:2] - [0.0, 2.0]).astype(int).tolist())
        cv2.putText(shown, f"{100 * sure:.0f}", at, cv2.FONT_HERSHEY_PLAIN, 0.7, colour, 1, cv2.LINE_AA)
    return shown


def _frame(shown: np.ndarray, box: Float[np.ndarray, " 4"], colour: tuple[int, int, int]) -> None:
    left, top, right, low = np.rint(box * 2**SHIFT).astype(int).tolist()
    cv2.rectangle(shown, (left, top), (right, low), colour, 1, cv2.LINE_AA, SHIFT)
