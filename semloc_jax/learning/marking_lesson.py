"""The whole lesson for marking points: pictures, training, judgement, threshold (room: learning; JAX and host).

In: SlotLearningConfig. Out: the trained network, its threshold and its scores on pictures it never saw.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import jax
import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.learning.marking_drives import ShownPoints
from semloc_jax.learning.marking_points import NOTHING, PointScore, TopViewPool, marking_loss, score
from semloc_jax.learning.sureness import UNSEEN_SEED, begun
from semloc_jax.learning.training import TrainingConfig, train
from semloc_jax.perception.networks.dense_net import DenseNet
from semloc_jax.perception.networks.marking_net import CONFIG, METRES_PER_PX, MarkingNet
from semloc_jax.perception.networks.weights import load_weights
from semloc_jax.simulation.top_views.picture import TopViewSample, top_view_sample

THRESHOLDS = (0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.7)


@dataclass(frozen=True)
class SlotLearningConfig:
    """How the network for marking points is taught.

    Args:
        num_pictures: random top views that are drawn, each taken in eight positions.
        size_px: side of them; a pixel is 5 cm.
        batch: pictures of one step.
        num_judged: random top views, of the size of a whole view, that judge.
        judged_px: side of those.
        precision: the threshold is the lowest one with this precision on them; they are harder than real lots.
        training: steps, rate, seed.
    """

    num_pictures: int = 8000
    size_px: int = 128
    batch: int = 16
    num_judged: int = 200
    judged_px: int = 192
    precision: float = 0.8
    training: TrainingConfig = field(default_factory=lambda: TrainingConfig(num_steps=10_000))

    def __post_init__(self) -> None:
        step = CONFIG.step_px
        if min(self.num_pictures, self.batch, self.num_judged) < 1 or self.size_px % step or self.judged_px % step:
            raise SemlocError(
                f"learn slots: {self}; expected counts of at least 1 and sides that are multiples of {step}"
            )


def taught(
    config: SlotLearningConfig,
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
    network = begun(DenseNet.create(jax.random.key(config.training.seed), CONFIG), 1)
    if begin_with is not None:
        network = load_weights(begin_with, network)
    pool = TopViewPool(config.num_pictures, config.size_px, config.training.seed)
    return train(network, marking_loss, lambda rng: pool.batch(rng, config.batch), config.training, checkpoint, on_step)


def unseen_pictures(config: SlotLearningConfig) -> list[ShownPoints]:
    """Random top views that no lesson shows."""
    drawn = (
        top_view_sample(np.random.default_rng((UNSEEN_SEED, k)), config.judged_px, METRES_PER_PX)
        for k in range(config.num_judged)
    )
    return [shown(sample) for sample in drawn]


def shown(sample: TopViewSample) -> ShownPoints:
    """A random top view in the form in which drives are judged."""
    uv_m = np.array([point.uv_m for point in sample.points]).reshape(-1, 2)
    return ShownPoints(sample.picture, uv_m, np.array([p.yaw_rad for p in sample.points]), sample.unasked)


def judged(
    network: DenseNet, pictures: Iterable[ShownPoints], thresholds: Sequence[float] = THRESHOLDS
) -> dict[float, PointScore]:
    """Score at each threshold.

    Args:
        network: what is judged.
        pictures: with their truth.
        thresholds: of the confidence.
    """
    net, scores = MarkingNet(network, min(thresholds)), dict.fromkeys(thresholds, NOTHING)
    for one in pictures:
        found = net(one.picture, METRES_PER_PX)
        for threshold in thresholds:
            kept = found.above(threshold)
            scores[threshold] = scores[threshold].plus(score(kept, one.uv_m, one.yaw_rad, METRES_PER_PX, one.unasked))
    return scores


def threshold_of(scores: dict[float, PointScore], precision: float) -> float:
    """The lowest threshold with the precision, else the one with the highest."""
    good = [threshold for threshold, own in scores.items() if own.precision >= precision]
    return min(good) if good else max(scores, key=lambda threshold: scores[threshold].precision)
