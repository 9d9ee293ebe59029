"""A network is taught by the map, in rounds (room: learning; host).

In: drives with their maps and the masks there are. Out: Eyes, and the score of each round on frames held out.

best masks so far -> poses -> the map, projected -> labels -> a network -> other masks -> ...
What the teacher gets wrong in every frame is learned for ever, since poses move with it: judge by frames held out.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from semloc_jax.alignment.pose_prior import PriorSource
from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_source import MaskSource, eyes_source
from semloc_jax.inputs.mask_view import resized
from semloc_jax.learning.eyes.batches import CropConfig, ImagePool, LabelledImage, draw_batch
from semloc_jax.learning.eyes.judge import RoundScore, judged
from semloc_jax.learning.eyes.labels import drawn_labels, with_kept
from semloc_jax.learning.eyes.loss import eyes_loss
from semloc_jax.learning.eyes.poses import TeacherLimits, TeacherPose, teacher_poses
from semloc_jax.learning.eyes.shapes import Surfaces, seen_surfaces
from semloc_jax.learning.eyes.streets import StreetsConfig
from semloc_jax.learning.eyes.trust import ElementLooks
from semloc_jax.learning.training import TrainingConfig, train
from semloc_jax.maps import SemanticMap
from semloc_jax.maps.elements import MapElement
from semloc_jax.perception import load_class_table
from semloc_jax.perception.border_distance import border_distances, pixel_unit
from semloc_jax.perception.network import NetworkSegmenter
from semloc_jax.perception.networks.eyes import Eyes, eyes_table, working_scale

_LOG = logging.getLogger(__name__)
_RADIUS_M = 80.0
_TRUST_REACH_PX = 20.0
TABLE = "drive"
"""The preset whose channels tell the classes of a map apart as finely as any."""


@dataclass(frozen=True)
class EyesConfig:
    """How eyes are taught. All values are ours."""

    rounds: int = 3
    """Networks that are taught, each by the poses that the one before found."""
    map_sigma_m: float = 0.03
    """How far an element may be from its place in the map, one standard deviation."""
    training: TrainingConfig = field(default_factory=lambda: TrainingConfig(num_steps=1500))
    crops: CropConfig = field(default_factory=CropConfig)
    limits: TeacherLimits = field(default_factory=TeacherLimits)
    streets: StreetsConfig = field(default_factory=StreetsConfig)
    """What is learned without any drive, from random streets (`--simulated`)."""
    judge_sigma_m: float = 1.0
    """Noise of the priors of frames held out, along and across."""
    judge_sigma_deg: float = 3.0

    def __post_init__(self) -> None:
        if self.rounds < 1 or min(self.map_sigma_m, self.judge_sigma_m, self.judge_sigma_deg) <= 0.0:
            raise SemlocError(f"eyes: {self}; expected rounds of at least 1 and sigmas above 0")


@dataclass(frozen=True)
class Lesson:
    """A drive to learn from or to be judged by.

    Attributes:
        drive: The drive.
        map: Its map.
        masks: What there is at the beginning.
        frames: In order of time.
        prior: First guess of a pose where satellites do not give it.
    """

    drive: Drive
    map: SemanticMap
    masks: MaskSource
    frames: tuple[Frame, ...]
    prior: PriorSource | None = None

    def seen_with(self, eyes: Eyes | None) -> MaskSource:
        """The masks of the eyes; those there are where there are no eyes yet."""
        return self.masks if eyes is None else eyes_source(eyes, self.drive, self.masks.cameras)


class Round(NamedTuple):
    """What came of one round.

    Args:
        eyes: The network; None for what there was at the beginning.
        score: On the frames held out.
        num_poses: Frames that taught it.
        num_distrusted: Elements of the maps that the frames deny.
    """

    eyes: Eyes | None
    score: RoundScore
    num_poses: int
    num_distrusted: int


def taught(
    lessons: Sequence[Lesson],
    held_out: Lesson,
    config: EyesConfig,
    folder: Path,
    on_round: Callable[[int, Round], None] | None = None,
    helper: NetworkSegmenter | None = None,
    begin: Eyes | None = None,
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

    Raises:
        SemlocError: no pose is good enough to teach, or the frames held out have no truth.
    """
    classes = frozenset(label for lesson in lessons for label in lesson.map.labels)
    table = eyes_table(load_class_table(TABLE), classes)
    eyes = begin or Eyes.new(table, config.training.seed, helper)
    rounds, labelled, by = [], None, -1
    for k in range(config.rounds + 1):
        num_poses, num_distrusted = labelled[1:] if labelled else (0, 0)
        taught_eyes = eyes if k else None
        rounds.append(Round(taught_eyes, _score(held_out, taught_eyes, config), num_poses, num_distrusted))
        if on_round is not None:
            on_round(k, rounds[-1])
        if k < config.rounds:
            best = best_round(rounds)
            if best != by:  # a round that was worse teaches nobody
                labelled, by = _labelled(lessons, rounds[best].eyes, eyes, config), best
            eyes = _trained(eyes, labelled[0], config, folder, k + 1)
    return rounds


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


