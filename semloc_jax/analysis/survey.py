"""Localizability of a road before anyone drives it (room: analysis; host).

In: a map, cameras, places along a way. Out: Survey: expected sigmas, ambiguity and weak stretches.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from semloc_jax.alignment.frame_localizer import FrameLocalizer, sample_within
from semloc_jax.alignment.scene import SceneConfig
from semloc_jax.analysis.ambiguity import AmbiguityConfig, second_pose
from semloc_jax.analysis.expected import (
    DIRECTIONS,
    BoundaryNoise,
    ExpectedConfig,
    expected_scatter,
    expected_sigma,
)
from semloc_jax.cameras import Rig
from semloc_jax.errors import SemlocError
from semloc_jax.maps import LocalMap, SemanticMap
from semloc_jax.perception import ClassTable
from semloc_jax.structs import MapSamples


@dataclass(frozen=True)
class SurveyConfig:
    """How a road is surveyed. All values are our choice."""

    SECTION: ClassVar[str] = "survey"
    """Where a configuration file holds all of this but the scene."""
    scene: SceneConfig = field(default_factory=SceneConfig)
    boundary: BoundaryNoise = field(default_factory=BoundaryNoise)
    """How boundaries of real masks are displaced."""
    ambiguity: AmbiguityConfig = field(default_factory=AmbiguityConfig)
    weak_longitudinal_m: float = 0.1
    """A stretch is weak where the expected sigma is above this; a third of the alert limit of a local street."""
    weak_lateral_m: float = 0.1
    weak_heading_deg: float = 0.17
    weak_ambiguity: float = 0.6
    """... or where a second pose explains more than this share of the view."""

    @cached_property
    def expected(self) -> ExpectedConfig:
        """What the expected accuracy of a place rests on."""
        return ExpectedConfig(self.scene, self.boundary)


@dataclass(frozen=True)
class Way:
    """Places in the order in which they are driven.

    Attributes:
        name: for the report.
        Ts_map_base: vehicle poses.
        station_m: distance along the way.
    """

    name: str
    Ts_map_base: Float[np.ndarray, "n 4 4"]
    station_m: Float[np.ndarray, " n"]


@dataclass(frozen=True)
class WayReport:
    """What may be expected along one way.

    Attributes:
        way: the places.
        sigma: expected standard deviation: longitudinal [m], lateral [m], heading [deg].
        ambiguity: share of the view that the best other pose explains, in [0, 1].
        second_m: where that pose is: longitudinal, lateral shift [m].
        information: of one image, about the right tangent.
    """

    way: Way
    sigma: Float[np.ndarray, "n 3"]
    ambiguity: Float[np.ndarray, " n"]
    second_m: Float[np.ndarray, "n 2"]
    information: Float[np.ndarray, "n 6 6"]


@dataclass(frozen=True)
class WeakStretch:
    """A part of a way where one thing about the pose is badly known."""

    way: str
    from_km: float
    to_km: float
    what: str
    """longitudinal, lateral, heading, or ambiguous."""
    worst: float
    """Largest sigma [m, deg] or share in the stretch."""
    second_m: tuple[float, float] | None = None
    """Of an ambiguous stretch: where the second pose is."""

    def __str__(self) -> str:
        """One line of the report."""
        where = f"{self.way}, km {self.from_km:.3f} to {self.to_km:.3f}"
        if self.second_m is not None:
            ahead, left = self.second_m
            along = f"{abs(ahead):.1f} m {'ahead' if ahead > 0 else 'behind'}"
            across = f"{abs(left):.1f} m to the {'left' if left > 0 else 'right'}"
            return f"{where}: {100 * self.worst:.0f} % of the view also fits {along}, {across}"
        unit = "deg" if self.what == "heading" else "m"
        return f"{where}: {self.what} sigma up to {self.worst:.2f} {unit}"


@dataclass(frozen=True)
class Survey:
    """The reports of all ways with what makes a stretch weak."""

    ways: tuple[WayReport, ...]
    config: SurveyConfig

    @property
    def limits(self) -> dict[str, float]:
        """Above what a stretch is weak, by name."""
        c = self.config
        limits = (c.weak_longitudinal_m, c.weak_lateral_m, c.weak_heading_deg, c.weak_ambiguity)
        return dict(zip((*DIRECTIONS, "ambiguous"), limits, strict=True))

    def weak_stretches(self) -> tuple[WeakStretch, ...]:
        """Every stretch above a limit, in the order of the ways."""
        found: list[WeakStretch] = []
        for report in self.ways:
            columns = np.column_stack([report.sigma, report.ambiguity])
            for column, (what, limit) in zip(columns.T, self.limits.items(), strict=True):
                found += _stretches(report, what, column, limit)
        return tuple(found)


def survey_ways(
    semantic_map: SemanticMap,
    rig: Rig,
    table: ClassTable,
    ways: Sequence[Way],
    config: SurveyConfig | None = None,
    on_place: Callable[[], None] | None = None,
) -> Survey:
    """What may be expected of each place of each way, from the map and the cameras alone.

    Args:
        semantic_map: The map.
        rig: Cameras of the vehicle.
        table: What masks will show.
        ways: Places; see `path_way` and `analysis.lanes.lane_ways`.
        config: None for the defaults.
        on_place: Called after each place.

    Raises:
        SemlocError: no places, or no class of the map is in the table.
    """
    config = config or SurveyConfig()
    if not sum(len(way.station_m) for way in ways):
        raise SemlocError("survey: no places; expected a way with at least one, give --path or a map with lanes")
    viewer = PlaceViewer(semantic_map, table, config)
    cameras, reports = viewer.rig(rig), []
    for way in ways:
        rows = []
        for T_map_base in way.Ts_map_base:
            samples, T = viewer.samples(viewer.local_map(T_map_base), T_map_base)
            rows.append(jax.device_get(_place(samples, T, cameras, viewer.channel_of_label, config)))
            if on_place is not None:
                on_place()
        sigma, ambiguity, second, information = (np.stack(column) for column in zip(*rows, strict=True))
        sigma = sigma.astype(np.float64) * [1.0, 1.0, np.rad2deg(1.0)]
        reports.append(WayReport(way, sigma, ambiguity, second, information))
    return Survey(tuple(reports), config)


class PlaceViewer:
    """Map samples around places, as the localizer takes them."""

    def __init__(self, semantic_map: SemanticMap, table: ClassTable, config: SurveyConfig):
        """Prepare a map.

        Raises:
            SemlocError: no class of the map is visible in masks of this table.
        """
        self.map, self.config = semantic_map, config
        self.channel_of_label = FrameLocalizer(semantic_map, table).channel_of_label

    def local_map(self, T_map_base: Float[np.ndarray, "4 4"]) -> LocalMap:
        """The map around a place."""
        return self.map.query(T_map_base[:3, 3], self.config.scene.search_radius_m)

    def samples(
        self, local_map: LocalMap, T_map_base: Float[np.ndarray, "4 4"]
    ) -> tuple[MapSamples, Float[np.ndarray, "4 4"]]:
        """Samples of a local map, and the pose in their frame and float type."""
        scene = self.config.scene
        samples = sample_within(local_map, scene.sample_spacing_m, scene.sample_capacity)
        return samples, local_map.frame.from_map(T_map_base)

    @staticmethod
    def rig(rig: Rig) -> Rig:
        """The cameras in the float type of the samples."""
        cameras = [camera.astype(jnp.float32) for camera in rig.cameras]
        return rig.with_cameras(cameras).with_places(jnp.asarray(rig.T_base_cam, jnp.float32))


def path_way(name: str, Ts_map_base: Float[np.ndarray, "n 4 4"], spacing_m: float) -> Way:
    """The places of a driven path, one each `spacing_m` of travel.

    Raises:
        SemlocError: the spacing is not positive.
    """
    if not spacing_m > 0:
        raise SemlocError(f"survey: spacing {spacing_m} m; expected a positive number such as 5")
    steps = np.linalg.norm(np.diff(Ts_map_base[:, :3, 3], axis=0), axis=1)
    station_m = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.arange(0.0, station_m[-1] + 1e-9, spacing_m)
    index = np.unique(np.searchsorted(station_m, wanted - 1e-9).clip(0, len(station_m) - 1))
    return Way(name, Ts_map_base[index], station_m[index])


@partial(jax.jit, static_argnames="config")
def _place(
    samples: MapSamples,
    T_local_base: Float[Array, "4 4"],
    rig: Rig,
    channel_of_label: Int[Array, " label"],
    config: SurveyConfig,
) -> tuple[Array, Array, Array, Array]:
    """Sigmas [m, m, rad], ambiguity, place of the second pose, information."""
    covariance, information = expected_scatter(samples, T_local_base, rig, channel_of_label, config.expected)
    second = second_pose(samples, T_local_base, rig, channel_of_label, config.ambiguity, config.scene)
    return expected_sigma(covariance), second.share, second.shift_m, information


def _stretches(report: WayReport, what: str, values: np.ndarray, limit: float) -> list[WeakStretch]:
    """The runs of places above the limit; a single good place between two weak ones does not part them."""
    weak = values > limit
    weak[1:-1] |= weak[:-2] & weak[2:]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], weak, [False]]).astype(int)))
    found = []
    for first, end in edges.reshape(-1, 2):
        station_km = report.way.station_m[[first, end - 1]] / 1000.0
        worst = first + int(np.argmax(values[first:end]))
        second = tuple(map(float, report.second_m[worst])) if what == "ambiguous" else None
        found.append(WeakStretch(report.way.name, *map(float, station_km), what, float(values[worst]), second))
    return found
