"""Which classes of a map can be seen in masks (room: perception; host).

In: a class table and masks. Out: ClassVisibility for every map class.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from semloc_jax.perception.class_table import ClassTable
from semloc_jax.structs import ElementClass


@dataclass(frozen=True)
class ClassVisibility:
    """How a map class shows in masks.

    Args:
        label: the class.
        channel: name of the channel that shows it; empty where the table has none.
        share: share of all pixels in that channel.
        frames: share of the masks in which the channel occurs.
    """

    label: ElementClass
    channel: str
    share: float
    frames: float

    @property
    def is_seen(self) -> bool:
        """Whether the masks hold pixels of it."""
        return self.share > 0.0


def visibility(table: ClassTable, masks: Iterable[np.ndarray]) -> list[ClassVisibility]:
    """What the masks can see of every map class, in the order of the classes."""
    counts = np.zeros(256, np.int64)
    present = np.zeros(256, np.int64)
    num = 0
    for mask in masks:
        found = np.bincount(mask.ravel(), minlength=256)
        counts += found
        present += found > 0
        num += 1
    total = max(int(counts.sum()), 1)
    rows = []
    for label in ElementClass:
        index = table.channel_of(label)
        if index < 0:
            rows.append(ClassVisibility(label, "", 0.0, 0.0))
            continue
        ids = list(table.channels[index].mask_ids)
        in_frames = float(present[ids].max()) / max(num, 1)
        rows.append(ClassVisibility(label, table.channels[index].name, float(counts[ids].sum()) / total, in_frames))
    return rows


def visibility_text(
    rows: Iterable[ClassVisibility], table_name: str, in_map: Mapping[ElementClass, int] | None = None
) -> str:
    """The report as a table; with the number of elements of each class of a map, only those classes.

    Args:
        rows: from `visibility`.
        table_name: for the words.
        in_map: number of elements of each class in a map.
    """
    lines = [f"{'map class':<16}{'channel':<16}{'pixels':>9}{'frames':>9}" + (f"{'in map':>9}" if in_map else "")]
    for row in rows:
        count = 0 if in_map is None else in_map.get(row.label, 0)
        if in_map is not None and not count:
            continue
        name = row.label.name.lower()
        shown = f"{100 * row.share:8.3f}%{100 * row.frames:8.0f}%" if row.channel else f"{'':>9}{'':>9}"
        word = row.channel or "not in the table"
        lines.append(f"{name:<16}{word:<16}{shown}" + (f"{count:>9}" if in_map else ""))
    seen = [row for row in rows if row.is_seen and (in_map is None or in_map.get(row.label))]
    names = ", ".join(row.label.name.lower() for row in seen)
    of_what = f"masks of class table {table_name}" + (" of this map" if in_map else "")
    lines.append(f"seen in the {of_what}: {names or 'nothing'}")
    return "\n".join(lines)
