"""All strokes of paint of one image, found in the top view and drawn back into the image (room: perception; host).

In: an image, its top view and the spots in it. Out: Strokes that are paint, how sharp the ridges in the spots are, a
mask whose pixels have their centres on the strokes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from semloc_jax.perception.ground_view import GroundView
from semloc_jax.perception.paint_candidates import PaintCandidates, PaintConfig, paint_brightness
from semloc_jax.perception.paint_choice import ALONG, MAX_SCATTER_M, are_sharp, choose_paint
from semloc_jax.perception.paint_colours import TopView, are_on_grey, are_white, whiteness
from semloc_jax.perception.paint_curves import STEP_M
from semloc_jax.perception.paint_profiles import (
    THIN,
    WIDE,
    RidgeProfiles,
    RidgeScale,
    find_ridges,
    lookup,
    measure_profiles,
)
from semloc_jax.perception.paint_strokes import Stroke, find_strokes

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


_UNSEEN = 400.0
"""Brightness beyond the picture: no stroke has contrast against it."""


@dataclass(frozen=True)
class _Colour:
    """One colour of paint.

    Args:
        brightness: of an image, uint8[... 3] BGR, in which the colour stands out, float32[...].
        fits: whether places of a top view have it; from the view, places and unit vectors across.
    """

    brightness: Callable[[np.ndarray], np.ndarray]
    fits: Callable[[TopView, np.ndarray, np.ndarray], np.ndarray]


_ON_GREY = _Colour(paint_brightness, are_on_grey)
_WHITE = _Colour(whiteness, are_white)


def search_strokes(
    image: np.ndarray, top: np.ndarray, candidates: PaintCandidates, colours: TopView, config: PaintConfig
) -> tuple[list[Stroke], np.ndarray]:
    """Strokes of paint, and the ridges in candidates: 1 with two sharp edges, -1 others, 0 none, int8[h w].

    White is looked for where all three colours are bright: beside it, grass in the sun is as bright in two of them.
    On a grey road green and red show it best, and yellow by the blue that it lacks.

    Args:
        image: BGR, uint8[h w 3].
        top: its top view, uint8[h w 3].
        candidates: spots of the top view.
        colours: the top view with its colours.
        config: what counts as paint.
    """
    columns = np.ascontiguousarray(np.moveaxis(colours.view.image_uv, -1, 0))
    strokes, sharp = {THIN: [], WIDE: []}, np.zeros(candidates.visible.shape, np.int8)
    for colour in (_ON_GREY, _WHITE):
        grey = np.where(candidates.visible, colour.brightness(top), np.float32(_UNSEEN))
        fine = partial(_brightness_at, colour.brightness(image), *columns)
        for scale, found in strokes.items():
            bright, keep = _ridges(grey, candidates, colours, scale, colour)
            ridges = bright.at(keep)
            for points, sign in ((bright, -1), (ridges, 1)):
                u, v = points.uv[points.contrast > ALONG.min_contrast].astype(int).T
                sharp[v, u] = sign
            found += find_strokes(fine, ridges, scale.max_half_width_m, config.metres_per_px, MAX_SCATTER_M)
    # Lines and the bars of a crosswalk run in directions of their own.
    return [stroke for found in strokes.values() for stroke in choose_paint(found, colours)], sharp


def _ridges(
    grey: np.ndarray, candidates: PaintCandidates, colours: TopView, scale: RidgeScale, colour: _Colour
) -> tuple[RidgeProfiles, np.ndarray]:
    """Ridges in a colour of paint, of white those in candidates, too; which of them may be strokes, bool[n]."""
    uv, normal = find_ridges(grey, candidates.visible, scale, colours.metres_per_px)
    coloured = colour.fits(colours, uv, normal)
    u, v = uv.astype(int).T
    wanted = coloured | (candidates.label[v, u] > 0) if colour is _WHITE else coloured
    bright = measure_profiles(
        partial(lookup, grey), uv[wanted], normal[wanted], scale.max_half_width_m, colours.metres_per_px
    )
    return bright, coloured[wanted] & are_sharp(bright, colours)


def _brightness_at(
    grey: np.ndarray, image_u: np.ndarray, image_v: np.ndarray, u: np.ndarray, v: np.ndarray
) -> np.ndarray:
    """Brightness of the image at places of the top view, float32[n k]; as of nothing dark beyond the picture."""
    columns, rows = lookup(image_u, u, v), lookup(image_v, u, v)  # OpenCV rounds pictures of two planes otherwise
    found = lookup(grey, columns, rows)
    found[(columns < 0.0) | (rows < 0.0)] = _UNSEEN
    return found
