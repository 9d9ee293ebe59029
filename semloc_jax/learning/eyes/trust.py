"""Which elements of the map the frames agree with (room: learning; host).

In: surfaces of elements in images, distances that the masks at hand tell. Out: looks and agreements of each element.
"""

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from semloc_jax.learning.eyes.shapes import Surfaces
from semloc_jax.maps.elements import MapElement
from semloc_jax.perception.border_distance import BorderDistances
from semloc_jax.perception.class_table import ClassTable

_NOISE_PX = 2.0
"""Of a border in a mask."""
_SIGMAS = 3.0
_LEAST_LOOKS = 5
"""An element is trusted until so many frames had it in view."""
_LEAST_SHARE = 0.15
"""And after that while so many of them agree with it: a post that is found in every sixth frame stands."""
_MOST_RANGE_M = 30.0


class ElementLooks:
    """Counts over frames, by the id of the element."""

    def __init__(self) -> None:
        self.looks: dict[str, int] = defaultdict(int)
        self.agreed: dict[str, int] = defaultdict(int)

    def look(
        self,
        surfaces: Surfaces,
        elements: Sequence[MapElement],
        seen: BorderDistances,
        camera: int,
        table: ClassTable,
        unit_px: float,
    ) -> None:
        """Count a frame of one camera.

        Args:
            surfaces: Of elements in its image.
            elements: The elements.
            seen: What the masks show.
            camera: Place of the camera in it.
            table: Class table of the masks; classes that it does not know are not judged.
            unit_px: Pixels that stand for one of a usual image.
        """
        _, _, rows, columns = seen.signed_px.shape
        cells = np.round((surfaces.uv.mean(axis=1) + 0.5) / seen.stride - 0.5).astype(int)
        inside = ((cells >= 0) & (cells < (columns, rows))).all(axis=1) & (surfaces.distance_m < _MOST_RANGE_M)
        for index in np.unique(surfaces.element[inside]):
            channel = table.channel_of(elements[index].label)
            if channel < 0:
                continue
            own = np.flatnonzero(inside & (surfaces.element == index))
            # The middle of a piece is inside of its class, or less than a few sigmas beside.
            distance = seen.signed_px[camera, channel, cells[own, 1], cells[own, 0]]
            limit = _SIGMAS * np.hypot(_NOISE_PX * unit_px, surfaces.sigma_px[own].max(axis=1))
            self.looks[elements[index].id] += 1
            self.agreed[elements[index].id] += int(np.mean(distance < limit) >= 0.5)

    def is_trusted(self, elements: Sequence[MapElement]) -> np.ndarray:
        """Whether each element may teach."""
        return np.array([not self._is_denied(element.id) for element in elements], bool)

    @property
    def num_distrusted(self) -> int:
        """Elements that the frames deny."""
        return sum(self._is_denied(key) for key in list(self.looks))

    def _is_denied(self, key: str) -> bool:
        looks = self.looks.get(key, 0)
        return looks >= _LEAST_LOOKS and self.agreed[key] < _LEAST_SHARE * looks
