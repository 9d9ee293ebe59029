"""Whether a faulty map is, for all that masks show of it, the sound one moved as a whole (room: analysis; host).

In: both maps, the class table of the masks. Out: yes or no. Such a fault is a shift of the map, which nothing sees.
"""

import numpy as np

from semloc_jax.maps import SemanticMap
from semloc_jax.perception.class_table import ClassTable

WHY = "it moves all that masks show alike"
_ALIKE_M = 0.05
"""Elements that are moved by the same vector but for so much. Ours."""


def is_moved_alike(sound: SemanticMap, faulty: SemanticMap, table: ClassTable) -> bool:
    """Whether every element that masks show lies aside of its place by one vector; elements by their ids."""
    places = [
        {e.id: e.points.mean(axis=0) for e in m.elements if e.style != "virtual" and table.channel_of(e.label) >= 0}
        for m in (sound, faulty)
    ]
    if not places[0] or places[0].keys() != places[1].keys():
        return False
    shift_m = np.array([places[1][key] - place for key, place in places[0].items()])
    mean_m = shift_m.mean(axis=0)
    return bool(np.linalg.norm(mean_m) > _ALIKE_M and (np.linalg.norm(shift_m - mean_m, axis=1) < _ALIKE_M).all())
