"""One frame that can be held against the map at any pose (room: localization; host).

In: FrameFeatures, a FrameAligner, what is known of the frame beside its pose. Out: Alignment, costs at other poses.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.cameras import Rig
from semloc_jax.errors import SemlocError
from semloc_jax.localization import health
from semloc_jax.localization.frame_alignment import Alignment, FrameAligner
from semloc_jax.localization.health import HealthConfig
from semloc_jax.localization.map_window import MapWindow
from semloc_jax.localization.track_state import FrameFeatures, TrackerState
from semloc_jax.maps import RoadSpread


class Answer(NamedTuple):
    """What a frame says near a pose."""

    found: Alignment
    is_occluded: bool
    reasons: tuple[str, ...]
    """Why it is of no use; none: it is."""


@dataclass(frozen=True)
class FrameInMap:
    """A frame with the map and everything but the pose that a comparison of the two needs.

    Poses are T_map_base float64[4 4]; where the map has no road, there is no answer.

    Attributes:
        frame: what the cameras show.
        aligner: the map.
        trust: weights of the elements of the map that rows name.
        state: how the vehicle stands on the road, and the grain of its masks so far.
        limits: when what a frame measures is of no use.
    """

    frame: FrameFeatures
    aligner: FrameAligner
    trust: Callable[[np.ndarray], np.ndarray]
    state: TrackerState
    limits: HealthConfig

    def window(self, p_map: Float[np.ndarray, "3"]) -> MapWindow:
        """The map around a place."""
        return self.aligner.windows.around(p_map)

    def align(
        self, T_map_base: np.ndarray, covariance: Float[np.ndarray, "6 6"], last_sigma_along_m: float
    ) -> Answer | None:
        """The pose near a predicted one, see `FrameAligner.align`, and what speaks against it."""
        try:
            found = self.aligner.align(self.frame, T_map_base, covariance, last_sigma_along_m, self.trust, *self._known)
        except SemlocError:  # no road there
            return None
        return Answer(found, *health.frame_problems(found, self.frame.usable_share, self.limits))

    @property
    def _known(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, ""]]:
        """Stance and grain."""
        return self.state.stance, np.asarray(self.state.grain)

    def explained_from(
        self, T_map_start: np.ndarray, spread: Float[np.ndarray, "6 6"], step_m: float
    ) -> Alignment | None:
        """The pose near a start, where it explains the frame; None where nothing there does."""
        answer = self.align(T_map_start, spread, step_m)
        return None if answer is None or answer.is_occluded or answer.reasons else answer.found

    def costs_beside(self, T_map_base: np.ndarray, moves: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"] | None:
        """Costs [nats] at a pose after each move; see `FrameAligner.costs_beside`."""
        try:
            return self.aligner.costs_beside(self.frame, T_map_base, moves, self.trust, *self._known)
        except SemlocError:
            return None

    def costs_of_classes(
        self, T_map_base: np.ndarray, moves: Float[np.ndarray, "n 3"], level: int
    ) -> Float[np.ndarray, "4 n"] | None:
        """Costs [nats] of parts of the map; see `FrameAligner.costs_of_classes`."""
        try:
            return self.aligner.costs_of_classes(self.frame, T_map_base, moves, *self._known, level)
        except SemlocError:
            return None

    def road_under(self, T_map_base: np.ndarray) -> tuple[Float[np.ndarray, "4 4"], RoadSpread] | None:
        """The pose on the road of the map, and how far that is from a plane; see `FrameAligner.road_under`."""
        try:
            return self.aligner.road_under(T_map_base)
        except SemlocError:
            return None

    def align_again(
        self,
        rigs: tuple[Rig, ...],
        wider_m: Sequence[float],
        asked: Sequence[int],
        T_map_base: np.ndarray,
        covariance: Float[np.ndarray, "6 6"],
    ) -> tuple[Float[np.ndarray, " rig"], Float[np.ndarray, "rig 4 4"]] | None:
        """Scores and poses with other calibrations; see `FrameAligner.align_again`."""
        known = self.frame, T_map_base, covariance, self.trust, *self._known
        try:
            return self.aligner.align_again(rigs, wider_m, asked, *known)
        except SemlocError:
            return None
