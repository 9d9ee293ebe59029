"""Whether an explanation is true: the whole localization again, in a map that was changed (room: analysis; host).

In: an Explanation, and what it was made of. Out: ElementEffect: what moving and leaving out an element did to the pose.
"""

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.analysis.expected import TANGENT_OF_DIRECTION
from semloc_jax.analysis.explanation import Explanation, Holder
from semloc_jax.cameras import Rig
from semloc_jax.geometry import rigid
from semloc_jax.maps import MapElement


@dataclass(frozen=True)
class ElementEffect:
    """What `localize` says in a changed map; NaN where it finds no pose.

    Attributes:
        holder: the element that was changed, with the prediction.
        shifted: longitudinal, lateral [m] and heading [rad] by which the pose moved with the element shifted.
        removed: the same with the element left out.
        is_localized: whether both poses may be used.
    """

    holder: Holder
    shifted: Float[np.ndarray, "3"]
    removed: Float[np.ndarray, "3"]
    is_localized: bool


def leave_one_out(
    localizer: FrameLocalizer,
    result: LocalizationResult,
    masks: Sequence[np.ndarray],
    prior: PosePrior,
    rig: Rig,
    explanation: Explanation,
    count: int,
) -> Iterator[ElementEffect]:
    """The effect of each change, one after another, for the strongest elements of a frame.

    Args:
        localizer: What localized the frame.
        result: Its pose.
        masks: Its masks.
        prior: Its prior.
        rig: Cameras of the masks.
        explanation: What is checked.
        count: How many elements.
    """
    for holder in explanation.elements[:count]:
        step = explanation.shift_m * holder.worst_map
        moved, found = [], []
        for change in (lambda element, step=step: [_shifted(element, step)], lambda _: []):
            again = _in_changed_map(localizer, holder.id, change).localize(result.frame, masks, prior, rig)
            found.append(again.localized)
            T = again.T_map_base
            known = np.isfinite(T).all()
            moved.append(rigid.log(rigid.inverse(result.T_map_base) @ T) if known else np.full(6, np.nan))
        yield ElementEffect(holder, *(xi[TANGENT_OF_DIRECTION] for xi in moved), all(found))


def _in_changed_map(localizer: FrameLocalizer, id: str, change) -> FrameLocalizer:
    """The localizer in its map with one element replaced by others; nothing is compiled anew."""
    elements = [new for old in localizer.map.elements for new in (change(old) if old.id == id else [old])]
    changed = copy.copy(localizer)
    changed.map = localizer.map.with_elements(elements)
    return changed


def _shifted(element: MapElement, step: Float[np.ndarray, "3"]) -> MapElement:
    return element.with_points(element.points + step)
