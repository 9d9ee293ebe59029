"""Numbers painted in parking slots, each as one element (room: mapping; host).

In: marks on the road, parking slots, looks at marks. Out: the marks outside of slots, and the numbers in slots.
Masks show a number as a low patch whose outline is that of no sign: it says where a number stands, and no camera is
laid by its border. What it reads is not known. All slots of one type are painted with one stencil: where it stands in
them is told by the looks at all of them together, and a slot has a number where its own looks show something there.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Float
from scipy.ndimage import binary_closing, gaussian_filter, label

from semloc_jax.mapping.row_lines import PaintAt
from semloc_jax.mapping.slot_rows import MappedRow
from semloc_jax.maps import Belief, MapElement
from semloc_jax.maps.elements import VIRTUAL
from semloc_jax.structs import ElementClass

SLOT_NUMBER = "slot_number"
"""Class of the feature in files."""
_LONGEST_M = 2.5
"""What is longer, over all pieces, is no number; ours."""
_STEP_M, _GAP_M = 0.04, 0.2
"""Between the places in a slot that are looked at, and the widest gap between characters; ours."""
_RIM_M = 0.15
"""So near to its lines nothing else is painted in a slot; ours."""
_FEWEST = 3
"""Slots that make a stencil; ours."""
_LEAST_SHARE, _CLEAR, _OWN_PART = 0.05, 4.0, 0.25
"""Share of the looks that must show a stencil, how many times that of bare road, and part of it from which a slot has
one of its own; ours."""
Known = tuple[MapElement, Belief]


def outside_of_rows(marks: Sequence[Known], rows: Sequence[MappedRow]) -> list[Known]:
    """The marks that are no pieces of numbers of slots that were not found.

    Behind the entrance of a row nothing but numbers is painted: arrows are in the aisle. A slot on which a vehicle
    stood, or whose dividers were not seen, shows parts of its number all the same, each with the outline of no sign.

    Args:
        marks: marks on the road with their beliefs, without those of slots.
        rows: of slots; the first and the last divider may be those beside slots that were not found.
    """
    return [mark for mark in marks if not any(_is_behind(mark[0], row) for row in rows)]


def _is_behind(mark: MapElement, row: MappedRow) -> bool:
    """Whether a mark no longer than a number lies behind the entrance of a row, up to a slot beside its dividers."""
    xy = mark.points[:, :2]
    if len(row.places) < 2 or np.linalg.norm(np.ptp(xy, axis=0)) > _LONGEST_M:
        return False
    at_m = np.array([place.s_m for place in row.places])
    beside_m = float(np.median(np.diff(at_m)))
    s_m, t_m = row.inside(xy)
    low_m, high_m = at_m[0] - beside_m, at_m[-1] + beside_m
    return bool(
        t_m.min() > 0.0 and t_m.max() < (row.depth_m or _LONGEST_M) and low_m < s_m.min() and s_m.max() < high_m
    )


class _Frame(NamedTuple):
    """A slot seen from the middle of its entrance."""

    middle: Float[np.ndarray, " 2"]
    along: Float[np.ndarray, " 2"]
    inward: Float[np.ndarray, " 2"]
    width_m: float
    depth_m: float

    @classmethod
    def of(cls, slot: MapElement) -> "_Frame":
        corners = slot.points[:, :2]
        step, inward = corners[1] - corners[0], corners[2] - corners[1]
        width_m, depth_m = float(np.linalg.norm(step)), float(np.linalg.norm(inward))
        return cls(0.5 * (corners[0] + corners[1]), step / width_m, inward / depth_m, width_m, depth_m)

    def at(self, u_m: Float[np.ndarray, " k"], v_m: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k 2"]:
        """Places so far along the entrance and behind it."""
        return self.middle + u_m[:, None] * self.along + v_m[:, None] * self.inward


class _Stencil(NamedTuple):
    """Where numbers stand in the slots of one type."""

    low_m: Float[np.ndarray, " 2"]
    high_m: Float[np.ndarray, " 2"]
    """Along the entrance from its middle, and behind it."""
    shares: Float[np.ndarray, " n"]
    """Share of the looks into it that show something, of each slot."""


def numbered(
    marks: Sequence[Known], slots: Sequence[Known], paint_at: PaintAt | None = None
) -> tuple[list[Known], list[Known]]:
    """Marks that are none of a slot, and the numbers of slots: boxes along the sides of the slot.

    Args:
        marks: marks on the road with their beliefs.
        slots: parking slots; the entrance between their first two corners.
        paint_at: looks at marks; None where there are none but the marks: a number then is the box around the pieces.
    """
    boxes = {} if paint_at is None else _boxes(slots, paint_at)
    inside = _inside(marks, slots)
    taken: set[int] = set()
    numbers = []
    for row in sorted({*boxes, *inside}):
        slot, belief = slots[row]
        own = inside.get(row, [])
        points = np.concatenate([marks[k][0].points for k in own]) if own else np.zeros((0, 3))
        box = boxes.get(row)
        around = _box(points, slot.points) if own else None
        if around is not None and np.linalg.norm(around[2] - around[0]) > _LONGEST_M:
            around, own = None, []
        if box is None and around is None:
            continue
        taken.update(own)
        best = max((marks[k][1] for k in own), key=lambda b: b.existence_logit, default=belief)
        words = {"class": SLOT_NUMBER, "slot": slot.id}
        shape = box if box is not None else around
        name = f"{SLOT_NUMBER}_{len(numbers)}"
        numbers.append(
            (MapElement(name, ElementClass.ROAD_MARK, shape, closed=True, style=VIRTUAL, attributes=words), best)
        )
    return [mark for row, mark in enumerate(marks) if row not in taken], numbers


def _inside(marks: Sequence[Known], slots: Sequence[Known]) -> dict[int, list[int]]:
    """Marks in each slot."""
    if not marks or not slots:
        return {}
    middles = shapely.points([mark.points[:, :2].mean(axis=0) for mark, _ in marks])
    polygons = shapely.polygons([slot.points[:, :2] for slot, _ in slots])
    found: dict[int, list[int]] = {}
    for mark, slot in zip(*shapely.STRtree(polygons).query(middles, predicate="within"), strict=True):
        found.setdefault(int(slot), []).append(int(mark))
    return found


def _boxes(slots: Sequence[Known], paint_at: PaintAt) -> dict[int, Float[np.ndarray, "4 3"]]:
    """Outline of the number of each slot whose looks show one where its type has it."""
    found = {}
    for kind in sorted({str(slot.attributes.get("kind", "")) for slot, _ in slots}):
        rows = [k for k, (slot, _) in enumerate(slots) if str(slot.attributes.get("kind", "")) == kind]
        frames = [_Frame.of(slots[k][0]) for k in rows]
        stencil = _stencil(frames, paint_at) if len(frames) >= _FEWEST else None
        if stencil is None:
            continue
        least = max(_LEAST_SHARE, _OWN_PART * float(np.median(stencil.shares)))
        (u0, v0), (u1, v1) = stencil.low_m, stencil.high_m
        for k, frame, share in zip(rows, frames, stencil.shares, strict=True):
            if share >= least:
                xy = frame.at(np.array([u0, u1, u1, u0]), np.array([v0, v0, v1, v1]))
                found[k] = np.column_stack([xy, np.full(4, slots[k][0].points[:, 2].mean())])
    return found


def _stencil(frames: Sequence[_Frame], paint_at: PaintAt) -> _Stencil | None:
    """Where most slots show something that others of their type show, too; None where there is nothing."""
    half_m = 0.5 * min(frame.width_m for frame in frames) - _RIM_M
    u_m = np.arange(-half_m, half_m, _STEP_M)
    v_m = np.arange(_RIM_M, min(frame.depth_m for frame in frames) - _RIM_M, _STEP_M)
    if len(u_m) < 2 or len(v_m) < 2:
        return None
    v, u = np.meshgrid(v_m, u_m, indexing="ij")
    looks = [paint_at(frame.at(u.ravel(), v.ravel())) for frame in frames]
    weight, shown = (np.array(part).reshape(len(frames), *u.shape) for part in zip(*looks, strict=True))
    looked = gaussian_filter(weight.sum(axis=0), 1.0)
    share = np.divide(gaussian_filter(shown.sum(axis=0), 1.0), looked, out=np.zeros(u.shape), where=looked > 0.0)
    peak = np.unravel_index(int(share.argmax()), share.shape)
    if share[peak] < max(_LEAST_SHARE, _CLEAR * float(np.median(share))):
        return None
    level = np.median(share[share > 0.5 * share[peak]])
    patches, _ = label(_closed(share > 0.5 * level))
    patch = patches == patches[peak]
    if np.hypot(*np.ptp(np.argwhere(patch), axis=0)) * _STEP_M > _LONGEST_M:
        return None
    box = np.argwhere(patch)
    (v0, u0), (v1, u1) = box.min(axis=0), box.max(axis=0)
    inner = np.s_[:, v0 : v1 + 1, u0 : u1 + 1]
    total = weight[inner].sum(axis=(1, 2))
    shares = np.divide(shown[inner].sum(axis=(1, 2)), total, out=np.zeros(len(frames)), where=total > 0.0)
    return _Stencil(np.array([u_m[u0], v_m[v0]]), np.array([u_m[u1], v_m[v1]]), shares)


def _closed(shows: np.ndarray) -> np.ndarray:
    """A patch without the gaps between its characters."""
    reach = round(0.5 * _GAP_M / _STEP_M)
    wide = np.pad(shows, reach)
    return binary_closing(wide, np.ones((2 * reach + 1, 2 * reach + 1)))[reach:-reach, reach:-reach]


def _box(points: Float[np.ndarray, "k 3"], corners: Float[np.ndarray, "4 3"]) -> Float[np.ndarray, "4 3"]:
    """The box around points along the entrance of a slot."""
    along = corners[1, :2] - corners[0, :2]
    along = along / np.linalg.norm(along)
    axes = np.stack([along, [-along[1], along[0]]])
    low, high = (points[:, :2] @ axes.T).min(axis=0), (points[:, :2] @ axes.T).max(axis=0)
    sides = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    return np.column_stack([sides @ axes, np.full(4, points[:, 2].mean())])
