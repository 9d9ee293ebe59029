"""One frame of a drive placed on the map (room: alignment; host).

In: a SemanticMap, masks, cameras, a PosePrior. Out: LocalizationResult.
"""

import time
from collections.abc import Sequence as Frames
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from semloc_jax.alignment.hypotheses import Modes
from semloc_jax.alignment.modes import modes_in_map
from semloc_jax.alignment.pose_prior import PosePrior, levelled
from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.alignment.same_pose import ONE_PLACE
from semloc_jax.alignment.scene import SceneConfig
from semloc_jax.alignment.single_frame import FrameInput, frame_input, localize_frame
from semloc_jax.alignment.verdict import VerdictConfig, judge
from semloc_jax.cameras import Rig
from semloc_jax.datasets import Frame
from semloc_jax.errors import SemlocError
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.maps import LocalMap, SemanticMap, sample
from semloc_jax.perception import ClassTable, cost_maps
from semloc_jax.structs import SolveStatus


@dataclass(frozen=True)
class LocalizeConfig(SceneConfig):
    """Everything that decides how a frame is localized: the scene, and when a pose may be used."""

    verdict: VerdictConfig = field(default_factory=VerdictConfig)


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
        if not channels:
            names = ", ".join(label.name for label in labels) or "none"
            seen = ", ".join(channel.name for channel in table.channels)
            raise SemlocError(
                f"map {semantic_map.name}: its classes ({names}) are not in class table {table.name} ({seen}); "
                "give the table of your masks"
            )
        self.shown = replace(table, channels=tuple(table.channels[index] for index in channels))
        self.channel_of_label = np.asarray(self.shown.channel_by_class, dtype=np.int32)

    def prepare(self, masks: Frames[np.ndarray], rig: Rig, T_map_near: np.ndarray) -> tuple[FrameInput, LocalMap]:
        """Map samples around a place and cost maps of one frame, ready for the solver."""
        heading = float(np.arctan2(T_map_near[1, 0], T_map_near[0, 0])) if len(rig) == 1 else None
        local_map = self.map.query(T_map_near[:3, 3], self.config.search_radius_m, heading)
        samples = sample_within(local_map, self.config.sample_spacing_m, self.config.sample_capacity)
        maps = cost_maps(masks, self.shown, self.config.cost_maps, quantised=True)
        return frame_input(samples, maps, rig, self.channel_of_label), local_map

    def localize(
        self, frame: Frame | None, masks: Frames[np.ndarray], prior: PosePrior, rig: Rig | None = None
    ) -> LocalizationResult:
        """The pose of one frame from masks of its cameras.

        Args:
            frame: The frame (time, id, rig); None where masks came as arrays, with their rig.
            masks: Class ids uint8[h w], one for each camera of the rig.
            prior: First guess.
            rig: Cameras of the masks; None for those of the frame.

        Returns:
            LocalizationResult; bad evidence gives a status, never an exception.
        """
        started = time.perf_counter()
        T_map_prior = prior.on_road(self.map)
        inputs, local_map = self.prepare(masks, rig or frame.rig, T_map_prior)
        prepared = time.perf_counter()
        spread = self.map.road_spread(T_map_prior)
        solver_prior = prior.to_solver(T_map_prior, local_map.frame, self.config.road, spread)
        on_road = partial(levelled, semantic_map=self.map, frame=local_map.frame, road=self.config.road)
        found = localize_frame(inputs, solver_prior, self.config.frame, on_road)
        times = {"evidence": prepared - started, "solve": time.perf_counter() - prepared}
        return self.judged(frame, found, T_map_prior, local_map.frame, prior.sigma_xy_m, times)

    def judged(
        self,
        frame: Frame | None,
        found: Modes,
        T_map_prior: np.ndarray,
        local: LocalFrame,
        sigma_xy_m: float,
        times: dict[str, float],
    ) -> LocalizationResult:
        """The result of a frame from the modes of the solver, with the verdict on it.

        Args:
            frame: The frame; None where the masks came as arrays.
            found: Modes relative to the local origin.
            T_map_prior: First guess in the map frame.
            local: Frame of the solver.
            sigma_xy_m: Horizontal standard deviation of the first guess.
            times: Seconds spent by stage.
        """
        verdict = self.config.verdict
        modes = modes_in_map(found, local, ONE_PLACE)
        best = modes[0].T_map_base if modes else np.full((4, 4), np.nan)
        away = np.hypot(*(best - T_map_prior)[:2, 3]) / sigma_xy_m if modes else np.inf
        status, reasons = judge(SolveStatus(int(found.estimates.status[0])), modes, away, verdict)
        return LocalizationResult(frame, best, T_map_prior, status, not reasons, reasons, modes, times)


def sample_within(local_map: LocalMap, spacing_m: float, capacity: int):
    """Map samples at the given spacing, or at the smallest multiple of it by sqrt(2) that fits the capacity."""
    while True:
        try:
            return sample(local_map, spacing_m, capacity)
        except SemlocError:
            if spacing_m > 4.0:
                raise
            spacing_m *= np.sqrt(2.0)
