"""Loops are localizations in one's own map of before (room: mapping; host).

In: Chain, masks of its frames, maps of stretches of it. Out: FoundLoop list, accepted or not, and the way with them.
A false loop ruins a map, a missing one leaves it a little worse: a loop is accepted only where several frames agree on
a place along the odometry, nothing else explains them nearly as well, and the way allows it. A place with twins beside
it, a dash period on, is looked at again when the loops of other places have told how the way goes.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from scipy.special import chdtri

from semloc_jax.alignment.frame_localizer import FrameLocalizer, LocalizeConfig
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid
from semloc_jax.mapping.chain import Chain
from semloc_jax.mapping.chain_graph import ChainSolution, Loops
from semloc_jax.mapping.found_loops import FoundLoop, loops_of, without_outvoted
from semloc_jax.mapping.place_search import PLANE, Look, Place, lead_nats, search_places, views_of
from semloc_jax.mapping.revisits import Revisit, RevisitConfig, groups, revisits
from semloc_jax.maps import SemanticMap
from semloc_jax.perception import ClassTable

MapOf = Callable[[np.ndarray], SemanticMap | None]
"""Frames of a stretch -> what a mapper made of them, in the frame `odom` of the chain; None where it has nothing."""
Once = Callable[[Revisit, Callable[[], "FoundLoop | None"]], "FoundLoop | None"]
"""A revisit and the search for its loop -> what it gives."""


@dataclass(frozen=True)
class LoopConfig:
    """When a revisit is a loop. All values are ours but the 20 nats, which are the design's."""

    revisit: RevisitConfig = field(default_factory=RevisitConfig)
    scene: LocalizeConfig = field(default_factory=LocalizeConfig)
    stretch_m: float = 30.0
    """Way before and after the earlier frame whose map is searched."""
    max_passes: int = 2
    """Earlier passes that are searched for one group, nearest first."""
    min_lead_nats: float = 20.0
    """By how much the best place must beat the second best, summed over the frames."""
    min_seen_share: float = 0.75
    """Share of the frames that must have a mode at the place."""
    min_explained: float = 0.25
    """Mean share of the map in view that must lie on borders of the masks."""
    max_sigma_m: float = 0.2
    """A place that is open by more may be half a metre off, which is another place."""
    probability: float = 0.999
    """Quantile of chi-square that the agreement of the frames keeps."""
    way_probability: float = 0.99
    """Quantile that the place keeps against the way. It is what rules out twins of places that no search window holds:
    two aisles of a garage can be alike in everything that frames show."""
    least_prior_m: float = 0.5
    least_prior_deg: float = 0.6
    """Least standard deviations of the place that is searched around."""
    map_sigma: tuple[float, float, float, float, float, float] = (0.05, 0.03, 0.05, 0.005, 0.005, 0.002)
    """Errors of the map of a stretch and of the frames that no covariance of theirs holds [m, rad]."""


