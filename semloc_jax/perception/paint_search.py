"""All strokes of paint of one image: ridges of the top view, measured in the image (room: perception; host).

In: an image, its top view and the spots in it. Out: Strokes that are paint, and how sharp the ridges in the spots are.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from semloc_jax.perception.paint_candidates import PaintCandidates, PaintConfig, paint_brightness
from semloc_jax.perception.paint_choice import ALONG, MAX_SCATTER_M, are_sharp, choose_paint
from semloc_jax.perception.paint_colours import TopView, are_on_grey, are_white, whiteness
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
