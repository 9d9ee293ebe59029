"""Loops are localizations in one's own map of before (room: mapping; host).

In: Chain, masks of its frames, maps of stretches of it. Out: FoundLoop list, accepted or not, and the way with them.
A false loop ruins a map, a missing one leaves it a little worse: a loop is accepted only where several frames agree on
a place along the odometry, nothing else explains them nearly as well, and the way allows it.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from semloc_jax.alignment.frame_localizer import FrameLocalizer, LocalizeConfig
from semloc_jax.cameras import Rig
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid
from semloc_jax.mapping.chain import Chain
from semloc_jax.mapping.chain_graph import ChainSolution, Loops
from semloc_jax.mapping.place_search import PLANE, Place, View, lead_nats, search_places
from semloc_jax.mapping.revisits import Revisit, RevisitConfig, groups, revisits
from semloc_jax.maps import SemanticMap
from semloc_jax.perception import ClassTable
from semloc_jax.storage import write_text

MapOf = Callable[[np.ndarray], SemanticMap | None]
"""Frames of a stretch -> what a mapper made of them, in the frame `odom` of the chain; None where it has nothing."""
Once = Callable[[Revisit, Callable[[], "FoundLoop | None"]], "FoundLoop | None"]
"""A revisit and the search for its loop -> what it gives."""
Look = Callable[[int], tuple[Sequence[np.ndarray], Rig]]
"""Frame -> masks and their cameras."""


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


class FoundLoop(NamedTuple):
    """A revisit that was searched, and what came of it."""

    a: int
    b: int
    """Frames of the chain."""
    T_a_b: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]
    """Of its right tangent [m, rad]."""
    nats_over_second: float
    reasons: tuple[str, ...]
    """Why it is no loop; empty where it is accepted."""

    @property
    def is_accepted(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.reasons


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
        found: list[FoundLoop] = []
        solution = self.solve(loops_of(found))
        for frames in told(groups(self.chain.way_m, self.config.revisit)):
            near = revisits(solution, self.chain.way_m, frames, self.config.revisit)
            for revisit in near[: self.config.max_passes]:
                loop = self.once(revisit, partial(self.searched, revisit, solution))
                if loop is None:
                    continue
                found.append(loop)
                if loop.is_accepted:
                    # What the loop tells makes the next search narrower.
                    solution = self.solve(loops_of(found))
                    break
        return found, solution

    def searched(self, revisit: Revisit, solution: ChainSolution) -> FoundLoop | None:
        """The loop of a revisit; None where there is nothing to search in."""
        chain, config = self.chain, self.config
        stretch = np.flatnonzero(np.abs(chain.way_m - chain.way_m[revisit.a]) <= config.stretch_m)
        stretch = stretch[chain.way_m[stretch] < chain.way_m[revisit.frames[0]]]
        semantic_map = self.map_of(stretch)
        if semantic_map is None or semantic_map.num_elements == 0:
            return None
        Ts, T_odom_a = solution.Ts_map_base, chain.Ts_odom_base[revisit.a]
        T_b_map = rigid.inverse(Ts[revisit.b])
        T_a_b = rigid.inverse(Ts[revisit.a]) @ Ts[revisit.b]
        views = [View(*self.look(k), T_b_map @ Ts[k]) for k in revisit.frames]
        sigma_xy_m = max(revisit.sigma_xy_m, config.least_prior_m)
        sigma_heading_rad = max(revisit.sigma_heading_rad, float(np.deg2rad(config.least_prior_deg)))
        try:
            localizer = FrameLocalizer(semantic_map, self.table, config.scene)
            places = search_places(localizer, views, T_odom_a @ T_a_b, sigma_xy_m, sigma_heading_rad)
        except SemlocError:  # the map of the stretch has no class of these masks, or no road there
            return None
        if not places:
            return FoundLoop(revisit.a, revisit.b, T_a_b, revisit.covariance, 0.0, ("no frame sees the map",))
        best, lead = places[0], lead_nats(places)
        covariance = best.covariance + np.diag(np.square(config.map_sigma))
        T_found = rigid.inverse(T_odom_a) @ best.T_map_middle
        off = rigid.log(rigid.inverse(T_a_b) @ T_found)
        reasons = tuple(against(best, lead, off, covariance + revisit.covariance, config))
        return FoundLoop(revisit.a, revisit.b, T_found, covariance, lead, reasons)


def against(best: Place, lead: float, off: np.ndarray, covariance: np.ndarray, config: LoopConfig) -> Iterable[str]:
    """Everything that speaks against a place."""
    seen, num = int(best.is_seen.sum()), len(best.is_seen)
    if seen < max(2.0, config.min_seen_share * num):
        yield f"{seen} of {num} frames see it"
        if seen == 0:
            return
    if lead < config.min_lead_nats:
        yield f"{lead:.1f} nats over the second place"
    if best.explained < config.min_explained:
        yield f"{best.explained:.0%} of the map in view on borders of the masks"
    if best.chi_square > chdtri(max(3 * (seen - 1), 1), 1.0 - config.probability):
        yield f"frames disagree: chi-square {best.chi_square:.0f} of {3 * (seen - 1)}"
    square = float(off[PLANE] @ np.linalg.solve(covariance[np.ix_(PLANE, PLANE)], off[PLANE]))
    if square > chdtri(3, 1.0 - config.way_probability):
        yield f"{np.hypot(*off[:2]):.1f} m from where the way ends: chi-square {square:.0f} of 3"


def loops_of(found: Sequence[FoundLoop]) -> Loops:
    """The accepted ones, for the graph."""
    accepted = [loop for loop in found if loop.is_accepted]
    return Loops(
        np.array([loop.a for loop in accepted], int),
        np.array([loop.b for loop in accepted], int),
        np.array([loop.T_a_b for loop in accepted]).reshape(-1, 4, 4),
        np.array([loop.covariance for loop in accepted]).reshape(-1, 6, 6),
    )


COLUMNS = "t_a,t_b,x,y,z,qx,qy,qz,qw,sigma_lateral_m,sigma_longitudinal_m,nats_over_second,accepted"
"""Times [s], T_a_b [m], its standard deviations, evidence over the second-best place, 1 where it is accepted else 0."""


def write_loops(path: str | Path, found: Sequence[FoundLoop], times_s: Float[np.ndarray, " n"]) -> None:
    """Write `loops.csv`: every revisit that was searched.

    Args:
        path: File.
        found: The revisits.
        times_s: Of the frames of the chain.
    """
    lines = [COLUMNS]
    for loop in found:
        times = f"{times_s[loop.a]:.9f},{times_s[loop.b]:.9f}"
        pose = [*loop.T_a_b[:3, 3], *Rotation.from_matrix(loop.T_a_b[:3, :3]).as_quat()]
        numbers = ",".join(f"{value:.6f}" for value in pose)
        sigmas = ",".join(f"{np.sqrt(loop.covariance[axis, axis]):.4f}" for axis in (1, 0))
        lines.append(f"{times},{numbers},{sigmas},{loop.nats_over_second:.2f},{int(loop.is_accepted)}")
    write_text(path, "\n".join(lines) + "\n")
