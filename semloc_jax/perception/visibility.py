"""Which classes of a map can be seen in masks (room: perception; host).

In: a class table and masks. Out: ClassVisibility for every map class.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from semloc_jax.perception.class_table import ClassTable
from semloc_jax.structs import ElementClass

_MOST_EMPTY = 0.5
"""Share of the masks that may show nothing: there are stretches without paint and signs. Ours."""
_FLOODED = 0.3
"""No landmark class covers more of one mask. Ours."""


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


def mask_problems(table: ClassTable, masks: Sequence[np.ndarray]) -> list[str]:
    """A sentence for masks of which too many show nothing, and for those that one class floods.

    Args:
        table: what the ids mean.
        masks: of a drive, spread over it.
    """
    ids = [list(channel.mask_ids) for channel in table.channels]
    counts = [np.bincount(np.asarray(mask).ravel(), minlength=256) for mask in masks]
    shares = np.array([[count[own].sum() / max(count.sum(), 1) for own in ids] for count in counts])
    problems = []
    num_empty = int((shares.sum(axis=1) == 0.0).sum()) if len(shares) else 0
    if num_empty > _MOST_EMPTY * len(masks):
        problems.append(
            f"{num_empty} of {len(masks)} masks are empty: they show no class of table {table.name}; look at them, the "
            "network may see other colours (swap_red_blue, mean, value_range) or a wrong --output may have been taken"
        )
    for channel, share in zip(table.channels, shares.T if len(shares) else (), strict=False):
        num_flooded = int((share > _FLOODED).sum())
        if num_flooded:
            problems.append(
                f"{num_flooded} of {len(masks)} masks are flooded: more than {100 * _FLOODED:.0f} % are "
                f"'{channel.name}', and landmarks are small; look at them, the network may not know such images"
            )
    return problems


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
