"""Boxes of obstacles drawn on a view on a cylinder (room: viz).

In: a picture, boxes found and true ones. Out: image arrays.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.perception.networks.obstacle_net import KINDS, FoundObstacles
from semloc_jax.viz.obstacles import COLOURS
from semloc_jax.viz.style import SHIFT, rgb

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
