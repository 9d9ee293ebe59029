"""How far a map says that it may be off as a whole around a place (room: maps; host).

In: a map whose elements carry beliefs, as `semloc map` writes it. Out: SharedSigmas: standard deviations at any place.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from semloc_jax.maps.beliefs import BeliefMap
from semloc_jax.maps.semantic_map import SemanticMap

_NEAREST = 5
"""Elements around a place that are asked; ours."""


class SharedSigmas:
    """The errors that all elements around a place share."""

    def __init__(self, semantic_map: SemanticMap, everywhere: tuple[float, float] = (0.0, 0.0)):
        """Elements that state none share no error.

        Args:
            semantic_map: any map.
            everywhere: what is known of the whole map beside: standard deviations of place [m] and direction [rad].

        Raises:
            SemlocError: a belief of the map cannot be read.
        """
        beliefs = BeliefMap.of(semantic_map).beliefs
        told = [e for e in semantic_map.walk() if beliefs[e.id].sigma_place_m or beliefs[e.id].sigma_turn_rad]
        self._everywhere = everywhere
        self._tree = cKDTree([e.points[:, :2].mean(axis=0) for e in told]) if told else None
        self._sigmas = np.array([(beliefs[e.id].sigma_place_m, beliefs[e.id].sigma_turn_rad) for e in told])

    def at(self, T_map_base: Float[np.ndarray, "4 4"]) -> tuple[float, float]:
        """Standard deviations of place [m] and direction [rad] of what is around a pose."""
        if self._tree is None:
            return self._everywhere
        near = self._tree.query(T_map_base[:2, 3], k=[*range(1, min(_NEAREST, len(self._sigmas)) + 1)])[1]
        square = np.mean(np.square(self._sigmas[near]), axis=0) + np.square(self._everywhere)
        place_m, turn_rad = np.sqrt(square)
        return float(place_m), float(turn_rad)
