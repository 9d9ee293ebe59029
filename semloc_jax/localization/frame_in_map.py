"""One frame that can be held against the map at any pose (room: localization; host).

In: FrameFeatures, a FrameAligner, what is known of the frame beside its pose. Out: Alignment, costs at other poses.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from semloc_jax.cameras import Rig
from semloc_jax.errors import SemlocError
from semloc_jax.localization import health
from semloc_jax.localization.frame_alignment import Alignment, FrameAligner
from semloc_jax.localization.health import HealthConfig
from semloc_jax.localization.map_window import MapWindow
from semloc_jax.localization.track_state import FrameFeatures
from semloc_jax.maps import RoadSpread


@dataclass(frozen=True)
class FrameInMap:
    """A frame with the map and everything but the pose that a comparison of the two needs.

    Poses are T_map_base float64[4 4]; where the map has no road, there is no answer.

    Attributes:
        frame: what the cameras show.
        aligner: the map.
        trust: weights of the elements of the map that rows name.
        stance: height [m], roll and pitch [rad] of the vehicle over the road of the map.
        grain: of the masks, see `NoiseModel.grain`.
        limits: when what a frame measures is of no use.
    """

    frame: FrameFeatures
    aligner: FrameAligner
    trust: Callable[[np.ndarray], np.ndarray]
    stance: Float[np.ndarray, "3"]
    grain: Float[np.ndarray, ""]
    limits: HealthConfig

    def window(self, p_map: Float[np.ndarray, "3"]) -> MapWindow:
        """The map around a place."""
        return self.aligner.windows.around(p_map)

    def align(
        self, T_map_base: np.ndarray, covariance: Float[np.ndarray, "6 6"], last_sigma_along_m: float
    ) -> Alignment | None:
        """The pose near a predicted one; see `FrameAligner.align`."""
        try:
            return self.aligner.align(
                self.frame, T_map_base, covariance, last_sigma_along_m, self.trust, self.stance, self.grain
            )
        except SemlocError:  # no road there
            return None

    def problems(self, found: Alignment) -> tuple[bool, tuple[str, ...]]:
        """Whether the frame was occluded, and every reason not to use what it measured."""
        return health.frame_problems(found, self.frame.usable_share, self.limits)

    def explained_from(
        self, T_map_start: np.ndarray, spread: Float[np.ndarray, "6 6"], step_m: float
    ) -> Alignment | None:
        """The pose near a start, where it explains the frame; None where nothing there does."""
        found = self.align(T_map_start, spread, step_m)
        if found is None:
            return None
        is_occluded, reasons = self.problems(found)
        return None if is_occluded or reasons else found

    def costs_beside(self, T_map_base: np.ndarray, moves: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"] | None:
        """Costs [nats] at a pose after each move; see `FrameAligner.costs_beside`."""
        try:
            return self.aligner.costs_beside(self.frame, T_map_base, moves, self.trust, self.stance, self.grain)
        except SemlocError:
            return None

    def costs_of_classes(
        self, T_map_base: np.ndarray, moves: Float[np.ndarray, "n 3"], level: int
    ) -> Float[np.ndarray, "4 n"] | None:
        """Costs [nats] of parts of the map; see `FrameAligner.costs_of_classes`."""
        try:
            return self.aligner.costs_of_classes(self.frame, T_map_base, moves, self.stance, self.grain, level)
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
        known = self.frame, T_map_base, covariance, self.trust, self.stance, self.grain
        try:
            return self.aligner.align_again(rigs, wider_m, asked, *known)
        except SemlocError:
            return None
