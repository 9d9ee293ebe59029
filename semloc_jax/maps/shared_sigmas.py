"""How far a map says that it may be off as a whole around a place (room: maps; host).

In: a map whose elements carry beliefs, as `semloc map` writes it. Out: SharedSigmas: standard deviations at any place.
"""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from semloc_jax.maps.beliefs import stated_belief
from semloc_jax.maps.elements import MapElement

_NEAREST = 5
"""Elements around a place that are asked; ours."""


class SharedSigmas:
    """The errors that all elements around a place share."""

    def __init__(
        self, elements: Iterable[MapElement], everywhere: tuple[float, float] = (0.0, 0.0), on_earth: bool = True
    ):
        """Elements that state none share no error.

        Args:
            elements: of a map.
            everywhere: what is known of the whole map beside: standard deviations of place [m] and direction [rad].
            on_earth: whether places are meant on the earth; in the map itself what the elements state is no error.

        Raises:
            SemlocError: a belief of the map cannot be read.
        """
        beliefs = ((element, stated_belief(element)) for element in (elements if on_earth else ()))
        told = [(e, b) for e, b in beliefs if b is not None and (b.sigma_place_m or b.sigma_turn_rad)]
        self._everywhere = everywhere
        self._tree = cKDTree([e.points[:, :2].mean(axis=0) for e, _ in told]) if told else None
        self._sigmas = np.array([(b.sigma_place_m, b.sigma_turn_rad) for _, b in told])

    def at(self, xy_map: Float[np.ndarray, " 2"]) -> tuple[float, float]:
        """Standard deviations of place [m] and direction [rad] of what is around a place of the map."""
        if self._tree is None:
            return self._everywhere
        near = self._tree.query(xy_map, k=[*range(1, min(_NEAREST, len(self._sigmas)) + 1)])[1]
        square = np.mean(np.square(self._sigmas[near]), axis=0) + np.square(self._everywhere)
        place_m, turn_rad = np.sqrt(square)
        return float(place_m), float(turn_rad)


def with_map_accuracy(
    covariance: Float[np.ndarray, "6 6"], map_sigma_m: float, map_sigma_rad: float
) -> Float[np.ndarray, "6 6"]:
    """Covariance of a pose on the earth, from that of the right tangent of the pose in a map.

    All that is near may be off by the same vector and turn: a drive cannot measure it.

    Args:
        covariance: of (x, y, z [m], roll, pitch, yaw [rad]).
        map_sigma_m: standard deviation of the place of what is near, in every direction [m].
        map_sigma_rad: of its direction.
    """
    return covariance + np.diag([map_sigma_m, map_sigma_m, map_sigma_m, 0.0, 0.0, map_sigma_rad]) ** 2
