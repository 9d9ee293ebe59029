"""One frame of a drive placed on the map (room: alignment; host).

In: a SemanticMap, masks, cameras, a PosePrior. Out: LocalizationResult.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from semloc_jax.alignment.complete_modes import ModeFinder
from semloc_jax.alignment.fault_modes import FaultConfig
from semloc_jax.alignment.frame_levels import levels_of, mount_variance
from semloc_jax.alignment.hypotheses import Modes
from semloc_jax.alignment.mask_image import mask_image
from semloc_jax.alignment.mode_search import CompleteModesConfig, FrameImage, half_window_m
from semloc_jax.alignment.modes import modes_in_map
from semloc_jax.alignment.pose_prior import PosePrior
from semloc_jax.alignment.result import FoundModes, LocalizationResult
from semloc_jax.alignment.road_patch import RoadPatch
from semloc_jax.alignment.same_pose import ONE_PLACE
from semloc_jax.alignment.scene import SceneConfig
from semloc_jax.alignment.single_frame import FrameInput
from semloc_jax.alignment.verdict import VerdictConfig, directions_held, judge
from semloc_jax.cameras import Rig
from semloc_jax.datasets import Frame
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.held import held_text
from semloc_jax.evaluation.metrics import ALERT_LIMITS
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.maps import LocalMap, SemanticMap, SharedSigmas, sample, with_map_accuracy
from semloc_jax.perception import ClassTable
from semloc_jax.perception.border_distance import border_distances, pixel_unit
from semloc_jax.perception.finer_masks import rig_of
from semloc_jax.structs import SolveStatus

_MOST_MORE_M = 40.0
"""The map is queried no farther than this beyond the usual radius, however wide the prior is."""
_REACH_PX = 60.0
"""Distances to mask borders are kept up to this, in pixels of an image of usual size."""


@dataclass(frozen=True)
class LocalizeConfig(SceneConfig):
    """Everything that decides how a frame is localized: the scene, and when a pose may be used."""

    modes: ClassVar[CompleteModesConfig] = CompleteModesConfig()
    """Of the search for every mode: constants, each with its reason where it stands, and no settings."""
    verdict: VerdictConfig = field(default_factory=VerdictConfig)
    faults: FaultConfig = field(default_factory=FaultConfig)


class FrameLocalizer:
    """Localizes single frames in one map with one class table; compiled once, then used for every frame.

    Only the channels of the class table that the map has elements for are kept: the others would cost time and say
    nothing.
    """

    def __init__(self, semantic_map: SemanticMap, table: ClassTable, config: LocalizeConfig | None = None):
        """Prepare a map.

        Raises:
            SemlocError: no class of the map is visible in masks of this table.
        """
        self.map, self.table, self.config = semantic_map, table, config or LocalizeConfig()
        labels = sorted(semantic_map.labels)
        channels = sorted({table.channel_of(label) for label in labels} - {-1})
        self.not_shown = tuple(label for label in labels if table.channel_of(label) < 0)
        if not channels:
            names = ", ".join(label.name for label in labels) or "none"
            seen = ", ".join(channel.name for channel in table.channels)
            raise SemlocError(
                f"map {semantic_map.name}: its classes ({names}) are not in class table {table.name} ({seen}); "
                "give the table of your masks"
            )
        self.shown = replace(table, channels=tuple(table.channels[index] for index in channels))
        self.channel_of_label = np.asarray(self.shown.channel_by_class, dtype=np.int32)

    def prepare(
        self, masks: Sequence[np.ndarray], rig: Rig, T_map_near: np.ndarray, more_m: float = 0.0
    ) -> tuple[FrameInput, LocalMap]:
        """Map samples around a place and cost maps of one frame, ready for the solver.

        Args:
            masks: Class ids, one mask for each camera.
            rig: Cameras of the masks.
            T_map_near: The place.
            more_m: How much farther than usual the map is needed, because the vehicle may stand elsewhere [m].
        """
        heading = float(np.arctan2(T_map_near[1, 0], T_map_near[0, 0])) if len(rig) == 1 else None
        local_map = self.map.query(T_map_near[:3, 3], self.config.search_radius_m + more_m, heading)
        samples = sample_within(local_map, self.config.sample_spacing_m, self.config.sample_capacity)
        image = mask_image(masks, self.shown, self.config.cost_maps)
        return FrameInput(samples, rig, jnp.asarray(self.channel_of_label), *image), local_map

    def localize(
        self, frame: Frame | None, masks: Sequence[np.ndarray], prior: PosePrior, rig: Rig | None = None
    ) -> LocalizationResult:
        """The pose of one frame from masks of its cameras.

        Args:
            frame: The frame (time, id, rig); None where masks came as arrays, with their rig.
            masks: Class ids uint8[h w], one for each camera of the rig.
            prior: First guess.
            rig: Cameras of the masks; None for those of the frame, with more pixels where the masks have.

        Returns:
            LocalizationResult; bad evidence gives a status, never an exception.
        """
        started = time.perf_counter()
        T_map_prior = prior.on_road(self.map)
        more_m = min(max(self.config.modes.window_sigmas * (prior.sigma_xy_m - 1.0), 0.0), _MOST_MORE_M)
        inputs, local_map = self.prepare(masks, rig or rig_of(masks, frame.rig), T_map_prior, more_m)
        finder = self.mode_finder(masks, inputs, prior, T_map_prior, local_map.frame)
        prepared = time.perf_counter()
        found = finder.find()
        times = {"evidence": prepared - started, "solve": time.perf_counter() - prepared}
        return self._result(frame, found, T_map_prior, prior.sigma_xy_m, times, inputs.rig, local_map)

    def judged(
        self,
        frame: Frame | None,
        found: Modes,
        T_map_prior: np.ndarray,
        local: LocalFrame,
        sigma_xy_m: float,
        times: dict[str, float],
        rig: Rig,
    ) -> LocalizationResult:
        """The result of a frame from the modes of the solver, with the verdict on it.

        Args:
            frame: The frame; None where the masks came as arrays.
            found: Modes relative to the local origin.
            T_map_prior: First guess in the map frame.
            local: Frame of the solver.
            sigma_xy_m: Horizontal standard deviation of the first guess.
            times: Seconds spent by stage.
            rig: Cameras of the masks.
        """
        modes = modes_in_map(found, local, ONE_PLACE)
        places = FoundModes(modes, SolveStatus(int(found.estimates.status[0])), None)
        return self._result(frame, places, T_map_prior, sigma_xy_m, times, rig)

    def _result(
        self,
        frame: Frame | None,
        found: FoundModes,
        T_map_prior: np.ndarray,
        sigma_xy_m: float,
        times: dict[str, float],
        rig: Rig,
        local_map: LocalMap | None = None,
    ) -> LocalizationResult:
        elements = () if local_map is None else local_map.elements
        map_sigmas = SharedSigmas(elements, self.config.map_sigma, on_earth=self.config.place_in == "earth")
        best = found.modes[0].T_map_base if found.modes else T_map_prior
        of_map = np.square(map_sigmas.at(best[:2, 3]))
        shared = of_map[[0, 0, 1]] + mount_variance(rig, self.config.faults)
        levels = levels_of(found, shared, ALERT_LIMITS[0])
        found = _on_earth(found, map_sigmas)
        status, reasons = judge(found, T_map_prior, sigma_xy_m, self.config.verdict)
        held, bounds = directions_held(found, T_map_prior, sigma_xy_m, self.config.verdict)
        told = (*reasons, *filter(None, [held_text(bounds, held)]))
        if status == SolveStatus.NO_EVIDENCE and self.not_shown:
            names = ", ".join(label.name.lower() for label in self.not_shown)
            told += (f"the map also has {names}, which masks of table {self.table.name} never show: others would help",)
        return LocalizationResult(
            frame, best, T_map_prior, status, not reasons, told, found.modes, times, held, *levels
        )

    def mode_finder(
        self,
        masks: Sequence[np.ndarray],
        inputs: FrameInput,
        prior: PosePrior,
        T_map_prior: np.ndarray,
        frame: LocalFrame,
    ) -> ModeFinder:
        """What finds the places of a frame; arguments as `localize` has them, with what `prepare` has made."""
        unit_px = pixel_unit([mask.shape for mask in masks])
        stride = self.config.cost_maps.usable_stride
        borders = border_distances(masks, self.shown, _REACH_PX * unit_px, stride, self.config.cost_maps.blur_px)
        size = max(mask.shape[1] for mask in masks), max(mask.shape[0] for mask in masks)
        half_m = half_window_m(prior.sigma_xy_m, self.config.modes)
        road = RoadPatch.around(self.map, T_map_prior, frame, half_m)
        spread = self.map.road_spread(T_map_prior)
        solver_prior = prior.to_solver(T_map_prior, frame, self.config.road, spread)
        image = FrameImage(borders, size, unit_px)
        config = self.config
        return ModeFinder(inputs, image, solver_prior, road, frame, config.modes, config.frame, config.faults)


def _on_earth(found: FoundModes, map_sigmas: SharedSigmas) -> FoundModes:
    """The modes with what all around them in the map shares, as is stated: masks cannot tell it from the pose."""
    modes = tuple(
        replace(mode, covariance=with_map_accuracy(mode.covariance, *map_sigmas.at(mode.T_map_base[:2, 3])))
        for mode in found.modes
    )
    return replace(found, modes=modes)


def sample_within(local_map: LocalMap, spacing_m: float, capacity: int):
    """Map samples at the given spacing, or at the smallest multiple of it by sqrt(2) that fits the capacity."""
    while True:
        try:
            return sample(local_map, spacing_m, capacity)
        except SemlocError:
            if spacing_m > 4.0:
                raise
            spacing_m *= np.sqrt(2.0)
