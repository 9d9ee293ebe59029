"""What the map says a camera sees, as a network should say it (room: learning; host).

In: surfaces of map elements in an image, trust in elements. Out: Labels on the cells of the network.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax.learning.eyes.shapes import Surfaces
from semloc_jax.maps.elements import PAINT_CLASSES, MapElement
from semloc_jax.perception.class_table import ClassTable
from semloc_jax.perception.distance import signed_distance
from semloc_jax.perception.networks.eyes import CELL_PX, REACH_PX, Said

_FINE = 4
"""Drawn pixels along each side of a cell."""
_DRAWN_PX = CELL_PX / _FINE
"""Pixels of the network's image in one drawn pixel."""
_OUTSET = 0.5
"""OpenCV also fills the pixels that the border of a polygon runs through: half a drawn pixel more on each side."""
_SHIFT = 4
_UNKNOWN_ID = 255
_BEYOND_PX = 6.0
"""About what is not to be judged nothing is known as far as this [px of the network's image]."""
_LEAST_PX = 1.0
"""What is narrower than this [px of the network's image] cannot be seen: whoever is asked for it learns to invent."""
_MOST_SIGMA = 0.74
"""Of the width of a piece. By an error e of the pose the label in its middle is |e| less half the width, in the median
0.67 sigma less half the width: what is narrower would be taught to be nowhere, although it is in every image."""
EXACT_SIGMA_PX = 0.3
"""Sides are not drawn more exactly than this."""


class Labels(NamedTuple):
    """What is known of the cells of an image; k classes.

    Distances in pixels of the network's image, negative inside, clipped at `REACH_PX`.
    """

    signed_px: Float[np.ndarray, "k h w"]
    sigma_px: Float[np.ndarray, "k h w"]
    """By the pose and the map: how far the nearest border may be from where it was drawn."""
    known: Bool[np.ndarray, "h w"]
    """False where traffic hides the map, and about elements that nobody trusts or that are too far to judge."""
    kept: Bool[np.ndarray, "k h w"]
    """Where distance and sigma are those that the eyes tell already: they are not to change."""


