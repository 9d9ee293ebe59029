"""The seed article's rule as a baseline: replace within 5 m if more confident (room: mapping; host).

In: packed drives. Out: the map that this rule keeps. Nothing is aligned, nothing fused, nothing ever goes.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from semloc_jax.evaluation.map_shapes import kind_of
from semloc_jax.mapping.crowd.sights import sights_of
from semloc_jax.maps import Belief, MapElement, SemanticMap
from semloc_jax.maps.elements import GeoOrigin
from semloc_jax.maps.io.packed_drive import PackedDrive

_REACH_M = 5.0


def replaced(drives: Sequence[PackedDrive], origin: GeoOrigin | None) -> SemanticMap:
    """The map after each drive in turn has replaced the nearest element of its class, by centroids."""
    held: list[tuple[MapElement, Belief]] = []
    for drive in drives:
        sights = sights_of(drive, origin)
        for new in [*zip(sights.things.elements, sights.things.beliefs, strict=True), *sights.lines]:
            row = _nearest(new[0], held)
            if row is None:
                held.append(new)
            elif new[1].existence_logit > held[row][1].existence_logit:
                held[row] = new
    return SemanticMap(tuple(replace(e, id=str(k)) for k, (e, _) in enumerate(held)), origin, "replaced")


def _nearest(element: MapElement, held: Sequence[tuple[MapElement, Belief]]) -> int | None:
    """Place of the nearest element of the class within reach."""
    rows = [k for k, (e, _) in enumerate(held) if kind_of(e) == kind_of(element)]
    if not rows:
        return None
    middle = element.points[:, :2].mean(axis=0)
    apart = np.linalg.norm(np.array([held[k][0].points[:, :2].mean(axis=0) for k in rows]) - middle, axis=1)
    return rows[int(apart.argmin())] if apart.min() < _REACH_M else None
