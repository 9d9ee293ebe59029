"""Numbers painted in parking slots, each as one element (room: mapping; host).

In: marks on the road, parking slots. Out: the marks outside of slots, and one number for each slot that has marks.
Masks show a number as a low patch whose outline is that of no sign: it says where a number stands, and no camera is
laid by its border. What it reads is not known.
"""

from collections.abc import Sequence

import numpy as np
import shapely
from jaxtyping import Float

from semloc_jax.maps import Belief, MapElement
from semloc_jax.maps.elements import VIRTUAL
from semloc_jax.structs import ElementClass

SLOT_NUMBER = "slot_number"
"""Class of the feature in files."""
_LONGEST_M = 2.5
"""What is longer, over all pieces, is no number; ours."""
Known = tuple[MapElement, Belief]


def numbered(marks: Sequence[Known], slots: Sequence[Known]) -> tuple[list[Known], list[Known]]:
    """Marks that are none of a slot, and the numbers of slots: a box around the pieces, along the sides of the slot.

    Args:
        marks: marks on the road with their beliefs.
        slots: parking slots; the entrance between their first two corners.
    """
    if not marks or not slots:
        return list(marks), []
    middles = shapely.points([mark.points[:, :2].mean(axis=0) for mark, _ in marks])
    polygons = shapely.polygons([slot.points[:, :2] for slot, _ in slots])
    inside: dict[int, list[int]] = {}
    for mark, slot in zip(*shapely.STRtree(polygons).query(middles, predicate="within"), strict=True):
        inside.setdefault(int(slot), []).append(int(mark))
    taken: set[int] = set()
    numbers = []
    for slot, rows in sorted(inside.items()):
        points = np.concatenate([marks[row][0].points for row in rows])
        box = _box(points, slots[slot][0].points)
        if np.linalg.norm(box[2] - box[0]) > _LONGEST_M:
            continue
        taken.update(rows)
        best = max((marks[row][1] for row in rows), key=lambda belief: belief.existence_logit)
        words = {"class": SLOT_NUMBER, "slot": slots[slot][0].id}
        name = f"{SLOT_NUMBER}_{len(numbers)}"
        numbers.append(
            (MapElement(name, ElementClass.ROAD_MARK, box, closed=True, style=VIRTUAL, attributes=words), best)
        )
    return [mark for row, mark in enumerate(marks) if row not in taken], numbers


def _box(points: Float[np.ndarray, "k 3"], corners: Float[np.ndarray, "4 3"]) -> Float[np.ndarray, "4 3"]:
    """The box around points along the entrance of a slot."""
    along = corners[1, :2] - corners[0, :2]
    along = along / np.linalg.norm(along)
    axes = np.stack([along, [-along[1], along[0]]])
    low, high = (points[:, :2] @ axes.T).min(axis=0), (points[:, :2] @ axes.T).max(axis=0)
    sides = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    return np.column_stack([sides @ axes, np.full(4, points[:, 2].mean())])
