"""Crops of labelled images for training, made different from one another (room: learning; host).

In: images with their labels. Out: Batches of fixed shapes, drawn by a seed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from semloc_jax.learning.eyes.labels import Labels
from semloc_jax.learning.eyes.loss import Batch
from semloc_jax.perception.networks.eyes import CELL_PX, REACH_PX, ready


class LabelledImage(NamedTuple):
    """An image at the scale of the network, with what the map says of it; kept small."""

    picture: np.ndarray
    """uint8[h w c]: red green blue as they are, then scores of another network where there is one."""
    signed_px: np.ndarray
    """float16[k h/2 w/2]."""
    sigma_px: np.ndarray
    known: np.ndarray
    kept: np.ndarray
    """bool[k h/2 w/2]."""

    @classmethod
    def of(cls, picture: np.ndarray, labels: Labels) -> "LabelledImage":
        """The pair; `picture` float[h w c] of 0 ... 1."""
        halves = labels.signed_px.astype(np.float16), labels.sigma_px.astype(np.float16)
        return cls(np.rint(picture * 255.0).astype(np.uint8), *halves, labels.known, labels.kept)


@dataclass(frozen=True)
class CropConfig:
    """What a batch is made of. All values are ours."""

    size: int = 4
    crop_px: tuple[int, int] = (320, 224)
    """Width and height; fewer where images are smaller."""
    near_border: float = 0.7
    """Share of the crops around some border, in place of anywhere."""
    is_varied: bool = True
    """Mirrored, other light, shadows, noise and blur."""


class ImagePool:
    """Labelled images, and which of them show each class."""

    def __init__(self, images: Sequence[LabelledImage]) -> None:
        """All of them, at least one."""
        self.images = tuple(images)
        showing = np.array([((image.signed_px < REACH_PX) & ~image.kept).any(axis=(1, 2)) for image in self.images])
        self.showing = {k: np.flatnonzero(showing[:, k]) for k in range(showing.shape[1]) if showing[:, k].any()}
        """By class, for those that any image shows."""
        # A pillar that one image in twenty shows is drawn a quarter as often as paint, not a twentieth.
        often = np.sqrt([len(which) for which in self.showing.values()])
        self.chance = often / max(often.sum(), 1.0)

    def drawn(self, near_border: float, rng: np.random.Generator) -> tuple[LabelledImage, int, int]:
        """An image and a cell of it: about a border of a class that is drawn by chance, or anywhere."""
        if self.showing and rng.random() < near_border:
            k = list(self.showing)[int(rng.choice(len(self.showing), p=self.chance))]
            image = self.images[rng.choice(self.showing[k])]
            near = np.argwhere((np.abs(image.signed_px[k]) < 4.0) & ~image.kept[k])
            if len(near):
                row, column = near[rng.integers(len(near))] + rng.integers(-40, 41, 2)
                return image, int(row), int(column)
        image = self.images[rng.integers(len(self.images))]
        rows, columns = image.known.shape
        return image, int(rng.integers(rows)), int(rng.integers(columns))


def draw_batch(pool: ImagePool, config: CropConfig, step_px: int, rng: np.random.Generator) -> Batch:
    """Crops of random images.

    Args:
        pool: All of them.
        config: Size and number of crops.
        step_px: Sides of crops are multiples of this; images that are smaller are filled up with what is unknown.
        rng: What draws.
    """
    height, width = (max(one.picture.shape[axis] for one in pool.images) for axis in (0, 1))
    size = [
        step_px * -(-min(side, most) // step_px) for side, most in zip((width, height), config.crop_px, strict=True)
    ]
    crops = [_crop(*pool.drawn(config.near_border, rng), (size[0], size[1]), config, rng) for _ in range(config.size)]
    return Batch(*(np.stack(part) for part in zip(*crops, strict=True)))


def _crop(
    image: LabelledImage,
    row: int,
    column: int,
    size_px: tuple[int, int],
    config: CropConfig,
    rng: np.random.Generator,
) -> tuple:
    """Of one crop about a cell, as in a `Batch`, all float32."""
    (width, height), cell = size_px, int(CELL_PX)
    rows, columns = image.known.shape
    top = int(np.clip(row - height // cell // 2, 0, max(rows - height // cell, 0)))
    left = int(np.clip(column - width // cell // 2, 0, max(columns - width // cell, 0)))
    part = np.s_[top : top + height // cell, left : left + width // cell]
    picture = image.picture[cell * top : cell * top + height, cell * left : cell * left + width]
    picture = _filled(picture.astype(np.float32) / 255.0, (height, width), "edge")
    shape = (height // cell, width // cell)
    known = _filled(image.known[part].astype(np.float32), shape, "constant")
    signed, sigma = (
        _filled(np.moveaxis(plane[:, part[0], part[1]].astype(np.float32), 0, -1), shape, "edge")
        for plane in (image.signed_px, image.sigma_px)
    )
    kept = _filled(np.moveaxis(image.kept[:, part[0], part[1]].astype(np.float32), 0, -1), shape, "constant")
    if config.is_varied:
        picture = _in_other_light(picture, rng)
        if rng.random() < 0.5:
            picture, signed, sigma, known, kept = (a[:, ::-1] for a in (picture, signed, sigma, known, kept))
    return ready(picture), signed, sigma, known, kept


def _filled(plane: np.ndarray, shape: tuple[int, int], how: str) -> np.ndarray:
    missing = [(0, shape[k] - plane.shape[k]) for k in (0, 1)]
    return np.pad(plane, [*missing, *[(0, 0)] * (plane.ndim - 2)], mode=how)


def _in_other_light(picture: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The colours of a picture under another sun, exposure and lens; scores of another network stay."""
    colours = np.clip(picture[..., :3], 0.0, 1.0) ** np.float32(np.exp(rng.normal(0.0, 0.25)))
    gain = np.exp(rng.normal(0.0, 0.2)) * np.exp(rng.normal(0.0, 0.06, 3))
    colours = colours * gain.astype(np.float32) + np.float32(rng.normal(0.0, 0.04))
    for _ in range(rng.integers(0, 3)):
        colours *= _shadow(colours.shape[:2], rng)[..., None]
    if rng.random() < 0.3:
        colours = cv2.GaussianBlur(colours, (0, 0), rng.uniform(0.4, 1.2))
    colours += np.float32(rng.uniform(0.0, 0.03)) * rng.standard_normal(colours.shape, np.float32)
    return np.concatenate([np.clip(colours, 0.0, 1.0), picture[..., 3:]], axis=-1)


def _shadow(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """What is left of the light behind something that stands in it, float[h w]."""
    corners = rng.uniform(-0.3, 1.3, (rng.integers(3, 7), 2)) * shape[::-1]
    light = np.ones(shape, np.float32)
    cv2.fillPoly(light, [np.round(corners).astype(np.int32)], float(rng.uniform(0.35, 0.85)))
    return cv2.GaussianBlur(light, (0, 0), float(rng.uniform(0.8, 6.0)))
