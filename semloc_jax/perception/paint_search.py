"""All strokes of paint of one image: ridges of the top view, measured in the image (room: perception; host).

In: an image, its top view and the spots in it. Out: Strokes that are paint, and how sharp the ridges in the spots are.
"""

from functools import partial

import numpy as np

from semloc_jax.perception.paint_candidates import PaintCandidates, PaintConfig, paint_brightness
from semloc_jax.perception.paint_choice import ALONG, MAX_SCATTER_M, are_sharp, choose_paint
from semloc_jax.perception.paint_colours import TopView, is_white_or_yellow
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


def search_strokes(
    image: np.ndarray, candidates: PaintCandidates, colours: TopView, config: PaintConfig
) -> tuple[list[Stroke], np.ndarray]:
    """Strokes of paint, and the ridges in candidates: 1 with two sharp edges, -1 others, 0 none, int8[h w].

    Args:
        image: BGR, uint8[h w 3].
        candidates: spots of its top view.
        colours: the top view with its colours.
        config: what counts as paint.
    """
    grey = np.where(candidates.visible, candidates.grey, np.float32(_UNSEEN))
    columns = np.ascontiguousarray(np.moveaxis(colours.view.image_uv, -1, 0))
    fine = partial(_brightness_at, paint_brightness(image), *columns)
    strokes, sharp = [], np.zeros(grey.shape, np.int8)
    for scale in (THIN, WIDE):
        bright, keep = _ridges(grey, candidates, colours, scale)
        ridges = bright.at(keep)
        for points, sign in ((bright, -1), (ridges, 1)):
            u, v = points.uv[points.contrast > ALONG.min_contrast].astype(int).T
            sharp[v, u] = sign
        strokes += find_strokes(fine, ridges, scale.max_half_width_m, config.metres_per_px, MAX_SCATTER_M)
    # Together: thin and wide strokes share one road.
    return choose_paint(strokes, colours), sharp


def _ridges(
    grey: np.ndarray, candidates: PaintCandidates, colours: TopView, scale: RidgeScale
) -> tuple[RidgeProfiles, np.ndarray]:
    """Ridges in the colours of paint or in candidates; which of them may be strokes, bool[n]."""
    uv, normal = find_ridges(grey, candidates.visible, scale, colours.metres_per_px)
    u, v = uv.astype(int).T
    coloured = is_white_or_yellow(colours.colours(uv))
    wanted = coloured | (candidates.label[v, u] > 0)
    bright = measure_profiles(
        partial(lookup, grey), uv[wanted], normal[wanted], scale.max_half_width_m, colours.metres_per_px
    )
    return bright, coloured[wanted] & are_sharp(bright, colours)


def _brightness_at(
    grey: np.ndarray, image_u: np.ndarray, image_v: np.ndarray, u: np.ndarray, v: np.ndarray
) -> np.ndarray:
    """Brightness of the image at places of the top view, float32[n k]; as of nothing dark beyond the picture."""
    columns, rows = lookup(image_u, u, v), lookup(image_v, u, v)
    found = lookup(grey, columns, rows)
    found[(columns < 0.0) | (rows < 0.0)] = _UNSEEN
    return found
