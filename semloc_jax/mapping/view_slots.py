"""Parking slots of one top view by itself, without cameras, masks or a way (room: mapping; host).

In: marking points of a picture. Out: ViewSlot: type, corners, confidence.
The frame is that of a car that drives up the picture: x up, y to the left, from the middle of the picture [m].
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.mapping.evidence_grid import EvidenceGrid
from semloc_jax.mapping.point_dividers import by_their_rows, in_view, painted_dividers
from semloc_jax.mapping.slot_sights import in_rows, upright
from semloc_jax.mapping.slots import SlotConfig, find_slots
from semloc_jax.maps import Belief
from semloc_jax.perception.networks.marking_net import MarkingPoints

_SIGMA_M = 0.1
_SURE = (1e-6, 1.0 - 1e-6)


class ViewSlot(NamedTuple):
    """One parking slot in a top view."""

    kind: str
    """perpendicular, parallel or angled."""
    corners: Float[np.ndarray, "4 2"]
    """Both ends of the entrance, the slot on the left of the way from one to the other, then the back [m]."""
    confidence: float
    """Of the less sure one of its two marking points."""


def slots_of_view(
    points: MarkingPoints, side_px: tuple[int, int], metres_per_px: float, config: SlotConfig
) -> list[ViewSlot]:
    """The slots between the marking points of a top view.

    Args:
        points: of the picture; those at its rim do not count.
        side_px: width and height of the picture.
        metres_per_px: size of its pixels.
        config: what makes a slot; it has to assume depths, which a picture of entrances does not show.
    """
    inside = in_view(points.uv, side_px)
    uv, yaw, sure = points.uv[inside], points.yaw_rad[inside], np.clip(points.confidence[inside], *_SURE)
    inward = -np.stack([np.sin(yaw), np.cos(yaw)], axis=1)
    places = in_metres(uv, side_px, metres_per_px)
    dividers = painted_dividers(places, by_their_rows(places, inward, config), 0.0, config)
    logits = np.log(sure / (1.0 - sure))
    beliefs = {d.id: Belief(_SIGMA_M, _SIGMA_M, float(own)) for d, own in zip(dividers, logits, strict=True)}
    found = find_slots([], beliefs, np.zeros((1, 2)), EvidenceGrid(1.0), config, dividers)
    logit_of = {element.id: belief.existence_logit for element, belief in found}
    elements = upright([element for element, _ in found], [], config)
    slots = []
    for element, mouth in zip(elements, in_rows(elements), strict=True):
        depth = (element.points[[2, 3]] - element.points[[1, 0]])[:, :2]
        corners = np.concatenate([mouth, mouth[::-1] + depth])
        slots.append(ViewSlot(element.attributes["kind"], corners, 1.0 / (1.0 + np.exp(-logit_of[element.id]))))
    return slots


def in_metres(uv: Float[np.ndarray, "n 2"], side_px: tuple[int, int], metres_per_px: float) -> Float[np.ndarray, "n 2"]:
    """Places of pixels of a top view [m]."""
    return metres_per_px * (0.5 * (np.array(side_px) - 1.0) - uv)[:, ::-1]


def in_pixels(xy: Float[np.ndarray, "n 2"], side_px: tuple[int, int], metres_per_px: float) -> Float[np.ndarray, "n 2"]:
    """Pixels of places in a top view."""
    return 0.5 * (np.array(side_px) - 1.0) - xy[:, ::-1] / metres_per_px
