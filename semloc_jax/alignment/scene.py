"""The configuration of a scene, set once for every verb (room: alignment; host).

In: nothing. Out: SceneConfig: map query, cost maps, noise, road, view, search; from it the settings of compiled solves.
Localization, tracking, explanations, calibration, learning and surveys all take their scene from here: what is set in
one file reaches all of them.
"""

import dataclasses
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, Literal

from semloc_jax.alignment.pose import AlignConfig
from semloc_jax.alignment.pose_prior import RoadSigmas
from semloc_jax.alignment.proposals import ProposalKind
from semloc_jax.alignment.single_frame import SingleFrameConfig
from semloc_jax.perception import CostMapConfig
from semloc_jax.residuals.native_kernels import Path
from semloc_jax.residuals.noise import NoiseModel
from semloc_jax.residuals.view import ViewConfig

PlaceIn = Literal["earth", "map"]


@dataclass(frozen=True)
class ViewLimits:
    """Which part of the map a camera is assumed to see. All values are our choice."""

    capacity: int = 1024
    """Map samples kept for each camera."""
    max_range_m: float = 60.0
    """Samples farther from the camera are left out: they are too small for the mask and hidden too often."""
    class_weight: tuple[float, ...] = ()
    """Factor on the weight of each ElementClass, in its order; empty for 1. `semloc learn` finds them."""


@dataclass(frozen=True)
class FrameSearch:
    """How widely one frame is searched. All values are ours."""

    num_hypotheses: int = 1024
    proposals: ProposalKind = "lattice"
    reach: float = 2.5
    """Half width of the search window in sigmas of the prior."""
    min_reach_deg: float = 5.0
    """The search covers at least this heading to both sides, however small the sigma of the prior."""
    capacity: int = 1024
    """Map samples of each camera while many hypotheses are compared."""
    seed: int = 0
    """Of the random proposals."""


@dataclass(frozen=True)
class SceneConfig:
    """Everything that describes a scene, whatever the task. All values are our choice."""

    SECTION: ClassVar[str | None] = None
    """Where a configuration file holds all of this: at its top level."""
    search_radius_m: float = 65.0
    """Radius of the map query: the range of a view plus the reach of a search."""
    map_sigma_m: float = 0.0
    """How accurate the map is, as its maker states: joins the covariance of every pose that goes out, beside what the
    map itself states of what is around."""
    place_in: PlaceIn = "earth"
    """What poses are places in. earth: with what the map itself states that all around a pose is off by, as maps of
    drives do. map: where the vehicle is among the elements around it, for whoever takes lanes and signs from the same
    map; that error is then told apart, once."""
    map_reach_m: float = 20.0
    """Distance over which the position error of the map changes by its own size: the heading error is their ratio."""
    sample_spacing_m: float = 0.25
    sample_capacity: int = 8192
    """Most map samples of one frame; the spacing grows where the map holds more."""
    road: RoadSigmas = field(default_factory=RoadSigmas)
    cost_maps: CostMapConfig = field(default_factory=CostMapConfig)
    noise: NoiseModel = field(default_factory=NoiseModel)
    view: ViewLimits = field(default_factory=ViewLimits)
    search: FrameSearch = field(default_factory=FrameSearch)
    loss: str = AlignConfig.loss
    """Robust function of the contours; see `residuals.robust`."""
    backend: Path = AlignConfig.path
    """How residuals are evaluated: by native kernels (analytic, autodiff) or by JAX alone (xla); auto takes the fastest
    that is possible."""

    def __post_init__(self) -> None:
        self.view_of(ViewConfig())  # refuses class weights that do not fit the classes

    @property
    def map_sigma(self) -> tuple[float, float]:
        """Standard deviations of place [m] and direction [rad] that the map shares everywhere."""
        return self.map_sigma_m, self.map_sigma_m / self.map_reach_m

    def view_of(self, base: ViewConfig) -> ViewConfig:
        """A view with the values of the scene; margins and densities are those of the base."""
        limits = self.view
        return dataclasses.replace(
            base,
            capacity=limits.capacity,
            max_range_m=limits.max_range_m,
            class_weight=limits.class_weight,
            noise=self.noise,
            path=self.backend,
        )

    def align_of(self, base: AlignConfig) -> AlignConfig:
        """A refinement with the values of the scene; levels, steps and limits are those of the base."""
        return dataclasses.replace(base, loss=self.loss, path=self.backend, noise=self.noise)

    @cached_property
    def frame(self) -> SingleFrameConfig:
        """How one frame is localized from a wide prior in this scene."""
        base, search = SingleFrameConfig(), self.search
        return dataclasses.replace(
            base,
            num_hypotheses=search.num_hypotheses,
            proposals=search.proposals,
            reach=search.reach,
            min_reach_deg=search.min_reach_deg,
            seed=search.seed,
            search_view=dataclasses.replace(self.view_of(base.search_view), capacity=search.capacity),
            polish_view=self.view_of(base.polish_view),
            search_align=self.align_of(base.search_align),
            polish_align=self.align_of(base.polish_align),
        )
