"""Find the vehicle: search around fixes, around dead reckoning, or in a whole area, and return every answer (room:
localization; host).

In: one frame and what is known of its place. Out: poses to follow side by side until one of them wins.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.level_choice import INLIER_LIMITS
from semloc_jax.alignment.modes import modes_in_map
from semloc_jax.alignment.pose_prior import PosePrior, levelled
from semloc_jax.alignment.result import Mode
from semloc_jax.alignment.same_pose import ONE_TRACK, units_apart
from semloc_jax.alignment.single_frame import localize_frame
from semloc_jax.errors import SemlocError
from semloc_jax.fusion.measurements import FusedPose
from semloc_jax.fusion.prediction import MotionLog
from semloc_jax.localization.frame_alignment import FrameAligner
from semloc_jax.localization.initialization import (
    InitializationConfig,
    prior_from_fixes,
    sectors,
    tile_priors,
    why_no_prior,
)
from semloc_jax.localization.track_state import Fixes, FrameFeatures


@dataclass(frozen=True)
class Area:
    """A disc of the map in which the vehicle is, where nothing else is known."""

    x_m: float
    y_m: float
    radius_m: float


@dataclass(frozen=True)
class AcquisitionConfig:
    """How the vehicle is searched for. All values are ours."""

    fixes: InitializationConfig = field(default_factory=InitializationConfig)
    every_s: float = 0.3
    """A search takes longer than a frame: this long is waited after a search that found nothing."""
    max_tracks: int = 4
    min_weight: float = 0.02
    """Answers with less of the posterior are not followed."""
    max_cost: float = 0.75
    min_inlier_ratio: float = INLIER_LIMITS.found
    coasting_inflation: float = 2.0
    """The window around dead reckoning in units of its sigma, over that of the search."""
    min_coasting_sigma_m: float = 0.5
    max_coasting_sigma_m: float = 4.0
    """Of one search: where dead reckoning knows less, along the way at first, several places are searched. Across it
    one search does until dead reckoning itself, which is not inflated, knows less than this."""
    max_coasting_places: int = 5
    """With so many a search takes as many times longer; a vehicle that knows still less waits for a fix."""
    tile_m: float = 4.0
    tile_heading_deg: float = 30.0


class Acquisition:
    """Searches of one map."""

    def __init__(self, aligner: FrameAligner, motion: MotionLog, config: AcquisitionConfig):
        """Take the aligner's map and windows."""
        self.aligner, self.motion, self.config = aligner, motion, config

    def priors(self, fixes: Fixes, coasting: FusedPose | None, time_s: float) -> list[PosePrior]:
        """Where to search: around dead reckoning while it is surer than the fixes and they do not contradict it.

        Returns:
            One place, several where dead reckoning is unsure along one direction, or none where nothing says it.
        """
        calibration = coasting.calibration if coasting is not None else None
        fixed = prior_from_fixes(fixes, self.motion, time_s, calibration, self.config.fixes)
        around = [] if coasting is None else places_around(coasting, self.config)
        if not around or fixed is None:
            return around or [fixed] * (fixed is not None)
        sigma_m, _ = _doubt(coasting, self.config)
        apart_m = np.hypot(*(coasting.T_map_base[:2, 3] - [fixed.x_m, fixed.y_m]))
        contradicts = apart_m > 3.0 * np.hypot(sigma_m[1], fixed.sigma_xy_m)
        return [fixed] if contradicts or fixed.sigma_xy_m < sigma_m[1] else around

    def why_not(self, fixes: Fixes, time_s: float) -> str:
        """Why a search around the fixes cannot start, and what would help; empty where it can."""
        return why_no_prior(fixes, self.motion, time_s, None, self.config.fixes)

    def in_sectors(self, priors: Sequence[PosePrior]) -> list[PosePrior]:
        """The priors in parts of which each has one heading."""
        return [part for prior in priors for part in sectors(prior, self.config.fixes)]

    def tiles(self, area: Area) -> list[PosePrior]:
        """An area in parts of which each has one heading."""
        return tile_priors(
            np.array([area.x_m, area.y_m]), area.radius_m, self.config.tile_m, self.config.tile_heading_deg
        )

    def search(self, frame: FrameFeatures, priors: Sequence[PosePrior]) -> tuple[Mode, ...]:
        """Every answer of one frame around priors of one heading that is worth following, best first."""
        found = [self.around(frame, prior) for prior in priors]
        return found[0] if len(found) == 1 else self._best_of(found)

    def around(self, frame: FrameFeatures, prior: PosePrior) -> tuple[Mode, ...]:
        """Every answer of one frame around a prior of one heading, best first."""
        scene = self.aligner.scene
        try:
            T_map_prior = prior.on_road(self.aligner.map)
        except SemlocError:
            return ()  # no road there: outside of the map
        window = self.aligner.windows.around(T_map_prior[:3, 3])
        if not window.local_map.elements:
            return ()
        local = window.local_map.frame
        found = localize_frame(
            self.aligner.frame_input(frame, window),
            prior.to_solver(T_map_prior, local, scene.road, self.aligner.map.road_spread(T_map_prior)),
            scene.frame,
            partial(levelled, semantic_map=self.aligner.map, frame=local, road=scene.road),
        )
        return self.worth_following(modes_in_map(found, local, ONE_TRACK))

    def worth_following(self, modes: Sequence[Mode]) -> tuple[Mode, ...]:
        """Those modes that explain enough, the first ones."""
        config = self.config
        good = [m for m in modes if m.cost <= config.max_cost and m.inlier_ratio >= config.min_inlier_ratio]
        return tuple([m for m in good if m.weight >= config.min_weight][: config.max_tracks])

    def _best_of(self, searches: Sequence[tuple[Mode, ...]]) -> tuple[Mode, ...]:
        """The best answers of several searches."""
        found = [mode for modes in searches for mode in modes]
        # A cost that leaves out what cannot be seen favours poses that see little: what is explained decides.
        found.sort(key=lambda mode: mode.cost - mode.coverage * mode.inlier_ratio)
        kept: list[Mode] = []
        for mode in found:
            if not any(units_apart(mode.T_map_base, other.T_map_base) < ONE_TRACK for other in kept):
                kept.append(mode)
        return tuple(kept[: self.config.max_tracks])