def _labelled(
    lessons: Sequence[Lesson], eyes: Eyes | None, student: Eyes, config: EyesConfig
) -> tuple[list[LabelledImage], int, int]:
    """Labelled images for a student of every frame that may teach, how many frames, and how many elements are denied;
    `eyes` find the poses, None for what there was."""
    images: list[LabelledImage] = []
    num_poses = num_distrusted = 0
    for lesson in lessons:
        masks = lesson.seen_with(eyes)
        poses = teacher_poses(lesson.drive, lesson.map, masks, lesson.frames, lesson.prior, config.limits)
        trust = _trust(lesson, masks, poses, config)
        for pose in poses:
            images += _images_of(lesson, pose, trust, student, config)
        num_poses, num_distrusted = num_poses + len(poses), num_distrusted + trust.num_distrusted
    if not images:
        raise SemlocError(
            f"eyes: none of {sum(len(lesson.frames) for lesson in lessons)} frames has a pose good enough to teach "
            f"({config.limits}); expected masks that place at least some frames, or wider limits"
        )
    _LOG.info("%d frames teach with %d images; %d elements are denied", num_poses, len(images), num_distrusted)
    return images, num_poses, num_distrusted


def _trust(lesson: Lesson, masks: MaskSource, poses: Sequence[TeacherPose], config: EyesConfig) -> ElementLooks:
    """What the masks at hand say of every element, over all poses."""
    trust = ElementLooks()
    for pose in poses:
        seen_masks = masks.masks(pose.frame)
        unit_px = pixel_unit([mask.shape for mask in seen_masks])
        seen = border_distances(seen_masks, masks.table, _TRUST_REACH_PX)
        for k in range(len(masks.cameras)):
            elements, surfaces = _surfaces(lesson, pose, k, masks.cameras, config)
            trust.look(surfaces, elements, seen, k, masks.table, unit_px)
    return trust


def _images_of(
    lesson: Lesson, pose: TeacherPose, trust: ElementLooks, student: Eyes, config: EyesConfig
) -> list[LabelledImage]:
    """One labelled image for each camera of a frame."""
    found = []
    for k, camera in enumerate(lesson.masks.cameras):
        image, hidden = pose.frame.image(camera), pose.frame.dynamic_mask(camera)
        elements, surfaces = _surfaces(lesson, pose, k, lesson.masks.cameras, config)
        picture = student.picture(image)
        labels = drawn_labels(
            surfaces,
            elements,
            student.table,
            (image.shape[1], image.shape[0]),
            working_scale(image.shape[1]),
            trust.is_trusted(elements),
            None if hidden is None else resized(hidden, image[..., 0]),
        )
        if student.card:  # else it has not learned anything
            told = [bool(set(channel.classes) & set(lesson.map.labels)) for channel in student.table.channels]
            labels = with_kept(labels, told, student.said(picture))
        found.append(LabelledImage.of(picture, labels))
    return found


def _surfaces(
    lesson: Lesson, pose: TeacherPose, index: int, cameras: Sequence[str], config: EyesConfig
) -> tuple[tuple[MapElement, ...], Surfaces]:
    """Elements around a frame, and what one of its cameras sees of them."""
    rig = pose.frame.rig.select(tuple(cameras))
    elements = lesson.map.query(pose.T_map_base[:3, 3], _RADIUS_M).elements
    place = rig.cameras[index], pose.T_map_base, np.asarray(rig.T_base_cam)[index]
    return elements, seen_surfaces(elements, *place, pose.covariance, config.map_sigma_m)


def _trained(eyes: Eyes, images: Sequence[LabelledImage], config: EyesConfig, folder: Path, number: int) -> Eyes:
    """The eyes after a round; its weights and checkpoint are in the folder."""
    step_px, pool = eyes.config.step_px, ImagePool(images)

    def batch_of(rng: np.random.Generator):
        return draw_batch(pool, config.crops, step_px, rng)

    checkpoint = folder / f"round_{number}.checkpoint"
    network = train(eyes.network, eyes_loss, batch_of, config.training, checkpoint)
    taught_on = {"round": number, "images": len(images), "steps": config.training.num_steps}
    eyes = replace(eyes, network=network, card={"taught": taught_on})
    eyes.save(folder / f"round_{number}.weights")
    checkpoint.unlink(missing_ok=True)
    return eyes
