"""A network is taught by the map, in rounds (room: learning; host).

In: drives with their maps and the masks there are. Out: Eyes, and the score of each round on frames held out.

best masks so far -> poses -> the map, projected -> labels -> a network -> other masks -> ...
What the teacher gets wrong in every frame is learned for ever, since poses move with it: judge by frames held out.
"""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.learning.eyes.batches import CropConfig, ImagePool, LabelledImage, draw_batch
from semloc_jax.learning.eyes.judge import RoundScore, judged
from semloc_jax.learning.eyes.lessons import Labelled, Lesson, labelled_by_map
from semloc_jax.learning.eyes.loss import eyes_loss
from semloc_jax.learning.eyes.poses import TeacherLimits
from semloc_jax.learning.eyes.streets import StreetsConfig
from semloc_jax.learning.eyes.through import ThroughConfig, pose_sights, taught_through
from semloc_jax.learning.training import TrainingConfig, train
from semloc_jax.perception import load_class_table
from semloc_jax.perception.class_table import ClassTable
from semloc_jax.perception.network import NetworkSegmenter
from semloc_jax.perception.networks.eyes import Eyes, eyes_table

TABLE = "drive"
"""The preset whose channels tell the classes of a map apart as finely as any."""
_AGAIN = 0.3
"""Rate of a round over that of the one before it, which was worse than what both began with."""
Watched = Callable[[str, int], AbstractContextManager[Callable[[int, float], None] | None]]
"""Watches the steps of a lesson: told its name and their number, it gives what is told each step and its loss."""


def _unwatched(name: str, num_steps: int) -> AbstractContextManager[None]:
    return nullcontext()


@dataclass(frozen=True)
class EyesConfig:
    """How eyes are taught. All values are ours."""

    rounds: int = 3
    """Networks that are taught, each by the poses that the one before found."""
    map_sigma_m: float = 0.03
    """How far an element may be from its place in the map, one standard deviation."""
    training: TrainingConfig = field(default_factory=lambda: TrainingConfig(num_steps=1500))
    begin_share: float = 0.1
    """Rate of eyes that see already (`--begin`), over that of new ones: at 5e-4 a round made them worse, at 1.5e-4
    better."""
    crops: CropConfig = field(default_factory=CropConfig)
    limits: TeacherLimits = field(default_factory=TeacherLimits)
    streets: StreetsConfig = field(default_factory=StreetsConfig)
    """What is learned without any drive, from random streets (`--simulated`)."""
    through: ThroughConfig = field(default_factory=ThroughConfig)
    """The last lesson, for the pose itself; beside it as many steps more by labels alone are judged."""
    judge_sigma_m: float = 1.0
    """Noise of the priors of frames held out, along and across."""
    judge_sigma_deg: float = 3.0

    def __post_init__(self) -> None:
        sizes = self.map_sigma_m, self.judge_sigma_m, self.judge_sigma_deg, self.begin_share
        if self.rounds < 1 or min(sizes) <= 0.0:
            raise SemlocError(f"eyes: {self}; expected rounds of at least 1, sigmas and begin_share above 0")


class Round(NamedTuple):
    """What came of one round.

    Args:
        eyes: The network; None for what there was at the beginning.
        score: On the frames held out.
        num_poses: Frames that taught it.
        num_distrusted: Elements of the maps that the frames deny.
        lesson: What was learned by.
    """

    eyes: Eyes | None
    score: RoundScore
    num_poses: int
    num_distrusted: int
    lesson: str = "labels"


