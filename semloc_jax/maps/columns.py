"""A whole map as arrays (room: maps; host).

In: elements, one after another. Out: Columns: all points stacked, and one row of numbers for each element.
What looks at every element of a large map looks at these: an element that is read from a file is forgotten again.
"""

from array import array
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from semloc_jax.maps.elements import MapElement
from semloc_jax.maps.io.features import feature_class
from semloc_jax.structs import ElementClass

_AT_ONCE, _POINTS_AT_ONCE = 4096, 65536


@dataclass(frozen=True)
class Columns:
    """Elements as arrays; n elements, p points.

    Attributes:
        ids: n names.
        names: class names of the GeoJSON layout, in the order in which they appear.
        name: `int16[n]`, place in `names`.
        label: `int16[n]`, value of the ElementClass.
        points: `float64[p 3]` in the map frame [m].
        start: `int64[n + 1]`: points of element k are `points[start[k]:start[k + 1]]`.
        sizes_m: `float64[n 3]`: width, radius, height.
        closed, has_height, is_solid, is_logical: `bool[n]`.
        assumed: number of elements for each size or position that the file does not state.
    """

    ids: list[str]
    names: list[str]
    name: np.ndarray
    label: np.ndarray
    points: np.ndarray
    start: np.ndarray
    sizes_m: np.ndarray
    closed: np.ndarray
    has_height: np.ndarray
    is_solid: np.ndarray
    is_logical: np.ndarray
    assumed: Counter[str]

    @classmethod
    def of(cls, elements: Iterable[MapElement]) -> "Columns":
        """Returns the columns of elements, which are taken one by one."""
        ids: list[str] = []
        names: dict[str, int] = {}
        words = array("d")
        blocks: list[np.ndarray] = [np.zeros((0, 3))]
        waiting: list[np.ndarray] = []
        assumed: Counter[str] = Counter()
        for e in elements:
            ids.append(e.id)
            name = names.setdefault(feature_class(e), len(names))
            flags = (e.closed, e.has_height, e.style == "solid", e.is_logical)
            words.extend((name, int(e.label), len(e.points), *flags, e.width_m, e.radius_m, e.height_m))
            assumed.update(e.attributes.get("assumed", []))
            waiting.append(e.points)
            if len(waiting) == _AT_ONCE:
                blocks.append(np.concatenate(waiting))
                waiting = []
        table = np.frombuffer(words, dtype=np.float64).reshape(-1, 10)
        return cls(
            ids=ids,
            names=list(names),
            name=table[:, 0].astype(np.int16),
            label=table[:, 1].astype(np.int16),
            points=np.concatenate([*blocks, *waiting]),
            start=np.concatenate([[0], np.cumsum(table[:, 2])]).astype(np.int64),
            sizes_m=table[:, 7:],
            closed=table[:, 3] > 0,
            has_height=table[:, 4] > 0,
            is_solid=table[:, 5] > 0,
            is_logical=table[:, 6] > 0,
            assumed=assumed,
        )

    def __len__(self) -> int:
        return len(self.ids)

    @cached_property
    def count(self) -> np.ndarray:
        """Number of points of each element, `int64[n]`."""
        return np.diff(self.start)

    @cached_property
    def owner(self) -> np.ndarray:
        """The element of each point, `int32[p]`."""
        return np.repeat(np.arange(len(self), dtype=np.int32), self.count)

    @cached_property
    def _step_m(self) -> np.ndarray:
        """From each point to the next of the same element, 0 at the last [m]."""
        step_m = np.zeros(len(self.points))
        for start in range(0, len(step_m) - 1, _POINTS_AT_ONCE):  # the differences of all would be held twice
            part = np.diff(self.points[start : start + _POINTS_AT_ONCE + 1], axis=0)
            step_m[start : start + len(part)] = np.linalg.norm(part, axis=1)
        step_m[self.start[1:] - 1] = 0.0
        return step_m

    @cached_property
    def longest_step_m(self) -> np.ndarray:
        """The longest way from one vertex to the next, not counting that which closes an outline, `float64[n]`."""
        return np.maximum.reduceat(self._step_m, self.start[:-1]) if len(self) else np.zeros(0)

    @cached_property
    def length_m(self) -> np.ndarray:
        """Length of each line, circumference of each outline, `float64[n]`."""
        length_m = np.bincount(self.owner, weights=self._step_m, minlength=len(self))
        back_m = np.linalg.norm(self.points[self.start[:-1]] - self.points[self.start[1:] - 1], axis=1)
        return length_m + np.where(self.closed, back_m, 0.0)

    @cached_property
    def middle(self) -> np.ndarray:
        """Mean of the points of each element, `float64[n 3]`."""
        sums = [np.bincount(self.owner, weights=axis, minlength=len(self)) for axis in self.points.T]
        return np.stack(sums, axis=1) / self.count[:, None]

    @cached_property
    def extent(self) -> np.ndarray:
        """Bounding box, `float64[2 3]`: minimum and maximum [m]; zeros for no elements."""
        if not len(self):
            return np.zeros((2, 3))
        return np.stack([self.points.min(axis=0), self.points.max(axis=0)])

    def has_label(self, labels: Iterable[ElementClass]) -> np.ndarray:
        """Whether each element is of one of the classes, `bool[n]`."""
        return np.isin(self.label, [int(label) for label in labels])

    def rings(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points of some elements in a row, outlines with their first point again, and whose each is.

        Args:
            rows: `int64[m]`.

        Returns:
            Points `float64[q 3]` and the place in `rows` of each, `int64[q]`.
        """
        count = self.count[rows] + self.closed[rows]
        whose = np.repeat(np.arange(len(rows)), count)
        place = np.arange(len(whose)) - np.repeat(np.cumsum(count) - count, count)
        return self.points[self.start[rows][whose] + place % self.count[rows][whose]], whose
