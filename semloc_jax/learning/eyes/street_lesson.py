"""Eyes are taught on random streets whose masks are exact (room: learning; JAX and host).

In: StreetsConfig, a folder. Out: Eyes, and how well they tell each class of scenes that they never saw.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from semloc_jax.learning.eyes.batches import ImagePool, LabelledImage, draw_batch
from semloc_jax.learning.eyes.loss import eyes_loss
from semloc_jax.learning.eyes.streets import TEACHES, StreetsConfig, drawn_scenes, labelled
from semloc_jax.learning.training import train
from semloc_jax.perception import load_class_table
from semloc_jax.perception.networks.eyes import Eyes, num_told

TABLE = "street"
"""The preset with the classes that random streets teach."""
_NEAR_PX = 8.0
_SURE = (1.0, 2.0, 3.0)


class ClassScore(NamedTuple):
    """How well one class is told on pictures held out, over all of their cells."""

    name: str
    recall: float
    """Share of its cells that are told to be of it."""
    precision: float
    error_px: float
    """Median error of distances nearer than 8 px to a border [px of the network's image]."""
    within: tuple[float, float, float]
    """Of distances that are told to be nearer than 8 px, whatever is there, the share within 1, 2, 3 of their sigmas.
    Chosen by the truth they would look too large: where a post stands it may be told rightly that nobody knows."""


class StreetLesson(NamedTuple):
    """What came of it."""

    eyes: Eyes
    scores: list[ClassScore]
    held_out: list[LabelledImage]


def taught_on_streets(
    config: StreetsConfig,
    folder: Path,
    begin: Eyes | None = None,
    on_step: Callable[[int, float], None] | None = None,
) -> StreetLesson:
    """Draw the scenes, train, judge.

    Args:
        config: Scenes, steps, crops.
        folder: Keeps the scenes and the checkpoint: a lesson that stopped goes on there.
        begin: Eyes to go on with; None for new ones.
        on_step: Called with the number of a step and its loss.
    """
    eyes = begin or Eyes.new(load_class_table(TABLE), config.training.seed)
    teaching: list[LabelledImage] = []
    judging: list[LabelledImage] = []
    for entry, views in drawn_scenes(config, config.training.seed, folder / "scenes"):
        images = [image for view in views for image in labelled(view, eyes.table)]
        (teaching if entry.part == TEACHES else judging).extend(images)

    pool = ImagePool(teaching)

    def batch_of(rng: np.random.Generator):
        return draw_batch(pool, config.crops, eyes.config.step_px, rng)

    network = train(eyes.network, eyes_loss, batch_of, config.training, folder / "streets.checkpoint", on_step)
    taught_on = {"streets": config.num_streets, "garages": config.num_garages, "pictures": len(teaching)}
    taught_on |= {"steps": config.training.num_steps, "seed": config.training.seed}
    eyes = replace(eyes, network=network, card={"taught": taught_on})
    scores = class_scores(eyes, judging)
    card = eyes.card | {"held_out": {score.name: score._asdict() for score in scores}}
    return StreetLesson(replace(eyes, card=card), scores, judging)


def class_scores(eyes: Eyes, images: Sequence[LabelledImage]) -> list[ClassScore]:
    """The scores of every class that eyes tell, on labelled images."""
    number = num_told(eyes.table)
    counts = np.zeros((number, 3))
    errors: list[list[np.ndarray]] = [[] for _ in range(number)]
    over: list[list[np.ndarray]] = [[] for _ in range(number)]
    for image in images:
        said = eyes.said(image.picture.astype(np.float32) / 255.0)
        signed = np.moveaxis(image.signed_px.astype(np.float32), 0, -1)
        is_told, is_there = said.signed_px < 0.0, signed < 0.0
        counts += np.stack([(is_told & is_there).sum((0, 1)), is_there.sum((0, 1)), is_told.sum((0, 1))], axis=1)
        for k in range(number):
            off = np.abs(said.signed_px[..., k] - signed[..., k])
            errors[k].append(off[np.abs(signed[..., k]) < _NEAR_PX])
            over[k].append((off / np.exp(said.log_sigma[..., k]))[np.abs(said.signed_px[..., k]) < _NEAR_PX])
    names = [*(channel.name for channel in eyes.table.channels), "moving"]
    found = []
    for k in range(number):
        off, sigmas = np.concatenate(errors[k]), np.concatenate(over[k])
        within = tuple(float(np.mean(sigmas < sure)) if len(sigmas) else float("nan") for sure in _SURE)
        right, there, told = counts[k]
        error = float(np.median(off)) if len(off) else float("nan")
        found.append(ClassScore(names[k], right / max(there, 1.0), right / max(told, 1.0), error, within))
    return found
