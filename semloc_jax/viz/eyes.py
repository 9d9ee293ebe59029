"""How a network learns from the map: scores by round, and what it sees of a few frames (room: viz).

In: scores of rounds, images with masks. Out: a Figure, an image array.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from matplotlib.figure import Figure

from semloc_jax.learning.eyes.batches import LabelledImage
from semloc_jax.learning.eyes.judge import RoundScore
from semloc_jax.perception.class_table import ClassTable
from semloc_jax.viz.style import COLOURS, INK, new_figure, plain_axes, rgb

_TILE_PX = 480
_DIRECTIONS = {"across [cm]": "#00838f", "along [cm]": "#ef6c00", "heading [0.01 deg]": "#6a1b9a"}
_WITHIN = ("#1565c0", "#42a5f5", "#90caf9")
_NORMAL = (0.683, 0.954, 0.997)
"""Shares of a normal distribution within 1, 2 and 3 sigma."""


class RoundLook(NamedTuple):
    """One image with what is seen in it."""

    image: np.ndarray
    """uint8[h w 3], blue green red."""
    mask: np.ndarray
    table: ClassTable


def draw_rounds(scores: Sequence[RoundScore]) -> Figure:
    """Recall, errors and honesty of every round on the frames held out; round 0 is what there was."""
    figure = new_figure(11.0, 3.2)
    recall, errors, honesty = (plain_axes(axes) for axes in figure.subplots(1, 3))
    numbers = np.arange(len(scores))
    share = [100.0 * score.num_accepted / max(score.num_frames, 1) for score in scores]
    false = [100.0 * score.num_false / max(score.num_frames, 1) for score in scores]
    recall.bar(numbers, share, 0.6, color="#00897b", label="accepted")
    recall.bar(numbers, false, 0.6, color="#d32f2f", label="of them false")
    recall.set(ylim=(0, 105), ylabel="frames held out [%]", title="accepted")
    for k, (name, colour) in enumerate(_DIRECTIONS.items()):
        errors.plot(numbers, [100.0 * score.median[k] for score in scores], "o-", color=colour, label=name)
    errors.set(ylim=(0, None), title="median error of all poses found")
    for k, colour in enumerate(_WITHIN):
        honesty.plot(numbers, [100.0 * score.within[k] for score in scores], "o-", color=colour, label=f"{k + 1} sigma")
        honesty.axhline(100.0 * _NORMAL[k], color=colour, linewidth=0.8, linestyle=":")
    honesty.set(ylim=(0, 105), ylabel="[%]", title="within their sigmas; dotted: normal")
    for axes in (recall, errors, honesty):
        axes.set_xticks(numbers, ["begin", *(f"round {k}" for k in numbers[1:])])
        axes.title.set_fontsize(10)
        axes.legend(fontsize=7, frameon=False, labelcolor=INK)
    return figure


def draw_curve(steps: np.ndarray, losses: np.ndarray) -> Figure:
    """Loss over the steps of a lesson."""
    figure = new_figure(6.0, 3.2)
    axes = plain_axes(figure.subplots())
    axes.plot(steps, losses, color="#1565c0", linewidth=1.0)
    axes.set(xlabel="step", ylabel="loss", title="mean of every 20 steps")
    return figure


def draw_looks(rows: Sequence[Sequence[RoundLook]]) -> np.ndarray:
    """The same frames in every round, one row a round: borders of each class in its colour."""
    pictures = [np.hstack([_tile(look, f"round {k}" if k else "begin") for look in row]) for k, row in enumerate(rows)]
    return np.vstack(pictures)


def draw_taught(images: Sequence[LabelledImage], table: ClassTable) -> np.ndarray:
    """What the map tells of images, side by side: borders in the colour of their class, red where nothing is known.

    Args:
        images: all of one size.
        table: the classes of their labels.
    """
    return np.hstack([_taught_tile(image, table) for image in images])


def _taught_tile(image: LabelledImage, table: ClassTable) -> np.ndarray:
    height, width = image.picture.shape[:2]
    size = (_TILE_PX, round(_TILE_PX * height / width))
    picture = cv2.resize(np.ascontiguousarray(image.picture[..., :3]), size, interpolation=cv2.INTER_AREA)
    known = cv2.resize(image.known.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    picture[~known] = picture[~known] // 2 + np.array([100, 0, 0], np.uint8)
    for channel, signed_px, kept in zip(table.channels, image.signed_px, image.kept, strict=False):
        told = np.where(kept, np.float32(1.0), signed_px.astype(np.float32))
        inside = (cv2.resize(told, size, interpolation=cv2.INTER_LINEAR) < 0.0).astype(np.uint8)
        contours, _ = cv2.findContours(inside, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, contours, -1, rgb(COLOURS[channel.classes[0]]), 1, cv2.LINE_AA)
    return picture


def _tile(look: RoundLook, text: str) -> np.ndarray:
    height = round(_TILE_PX * look.image.shape[0] / look.image.shape[1])
    size = (_TILE_PX, height)
    picture = np.ascontiguousarray(cv2.resize(look.image[..., ::-1], size, interpolation=cv2.INTER_AREA))
    ids = cv2.resize(np.asarray(look.mask), size, interpolation=cv2.INTER_NEAREST)
    for channel in look.table.channels:
        inside = np.isin(ids, channel.mask_ids).astype(np.uint8)
        contours, _ = cv2.findContours(inside, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, contours, -1, rgb(COLOURS[channel.classes[0]]), 1, cv2.LINE_AA)
    cv2.putText(picture, text, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
    return picture
