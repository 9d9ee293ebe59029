"""Which elements hold a drive, and which of them nothing stands in for (room: analysis; host).

In: frames of a drive with masks and priors, a map. Out: an Explanation of each frame, the ElementRole of each element.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from semloc_jax.alignment.frame_localizer import FrameLocalizer, LocalizeConfig
from semloc_jax.alignment.pose_prior import PriorSource
from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.analysis.explain import ExplainConfig, explain_frame
from semloc_jax.analysis.explanation import Explanation, Holder
from semloc_jax.datasets import Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.maps import SemanticMap
from semloc_jax.structs import ElementClass

IRREPLACEABLE = 2.0
"""An element is irreplaceable if the sigma of a direction grows by this factor without it; our choice."""


@dataclass(frozen=True)
class ElementRole:
    """What one element does for a drive.

    Attributes:
        id: of the element.
        label: its class.
        num_frames: frames in which it is seen.
        share: of what holds the pose, the mean over all frames of the drive.
        most_share: the largest share that it has of any direction in any frame.
        most_share_at: number of that frame among those that were explained.
        most_moved_m: how far it moves the vehicle over the ground in the worst frame, wrong by `shift_m`.
        num_irreplaceable: frames in which nothing stands in for it.
    """

    id: str
    label: ElementClass
    num_frames: int
    share: float
    most_share: float
    most_share_at: int
    most_moved_m: float
    num_irreplaceable: int


def explain_frames(
    semantic_map: SemanticMap,
    masks: MaskSource,
    prior: PriorSource,
    frames: Sequence[Frame],
    settings: LocalizeConfig | None = None,
    config: ExplainConfig | None = None,
) -> Iterator[tuple[LocalizationResult, Explanation | None]]:
    """The result of each frame, and its explanation; None where it is not localized or its cost has no optimum."""
    localizer = FrameLocalizer(semantic_map, masks.table, settings)
    for frame in frames:
        rig = masks.seen_by(frame.rig.select(masks.cameras))
        given = (masks.masks(frame), prior(frame), rig)
        result, found = localizer.localize(frame, *given), None
        if result.localized:
            try:
                found = explain_frame(localizer, result, *given, config)
            except SemlocError:
                found = None
        yield result, found


def is_irreplaceable(holder: Holder, explanation: Explanation) -> bool:
    """Whether the sigma of a direction at least doubles without the holder."""
    return bool((holder.sigma_without >= IRREPLACEABLE * explanation.sigma).any())


def element_roles(explanations: Sequence[Explanation]) -> tuple[ElementRole, ...]:
    """The role of every element that was seen, those that hold most of the drive first."""
    seen: dict[str, list[tuple[int, Holder]]] = {}
    for index, explanation in enumerate(explanations):
        for holder in explanation.elements:
            seen.setdefault(holder.id, []).append((index, holder))
    roles = []
    for key, found in seen.items():
        most = max(found, key=lambda pair: pair[1].share.max())
        roles.append(
            ElementRole(
                key,
                found[0][1].label,
                len(found),
                sum(holder.strength for _, holder in found) / len(explanations),
                float(most[1].share.max()),
                most[0],
                max(float(np.hypot(*holder.shifted[:2])) for _, holder in found),
                sum(is_irreplaceable(holder, explanations[index]) for index, holder in found),
            )
        )
    return tuple(sorted(roles, key=lambda role: -role.share))