def drawn_labels(
    surfaces: Surfaces,
    elements: Sequence[MapElement],
    table: ClassTable,
    size_px: tuple[int, int],
    scale: float,
    is_trusted: Bool[np.ndarray, " e"],
    hidden: Bool[np.ndarray, "h w"] | None,
    max_range_m: float = 45.0,
) -> Labels:
    """The labels of an image.

    Args:
        surfaces: Of the elements in it.
        elements: The elements.
        table: Classes of the network: channel k is id k + 1.
        size_px: (width, height) of the image.
        scale: Pixels of the network's image for one of the image.
        is_trusted: Of each element.
        hidden: Where something hides the map, or shows what it lacks, at any size; None for nowhere.
        max_range_m: Paint farther away is not judged: it is thinner than a cell, and hidden as often as not.
    """
    width, height = (round(side * scale) for side in size_px)
    cells = -(-width // int(CELL_PX)), -(-height // int(CELL_PX))
    channel = np.array([table.channel_of(element.label) for element in elements], int)
    is_paint = np.array([element.label in PAINT_CLASSES for element in elements], bool)
    ids = np.zeros((cells[1] * _FINE, cells[0] * _FINE), np.uint8)
    owner = surfaces.element
    is_judged = is_trusted[owner] & ((surfaces.distance_m <= max_range_m) | ~is_paint[owner]) & (channel[owner] >= 0)
    width_px, unsure_px = _widths_px(surfaces), surfaces.sigma_px[:, ::2].max(axis=1)
    is_judged &= (scale * width_px >= _LEAST_PX) & (unsure_px <= _MOST_SIGMA * width_px)
    corners = (surfaces.uv + 0.5) * (scale / _DRAWN_PX) - 0.5
    # What stands hides what lies behind it: paint first, then from far to near, the order of the surfaces.
    for standing in (False, True):
        for k in np.flatnonzero(is_paint[owner] != standing).tolist():
            _fill(ids, corners, owner, k, int(channel[owner[k]]) + 1 if is_judged[k] else _UNKNOWN_ID)
    known = ~_grown(ids == _UNKNOWN_ID, _BEYOND_PX / _DRAWN_PX)
    planes = [
        _plane(ids, k + 1, surfaces, corners, is_judged & (channel[owner] == k), scale)
        for k in range(len(table.channels))
    ]
    signed, sigma = (np.stack(part) for part in zip(*planes, strict=True))
    known = cv2.resize(known.astype(np.uint8), cells, interpolation=cv2.INTER_NEAREST) > 0
    if hidden is not None:
        covered = cv2.resize(hidden.astype(np.uint8), cells, interpolation=cv2.INTER_NEAREST) > 0
        known &= ~_grown(covered, _BEYOND_PX / CELL_PX)
    return Labels(signed, sigma, known, np.zeros(signed.shape, bool))


def _widths_px(surfaces: Surfaces) -> Float[np.ndarray, " n"]:
    """How wide pieces are between their borders [px]; a side of an outline has no width that could be too small."""
    uv = surfaces.uv
    across = 0.5 * np.linalg.norm(uv[:, 0] + uv[:, 1] - uv[:, 2] - uv[:, 3], axis=1)
    return np.where((uv[:, 1] == uv[:, 2]).all(axis=1), np.inf, across)


def _fill(ids: np.ndarray, corners: np.ndarray, owner: np.ndarray, k: int, value: int) -> None:
    """Draw a piece; an outline is drawn whole, once, with the first of its sides."""
    shape = corners[k]
    if np.array_equal(shape[1], shape[2]):
        rows = np.flatnonzero(owner == owner[k])
        if rows[0] != k:
            return
        shape = corners[np.sort(rows)][:, 0] if len(rows) > 2 else shape
    cv2.fillPoly(ids, [np.round(shape * 2**_SHIFT).astype(np.int32)], value, cv2.LINE_8, _SHIFT)


def with_kept(labels: Labels, told: Sequence[bool], said: Said) -> Labels:
    """Labels that ask for what a network says already wherever the map tells nothing: of classes that the map has none
    of, of what hides it, and behind it. Otherwise these drift as the features do that all classes share.

    Args:
        labels: By the map, of the channels of the table.
        told: Of each channel, whether the map has any of its classes.
        said: Of the cells of the image, one class more than channels where the network tells what hides the map.
    """
    signed = np.clip(np.moveaxis(said.signed_px, -1, 0), -REACH_PX, REACH_PX)
    sigma, kept = np.exp(np.moveaxis(said.log_sigma, -1, 0)), np.ones(signed.shape, bool)
    for k in np.flatnonzero(told).tolist():
        kept[k] = ~labels.known
        signed[k] = np.where(kept[k], signed[k], labels.signed_px[k])
        sigma[k] = np.where(kept[k], sigma[k], labels.sigma_px[k])
    return Labels(signed, sigma, labels.known, kept)


def _plane(
    ids: np.ndarray, value: int, surfaces: Surfaces, corners: np.ndarray, chosen: np.ndarray, scale: float
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Distance and sigma of one class on the cells."""
    inside = np.where(ids == value, np.uint8(255), np.uint8(0))
    rows, columns = (side // _FINE for side in ids.shape)
    if not inside.any():
        far, exact = (np.full((rows, columns), value, np.float32) for value in (REACH_PX, EXACT_SIGMA_PX))
        return far, exact
    return cell_distances(inside, _OUTSET), _nearest_sigma(surfaces, corners, chosen, (rows, columns), scale)


def cell_distances(inside: UInt8[np.ndarray, "_h _w"], outset: float = 0.0) -> Float[np.ndarray, "h w"]:
    """Signed distance of cells to the border of what is drawn [px of the network's image], clipped at `REACH_PX`.

    Args:
        inside: 255 where it is, 0 elsewhere; four drawn pixels along each side of a cell.
        outset: how far it was drawn too large on each side [drawn pixels].
    """
    rows, columns = (side // _FINE for side in inside.shape)
    if not inside.any() or inside.all():  # no border at all
        return np.full((rows, columns), -REACH_PX if inside.any() else REACH_PX, np.float32)
    signed = (signed_distance(inside, 1.0) + outset) * _DRAWN_PX
    # The middle of a cell lies between the four drawn pixels in its middle.
    first = _FINE // 2 - 1
    parts = [signed[first + i :: _FINE, first + j :: _FINE] for i in (0, 1) for j in (0, 1)]
    return np.clip(sum(parts) / 4.0, -REACH_PX, REACH_PX).astype(np.float32)


def _nearest_sigma(
    surfaces: Surfaces, corners: np.ndarray, chosen: np.ndarray, shape: tuple[int, int], scale: float
) -> Float[np.ndarray, "h w"]:
    """The sigma of the side that is nearest to each cell."""
    number = np.zeros(shape, np.int32)
    sigmas = [REACH_PX]
    for k in np.flatnonzero(chosen).tolist():
        on_cells = np.round((corners[k] + 0.5) / _FINE - 0.5).astype(int)
        for side, is_border in enumerate((True, surfaces.is_end[k, 0], True, surfaces.is_end[k, 1])):
            if is_border:
                a, b = on_cells[side], on_cells[(side + 1) % 4]
                cv2.line(number, tuple(map(int, a)), tuple(map(int, b)), len(sigmas), 1)
                sigmas.append(max(scale * float(surfaces.sigma_px[k, side]), EXACT_SIGMA_PX))
    if not number.any():
        return np.full(shape, REACH_PX, np.float32)
    _, label = cv2.distanceTransformWithLabels(
        (number == 0).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_label = np.zeros(label.max() + 1, np.int32)
    of_label[label[number > 0]] = number[number > 0]
    return np.asarray(sigmas, np.float32)[of_label[label]]


def _grown(region: np.ndarray, reach: float) -> np.ndarray:
    size = 2 * int(np.ceil(reach)) + 1
    return cv2.dilate(region.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