@dataclass(frozen=True)
class LoopSearch:
    """What is needed to look for loops.

    Attributes:
        chain: from wheels and inertial sensor.
        look: masks of a frame.
        map_of: what a mapper made of a stretch.
        table: class table of the masks.
        solve: the way with the loops that were accepted so far.
        config: limits.
        once: gives what an earlier run found for a revisit, or searches.
    """

    chain: Chain
    look: Look
    map_of: MapOf
    table: ClassTable
    solve: Callable[[Loops], ChainSolution]
    config: LoopConfig = field(default_factory=LoopConfig)
    once: Once = lambda _, search: search()

    def run(self, told: Callable[[Iterable], Iterable] = iter) -> tuple[list[FoundLoop], ChainSolution]:
        """Every revisit that was searched, and the way with the accepted ones.

        Args:
            told: Wraps the groups of frames, to show progress.
        """
        found: dict[tuple[int, ...], list[FoundLoop]] = {}

        def every() -> list[FoundLoop]:
            return [loop for loops in found.values() for loop in loops]

        solution = self.solve(loops_of(every()))
        for frames in told(groups(self.chain.way_m, self.config.revisit)):
            found[frames] = self.looked(frames, solution)
            if any(loop.is_accepted for loop in found[frames]):
                # What the loop tells makes the next search narrower.
                solution = self.solve(loops_of(every()))
        open_ones = [frames for frames, loops in found.items() if loops and not loops[-1].is_accepted]
        if len(open_ones) < sum(map(bool, found.values())):
            # By the way as the first look leaves it: no second look confirms another.
            for frames in told(open_ones):
                found[frames] = self.looked(frames, solution, is_second_look=True) or found[frames]
            solution = self.solve(loops_of(every()))
        return without_outvoted(every(), solution.is_kept), solution

    def looked(self, frames: tuple[int, ...], solution: ChainSolution, is_second_look: bool = False) -> list[FoundLoop]:
        """The earlier passes of a group that were searched, up to the first that is accepted."""
        found = []
        near = revisits(solution, self.chain.way_m, frames, self.config.revisit)
        for revisit in near[: self.config.max_passes]:
            revisit = revisit._replace(is_second_look=is_second_look)
            loop = self.once(revisit, partial(self.searched, revisit, solution))
            if loop is not None:
                found.append(loop)
                if loop.is_accepted:
                    break
        return found

    def searched(self, revisit: Revisit, solution: ChainSolution) -> FoundLoop | None:
        """The loop of a revisit; None where there is nothing to search in."""
        chain, config = self.chain, self.config
        stretch = np.flatnonzero(np.abs(chain.way_m - chain.way_m[revisit.a]) <= config.stretch_m)
        stretch = stretch[chain.way_m[stretch] < chain.way_m[revisit.frames[0]]]
        semantic_map = self.map_of(stretch)
        if semantic_map is None or semantic_map.num_elements == 0:
            return None
        Ts, T_odom_a = solution.Ts_map_base, chain.Ts_odom_base[revisit.a]
        T_a_b = rigid.inverse(Ts[revisit.a]) @ Ts[revisit.b]
        views = views_of(self.look, revisit.frames, revisit.b, solution)
        sigma_xy_m = max(revisit.sigma_xy_m, config.least_prior_m)
        sigma_heading_rad = max(revisit.sigma_heading_rad, float(np.deg2rad(config.least_prior_deg)))
        try:
            localizer = FrameLocalizer(semantic_map, self.table, config.scene)
            places = search_places(localizer, views, T_odom_a @ T_a_b, sigma_xy_m, sigma_heading_rad)
        except SemlocError:  # the map of the stretch has no class of these masks, or no road there
            return None
        if not places:
            return FoundLoop(revisit.a, revisit.b, T_a_b, revisit.covariance, 0.0, ("no frame sees the map",))
        if revisit.is_second_look:
            places = weighed_by_way(places, T_odom_a @ T_a_b, sigma_xy_m, sigma_heading_rad)
        best, lead = places[0], lead_nats(places)
        covariance = best.covariance + np.diag(np.square(config.map_sigma))
        T_found = rigid.inverse(T_odom_a) @ best.T_map_middle
        off = rigid.log(rigid.inverse(T_a_b) @ T_found)
        reasons = tuple(against(best, lead, off, covariance + revisit.covariance, config))
        return FoundLoop(revisit.a, revisit.b, T_found, covariance, lead, reasons)


def weighed_by_way(
    places: Sequence[Place], T_map_middle: np.ndarray, sigma_xy_m: float, sigma_heading_rad: float
) -> list[Place]:
    """Places with what the way says of each in their evidence, best first; arguments as for `search_places`."""
    sigma = np.array([sigma_xy_m, sigma_xy_m, sigma_heading_rad])

    def nats(place: Place) -> float:
        off = rigid.log(rigid.inverse(T_map_middle) @ place.T_map_middle)[PLANE]
        return place.nats - 0.5 * float(np.sum(np.square(off / sigma)))

    return sorted((place._replace(nats=nats(place)) for place in places), key=lambda place: -place.nats)


def against(best: Place, lead: float, off: np.ndarray, covariance: np.ndarray, config: LoopConfig) -> Iterable[str]:
    """Everything that speaks against a place."""
    seen, num = int(best.is_seen.sum()), len(best.is_seen)
    if seen < max(2.0, config.min_seen_share * num):
        yield f"{seen} of {num} frames see it"
        if seen == 0:
            return
    if lead < config.min_lead_nats:
        yield f"{lead:.1f} nats over the second place"
    sigma_m = float(np.sqrt(np.linalg.eigvalsh(best.covariance[:2, :2])[-1]))
    if sigma_m > config.max_sigma_m:
        yield f"the place is open by {sigma_m:.2f} m"
    if best.explained < config.min_explained:
        yield f"{best.explained:.0%} of the map in view on borders of the masks"
    if best.chi_square > chdtri(max(3 * (seen - 1), 1), 1.0 - config.probability):
        yield f"frames disagree: chi-square {best.chi_square:.0f} of {3 * (seen - 1)}"
    square = float(off[PLANE] @ np.linalg.solve(covariance[np.ix_(PLANE, PLANE)], off[PLANE]))
    if square > chdtri(3, 1.0 - config.way_probability):
        yield f"{np.hypot(*off[:2]):.1f} m from where the way ends: chi-square {square:.0f} of 3"
