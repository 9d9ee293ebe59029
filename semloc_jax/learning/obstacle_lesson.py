"""The whole lesson for obstacles: pictures, training, judgement, threshold (room: learning; JAX and host).

In: ObstacleLearningConfig. Out: the trained network, its threshold and its scores on pictures it never saw.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, UInt8

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.average_precision import BoxScore, BoxSet, box_score
from semloc_jax.learning.obstacle_boxes import CylinderPool, ObstacleBatch, is_asked, obstacle_loss
from semloc_jax.learning.sureness import UNSEEN_SEED, begun
from semloc_jax.learning.training import TrainingConfig, train
from semloc_jax.perception.networks.dense_net import DenseNet
from semloc_jax.perception.networks.obstacle_net import (
    CONFIG,
    FAR,
    HORIZON_V,
    KINDS,
    NEAR,
    PX_PER_RAD,
    SIZE_PX,
    ObstacleNet,
)
from semloc_jax.perception.networks.weights import load_weights
from semloc_jax.simulation.cylinder_views.picture import CylinderSample, Geometry, cylinder_sample

_LEAST = 0.05
"""Boxes that are less sure do not count for the average precision."""
_THRESHOLDS = np.arange(0.2, 0.75, 0.05)


@dataclass(frozen=True)
class ObstacleLearningConfig:
    """How the network for obstacles is taught.

    Args:
        num_pictures: random views that are drawn; each step cuts windows from some of them.
        far_share: of them and of the steps, those of the strip at the horizon: what is far is hardest.
        width_px: their width.
        window_px: width of the windows.
        batch: so many of them in a step.
        num_judged: random views that judge.
        precision: the threshold is the lowest one with this precision on them.
        training: steps, rate, seed.
    """

    num_pictures: int = 3200
    far_share: float = 0.6
    width_px: int = 320
    window_px: int = 160
    batch: int = 12
    num_judged: int = 150
    precision: float = 0.85
    training: TrainingConfig = field(default_factory=lambda: TrainingConfig(num_steps=5000, level_share=0.6))

    def __post_init__(self) -> None:
        step = CONFIG.step_px
        counts = (self.num_pictures, self.batch, self.num_judged, self.window_px)
        if min(counts) < 1 or self.window_px > self.width_px or self.window_px % step:
            raise SemlocError(
                f"learn obstacles: {self}; expected counts of at least 1 and windows whose width is a multiple of "
                f"{step} and at most width_px"
            )
        if not 0.0 < self.far_share < 1.0:
            raise SemlocError(f"learn obstacles: far_share {self.far_share:g}; expected 0 < far_share < 1")


class ShownObstacles(NamedTuple):
    """One picture and its truth.

    Attributes:
        picture: uint8[h w 3] of the cylinder of the network, blue green red.
        kinds: class of each thing.
        box: float64[n 4] [px].
        range_m: float64[n], from the camera.
        is_asked: bool[n], whether it has to be found.
    """

    picture: UInt8[np.ndarray, "h w 3"]
    kinds: tuple[str, ...]
    box: Float[np.ndarray, "n 4"]
    range_m: Float[np.ndarray, " n"]
    is_asked: np.ndarray


def taught(
    config: ObstacleLearningConfig,
    checkpoint: Path | None = None,
    on_step: Callable[[int, float], None] | None = None,
    begin_with: Path | None = None,
) -> DenseNet:
    """The trained network.

    Args:
        config: pictures and steps.
        checkpoint: file to go on from, and to write now and then.
        on_step: called with the number of a step and its loss.
        begin_with: weights of an earlier lesson; None begins with random ones.

    Raises:
        SemlocError: those weights are of another network.
    """
    network = begun(DenseNet.create(jax.random.key(config.training.seed), CONFIG), len(KINDS))
    if begin_with is not None:
        network = load_weights(begin_with, network)
    num_far = max(round(config.far_share * config.num_pictures), 1)
    far = CylinderPool(FAR, num_far, config.width_px, config.training.seed)
    near = CylinderPool(NEAR, max(config.num_pictures - num_far, 1), config.width_px, config.training.seed)

    def batch(rng: np.random.Generator) -> ObstacleBatch:
        pool = far if rng.random() < config.far_share else near
        return pool.batch(rng, config.batch, config.window_px)

    return train(network, obstacle_loss, batch, config.training, checkpoint, on_step)


def unseen_views(config: ObstacleLearningConfig) -> list[ShownObstacles]:
    """Random views that no lesson shows."""
    geometry = Geometry(PX_PER_RAD, config.width_px, SIZE_PX[1], HORIZON_V)
    return [shown(cylinder_sample(np.random.default_rng((UNSEEN_SEED, k)), geometry)) for k in range(config.num_judged)]


def shown(sample: CylinderSample) -> ShownObstacles:
    """A random view in the form in which drives are judged."""
    box = np.array([thing.box for thing in sample.things]).reshape(-1, 4)
    return ShownObstacles(
        sample.picture,
        tuple(thing.kind for thing in sample.things),
        box,
        np.array([thing.range_m for thing in sample.things]),
        np.array([is_asked(t) for t in sample.things], bool),
    )


def box_sets(
    net: ObstacleNet, pictures: Iterable[ShownObstacles], range_m: tuple[float, float]
) -> dict[str, list[BoxSet]]:
    """What was found and what is there, for each class.

    Args:
        net: what is judged.
        pictures: with their truth.
        range_m: only things at these ranges are asked for.
    """
    sets: dict[str, list[BoxSet]] = {kind: [] for kind in KINDS}
    for one in pictures:
        found = net(one.picture, _LEAST)
        near = (one.range_m >= range_m[0]) & (one.range_m < range_m[1])
        for number, kind in enumerate(KINDS):
            own, said = np.array([k == kind for k in one.kinds], bool), found.kind == number
            sets[kind].append(BoxSet(found.box[said], found.confidence[said], one.box[own], (one.is_asked & near)[own]))
    return sets


def judged(
    net: ObstacleNet, pictures: Iterable[ShownObstacles], range_m: tuple[float, float] = (0.0, np.inf)
) -> dict[str, BoxScore]:
    """Average precision at an overlap of 0.5, recall and precision at the threshold of the network, for each class."""
    sets = box_sets(net, pictures, range_m)
    return {kind: box_score(own, net.threshold) for kind, own in sets.items()}


def mean_precision(scores: dict[str, BoxScore]) -> float:
    """Mean of the average precisions of the classes that are there."""
    known = [score.average_precision for score in scores.values() if score.num_true]
    return float(np.mean(known)) if known else float("nan")


def threshold_of(network: DenseNet, pictures: Iterable[ShownObstacles], precision: float) -> float:
    """The lowest threshold with the precision over all classes, else the highest."""
    sets = [one for own in box_sets(ObstacleNet(network, 0.5), pictures, (0.0, np.inf)).values() for one in own]
    good = [t for t in _THRESHOLDS if box_score(sets, float(t)).precision >= precision]
    return round(float(min(good)) if good else float(_THRESHOLDS[-1]), 2)
