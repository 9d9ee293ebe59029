"""Strokes of a top view drawn into the image they come from, at sub-pixel borders (room: perception; host).

In: Strokes and the GroundView. Out: a mask whose pixels have their centres on the strokes.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from semloc_jax.perception.ground_view import GroundView
from semloc_jax.perception.paint_curves import STEP_M
from semloc_jax.perception.paint_strokes import Stroke

_SMOOTH_M = 1.0
_SHORTEST_M = 0.3
_MARGIN_M = 0.15


def draw_strokes(strokes: Sequence[Stroke], view: GroundView) -> np.ndarray:
    """Pixels of the image that lie between both edges of a stroke, bool[h w].

    Args:
        strokes: strokes in the top view of `view`.
        view: the ground view.
    """
    shape = view.bev_uv.shape[:2]
    drawn = np.zeros(shape, bool)
    metres_per_px = 1.0 / float(view.bev.fx)
    band = np.zeros(view.visible.shape, np.int16)
    for number, stroke in enumerate(strokes, start=1):
        half = stroke.normal * ((0.5 * stroke.width_m + _MARGIN_M) / metres_per_px)
        outline = np.concatenate([stroke.uv + half, (stroke.uv - half)[::-1]])
        cv2.fillPoly(band, [np.round(outline).astype(np.int32)], number)
    at = cv2.remap(band, view.bev_uv, None, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    v, u = np.nonzero(at > 0)
    number = at[v, u]
    order = np.argsort(number, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(number[order])) + 1) if len(order) else []:
        rows, columns = v[part], u[part]
        drawn[rows, columns] = _between_edges(
            strokes[number[part[0]] - 1], view.bev_uv[rows, columns].astype(np.float64), metres_per_px
        )
    return drawn


def _between_edges(stroke: Stroke, uv: np.ndarray, metres_per_px: float) -> np.ndarray:
    """Whether points of the top view lie on a stroke, bool[n]."""
    step = np.diff(stroke.uv, axis=0)
    axis = (stroke.uv[-1] - stroke.uv[0]) / np.linalg.norm(stroke.uv[-1] - stroke.uv[0])
    node = (stroke.uv - stroke.uv[0]) @ axis
    place = (uv - stroke.uv[0]) @ axis
    index = np.clip(np.searchsorted(node, place) - 1, 0, len(step) - 1)
    across = ((uv - stroke.uv[index]) * stroke.normal[index]).sum(axis=-1) * metres_per_px
    # Lean of the stroke inside one step.
    left, right = (_smooth(edge, stroke.painted) for edge in (stroke.profiles.left_m, stroke.profiles.right_m))
    painted = _without_specks(stroke.painted)
    inside = (place >= node[0]) & (place <= node[-1])
    return inside & painted[index] & (across > left[index]) & (across < right[index])


def _smooth(edge_m: np.ndarray, painted: np.ndarray) -> np.ndarray:
    """An edge along the stroke, each place the mean over 1 m of where it is seen."""
    size = 2 * round(_SMOOTH_M / STEP_M / 2) + 1
    kernel = np.ones(size)
    weight = np.convolve(painted.astype(float), kernel, "same")
    total = np.convolve(np.where(painted, edge_m, 0.0), kernel, "same")
    return total / np.maximum(weight, 1e-9)


def _without_specks(painted: np.ndarray) -> np.ndarray:
    """Short gaps closed, short specks removed."""
    size = round(_SHORTEST_M / STEP_M)
    row = np.pad(painted.astype(np.uint8)[None], ((0, 0), (size, size)))
    kernel = np.ones((1, size), np.uint8)
    closed = cv2.morphologyEx(row, cv2.MORPH_CLOSE, kernel)
    return cv2.morphologyEx(closed, cv2.MORPH_OPEN, kernel)[0, size:-size] > 0
