"""What the map tells of the frames of drives (room: learning; host).

In: drives with their maps and the masks there are. Out: labelled images, and the poses that they were drawn at.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from semloc_jax.alignment.pose_prior import PriorSource
from semloc_jax.cameras import Rig
from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_source import MaskSource, eyes_source
from semloc_jax.inputs.mask_view import resized
from semloc_jax.learning.eyes.batches import LabelledImage
from semloc_jax.learning.eyes.labels import drawn_labels, with_kept
from semloc_jax.learning.eyes.missing import PLACE_M, GroundLooks, drawn_missing
from semloc_jax.learning.eyes.poses import TeacherLimits, TeacherPose, teacher_poses
from semloc_jax.learning.eyes.shapes import Surfaces, seen_surfaces
from semloc_jax.learning.eyes.trust import ElementLooks
from semloc_jax.maps import SemanticMap
from semloc_jax.maps.elements import MapElement
from semloc_jax.perception.border_distance import border_distances, pixel_unit
from semloc_jax.perception.networks.eyes import Eyes, working_scale

_LOG = logging.getLogger(__name__)
_RADIUS_M = 80.0
_TRUST_REACH_PX = 20.0


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
        return self.masks if eyes is None else eyes_source(eyes, self.masks.cameras)


class Labelled(NamedTuple):
    """What teaches a round.

    Args:
        images: With their labels.
        poses: Frames that they are of, for each lesson.
        num_distrusted: Elements of the maps that the frames deny.
    """

    images: list[LabelledImage]
    poses: list[list[TeacherPose]]
    num_distrusted: int

    @property
    def num_poses(self) -> int:
        """Frames that teach."""
        return sum(len(own) for own in self.poses)


def labelled_by_map(
    lessons: Sequence[Lesson], eyes: Eyes | None, student: Eyes, limits: TeacherLimits, map_sigma_m: float
) -> Labelled:
    """What the map tells a student.

    Args:
        lessons: The drives.
        eyes: That find the poses; None for the masks there were.
        student: Whose classes are told.
        limits: Of the poses that may teach.
        map_sigma_m: How far an element may be from its place in the map, one standard deviation.

    Raises:
        SemlocError: no pose is good enough to teach.
    """
    images: list[LabelledImage] = []
    every: list[list[TeacherPose]] = []
    num_distrusted = 0
    for lesson in lessons:
        masks = lesson.seen_with(eyes)
        poses = teacher_poses(lesson.drive, lesson.map, masks, lesson.frames, lesson.prior, limits)
        doubts = _doubts(lesson, masks, poses, map_sigma_m)
        for pose in poses:
            images += _images_of(lesson, pose, doubts, student, map_sigma_m)
        every.append(poses)
        num_distrusted += doubts.elements.num_distrusted
        _LOG.info("%d places of %.1f m show paint that the map lacks", len(doubts.missing), PLACE_M)
    if not images:
        raise SemlocError(
            f"eyes: none of {sum(len(lesson.frames) for lesson in lessons)} frames has a pose good enough to teach "
            f"({limits}); expected masks that place at least some frames, or wider limits"
        )
    labelled = Labelled(images, every, num_distrusted)
    _LOG.info("%d frames teach with %d images; %d elements are denied", labelled.num_poses, len(images), num_distrusted)
    return labelled


class Doubts(NamedTuple):
    """Where the masks at hand contradict a map, over all poses.

    Args:
        elements: How often each was found.
        missing: Keys of places with paint that the map lacks.
    """

    elements: ElementLooks
    missing: np.ndarray


def _doubts(lesson: Lesson, masks: MaskSource, poses: Sequence[TeacherPose], map_sigma_m: float) -> Doubts:
    """What the masks at hand say of every element, and of paint beside them."""
    trust, ground = ElementLooks(), GroundLooks()
    for pose in poses:
        seen_masks = masks.masks(pose.frame)
        unit_px = pixel_unit([mask.shape for mask in seen_masks])
        seen = border_distances(seen_masks, masks.table, _TRUST_REACH_PX)
        rig = masks.seen_by(pose.frame.rig.select(masks.cameras))  # its pixels are those of the masks
        for k, camera in enumerate(rig.cameras):
            elements, surfaces = _surfaces(lesson, pose, rig, k, map_sigma_m)
            trust.look(surfaces, elements, seen, k, masks.table, unit_px)
            place = camera, pose.T_map_base, np.asarray(rig.T_base_cam)[k]
            ground.look(*place, seen_masks[k], seen.signed_px[k], seen.stride, masks.table)
    return Doubts(trust, ground.missing(lesson.map.elements))


def _images_of(
    lesson: Lesson, pose: TeacherPose, doubts: Doubts, student: Eyes, map_sigma_m: float
) -> list[LabelledImage]:
    """One labelled image for each camera of a frame."""
    found, rig = [], pose.frame.rig.select(lesson.masks.cameras)
    for k, camera in enumerate(lesson.masks.cameras):
        image, hidden = pose.frame.image(camera), pose.frame.dynamic_mask(camera)
        unknown = drawn_missing(doubts.missing, rig.cameras[k], pose.T_map_base, np.asarray(rig.T_base_cam)[k])
        if hidden is not None:
            unknown |= resized(hidden, image[..., 0])
        elements, surfaces = _surfaces(lesson, pose, rig, k, map_sigma_m)
        picture = student.picture(image)
        labels = drawn_labels(
            surfaces,
            elements,
            student.table,
            (image.shape[1], image.shape[0]),
            working_scale(image.shape[1]),
            doubts.elements.is_trusted(elements),
            unknown,
        )
        if student.card:  # else it has not learned anything
            told = [bool(set(channel.classes) & set(lesson.map.labels)) for channel in student.table.channels]
            labels = with_kept(labels, told, student.said(picture))
        found.append(LabelledImage.of(picture, labels))
    return found


def _surfaces(
    lesson: Lesson, pose: TeacherPose, rig: Rig, index: int, map_sigma_m: float
) -> tuple[tuple[MapElement, ...], Surfaces]:
    """Elements around a frame, and what a camera of a rig sees of them."""
    elements = lesson.map.query(pose.T_map_base[:3, 3], _RADIUS_M).elements
    place = rig.cameras[index], pose.T_map_base, np.asarray(rig.T_base_cam)[index]
    return elements, seen_surfaces(elements, *place, pose.covariance, map_sigma_m)