def taught(
    lessons: Sequence[Lesson],
    held_out: Lesson,
    config: EyesConfig,
    folder: Path,
    on_round: Callable[[int, Round], None] | None = None,
    helper: NetworkSegmenter | None = None,
    begin: Eyes | None = None,
    watched: Watched = _unwatched,
    on_labels: Callable[[Sequence[LabelledImage]], None] | None = None,
) -> list[Round]:
    """The rounds, what there was at the beginning first; `best_round` says which to keep.

    Args:
        lessons: To learn from.
        held_out: Frames that judge; none of them teaches.
        config: Rounds, steps, limits.
        folder: For checkpoints and the weights of each round.
        on_round: Called after each round.
        helper: Another network whose scores the eyes see: they are a small adapter on top of it then.
        begin: Eyes to go on with; None for new ones.
        watched: Watches the steps of every lesson.
        on_labels: Given what teaches, each time that it is made.

    Raises:
        SemlocError: no pose is good enough to teach, or the frames held out have no truth.
    """
    eyes = begin or Eyes.new(taught_table(lessons), config.training.seed, helper)
    rounds, labelled, by = [], Labelled([], [], 0), -1

    def add(eyes: Eyes | None, lesson: str = "labels") -> None:
        counts = labelled.num_poses, labelled.num_distrusted
        rounds.append(Round(eyes, _score(held_out, eyes, config), *counts, lesson))
        if on_round is not None:
            on_round(len(rounds) - 1, rounds[-1])

    for k in range(config.rounds + 1):
        add(eyes if k else None)
        if k < config.rounds:
            best = best_round(rounds)
            # A round that was worse teaches nobody and is taken back; eyes that began with nothing go on from it.
            eyes = rounds[best].eyes or begin or eyes
            if best != by:
                labelled = labelled_by_map(lessons, rounds[best].eyes, eyes, config.limits, config.map_sigma_m)
                by = best
                if on_labels is not None:
                    on_labels(labelled.images)
            training = _of_round(k, best, config, begin is not None)
            eyes = _trained(eyes, labelled.images, training, config, folder, f"round_{k + 1}", watched)
    if config.through.num_steps:
        eyes = rounds[best_round(rounds)].eyes or eyes
        more = replace(config.training, num_steps=config.through.num_steps, rate=config.through.rate)
        alone = _trained(eyes, labelled.images, more, config, folder, "labels_alone", watched)
        add(alone, "as many steps by labels alone")
        add(_for_the_pose(eyes, lessons, labelled, config, folder, watched), "through the solver")
    return rounds


def taught_table(lessons: Sequence[Lesson], begin: Eyes | None = None) -> ClassTable:
    """The classes that are told: those that eyes know already, else all of the maps."""
    if begin is not None:
        return begin.table
    return eyes_table(load_class_table(TABLE), frozenset(label for lesson in lessons for label in lesson.map.labels))


def _of_round(k: int, best: int, config: EyesConfig, sees: bool) -> TrainingConfig:
    """How the eyes of round `k` + 1 are trained: by other crops, and more gently after each round in vain."""
    share, training = config.begin_share * _AGAIN ** (k - best) if sees else 1.0, config.training
    return replace(training, seed=training.seed + k, rate=share * training.rate)


def _for_the_pose(
    eyes: Eyes, lessons: Sequence[Lesson], labelled: Labelled, config: EyesConfig, folder: Path, watched: Watched
) -> Eyes:
    """The eyes after the last lesson; its weights are in the folder."""
    drives = [
        pose_sights(poses, lesson.map, lesson.seen_with(eyes), eyes, config.through)
        for lesson, poses in zip(lessons, labelled.poses, strict=True)
    ]
    pool, checkpoint = ImagePool(labelled.images), folder / "through.checkpoint"
    with watched("through", config.through.num_steps) as on_step:
        parts = drives, pool, config.crops, config.through, config.training.seed
        eyes = taught_through(eyes, *parts, on_step, checkpoint)
    eyes.save(folder / "through.weights")
    checkpoint.unlink(missing_ok=True)
    return eyes


def best_round(rounds: Sequence[Round]) -> int:
    """The last round that was better than the best before it, in recall and in the median; 0 where none was."""
    best = 0
    for k, found in enumerate(rounds):
        if found.score.is_better_than(rounds[best].score):
            best = k
    return best


def _score(lesson: Lesson, eyes: Eyes | None, config: EyesConfig) -> RoundScore:
    noise = config.judge_sigma_m, config.judge_sigma_deg, config.training.seed
    return judged(lesson.drive, lesson.map, lesson.seen_with(eyes), lesson.frames, *noise)


def _trained(
    eyes: Eyes,
    images: Sequence[LabelledImage],
    training: TrainingConfig,
    config: EyesConfig,
    folder: Path,
    name: str,
    watched: Watched,
) -> Eyes:
    """The eyes after steps by labels; weights and checkpoint of that name are in the folder."""
    step_px, pool = eyes.config.step_px, ImagePool(images)

    def batch_of(rng: np.random.Generator):
        return draw_batch(pool, config.crops, step_px, rng)

    checkpoint = folder / f"{name}.checkpoint"
    with watched(name, training.num_steps) as on_step:
        network = train(eyes.network, eyes_loss, batch_of, training, checkpoint, on_step)
    taught_on = {"lesson": name, "images": len(images), "steps": training.num_steps}
    eyes = replace(eyes, network=network, card={"taught": taught_on})
    eyes.save(folder / f"{name}.weights")
    checkpoint.unlink(missing_ok=True)
    return eyes
