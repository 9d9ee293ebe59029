"""What stands on a parking lot and must not be hit: classes, sizes, their ids in masks (room: perception; host).

In: a ClassTable. Out: mask ids of each class of obstacle. Sizes are those of products on sale, with their spread.
"""

from typing import NamedTuple

from semloc_jax.perception.class_table import ClassTable
from semloc_jax.structs import ElementClass


class ObstacleClass(NamedTuple):
    """Things of one kind.

    Args:
        words: names in class tables contain one of them.
        label: the map class, None for what maps do not hold.
        height_m: of its top over the road, and the standard deviation of that; None where it says nothing.
        depth_m: from its foot, as seen, to its middle, and the standard deviation of that.
        is_square: whether that is about half of its width, which one sees.
    """

    words: tuple[str, ...]
    label: ElementClass | None
    height_m: tuple[float, float] | None
    depth_m: tuple[float, float]
    is_square: bool


OBSTACLES = {
    "cone": ObstacleClass(("cone",), ElementClass.CONE, (0.7, 0.12), (0.18, 0.05), True),
    "pillar": ObstacleClass(("pillar", "column"), ElementClass.PILLAR, None, (0.3, 0.15), True),
    "ground_lock": ObstacleClass(("ground_lock", "parking_lock"), None, (0.35, 0.1), (0.1, 0.05), False),
    "no_parking_sign": ObstacleClass(("no_parking",), None, (0.8, 0.12), (0.2, 0.06), True),
}
"""Cones of 0.5 to 0.9 m on plates of 0.28 to 0.4 m; locks of 0.25 to 0.45 m, 0.08 m lowered; folding signs."""


def obstacle_ids(table: ClassTable) -> dict[str, tuple[int, ...]]:
    """Mask ids of each class of obstacle that the masks show; empty where they show none."""
    found = {}
    for name, kind in OBSTACLES.items():
        named = {number for number, word in table.id_names.items() if any(part in word for part in kind.words)}
        channel = -1 if kind.label is None else table.channel_of(kind.label)
        shown = set() if channel < 0 else set(table.channels[channel].mask_ids)
        ids = (named | shown) - set(table.unusable_ids)
        if ids:
            found[name] = tuple(sorted(ids))
    return found