def places_around(coasting: FusedPose, config: AcquisitionConfig) -> list[PosePrior]:
    """Places to search around dead reckoning, the likeliest first; none where it knows too little."""
    T = coasting.T_map_base
    (least_m, most_m), direction = _doubt(coasting, config)
    one_m = min(most_m, config.max_coasting_sigma_m)
    num = int(np.ceil((most_m - one_m) / (2.0 * one_m)))  # to each side, as far as one search reaches apart
    if least_m > config.coasting_inflation * config.max_coasting_sigma_m or 2 * num + 1 > config.max_coasting_places:
        return []
    least_rad = float(np.deg2rad(config.fixes.min_sigma_heading_deg))
    sigma_rad = max(config.coasting_inflation * float(np.sqrt(coasting.covariance[5, 5])), least_rad)
    heading = float(np.arctan2(T[1, 0], T[0, 0]))
    offsets_m = 2.0 * one_m * np.array([0, *(sign * k for k in range(1, num + 1) for sign in (1, -1))])
    places = T[:2, 3] + offsets_m[:, None] * direction
    return [PosePrior(float(x), float(y), heading, float(one_m), sigma_rad) for x, y in places]


def _doubt(coasting: FusedPose, config: AcquisitionConfig) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Least and largest sigma of a search for dead reckoning, and the direction of the largest in the map."""
    variance, axes = np.linalg.eigh(coasting.covariance[:2, :2])
    ahead = coasting.T_map_base[:2, :2] @ axes[:, 1]
    sigma_m = config.coasting_inflation * np.sqrt(np.maximum(variance, 0.0))
    return np.maximum(sigma_m, config.min_coasting_sigma_m), ahead / np.linalg.norm(ahead)
