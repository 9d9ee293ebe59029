"""Loops of the literature: an earlier and a later local map matched point by point (room: mapping; host).

In: Chain, what matches two stretches. Out: FoundLoop list and the way with the accepted ones.
Candidates are those of `mapping.revisits`: earlier passes within reach of where the way ends. Nothing asks for the
second-best place: that is what ours adds.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.class_icp import ClassPoints, IcpResult
from semloc_jax.geometry import rigid
from semloc_jax.mapping.chain import Chain
from semloc_jax.mapping.chain_graph import ChainSolution, Loops
from semloc_jax.mapping.found_loops import FoundLoop, loops_of, without_outvoted
from semloc_jax.mapping.revisits import Revisit, RevisitConfig, groups, revisits

PLANE = [0, 1, 5]
_MATCH_SIGMA = np.array([0.1, 0.1, 0.2, np.deg2rad(1.0), np.deg2rad(1.0), np.deg2rad(0.2)])
"""Errors of two local maps that bend by odometry, which no ICP tells [m, rad]; ours."""
_MAX_PASSES = 2
"""Earlier passes that are tried for one group, nearest first; as in our own search."""


class LiteratureMap(NamedTuple):
    """What a system of the literature makes of a drive."""

    Ts_map_base: Float[np.ndarray, "n 4 4"]
    loops: list[FoundLoop]
    """Every pair of local maps that was matched; `nats_over_second` is 0: nobody asked for a second place."""
    points: ClassPoints
    """The map: points in the plane of the map, each of an `ElementClass`."""


Match = Callable[[Revisit, Float[np.ndarray, "4 4"]], FoundLoop | None]
"""A revisit and T_a_b as the way has it -> the loop, accepted or not; None where there is nothing to match."""


def loops_by(
    match: Match,
    chain: Chain,
    solve: Callable[[Loops], ChainSolution],
    config: RevisitConfig | None = None,
    told: Callable[[Iterable], Iterable] = iter,
) -> tuple[list[FoundLoop], ChainSolution]:
    """Every revisit that was matched, and the way with the accepted ones.

    Args:
        match: what makes a loop of a revisit.
        chain: from wheels and inertial sensor.
        solve: the way with the loops that were accepted so far.
        config: which places are looked at again; None for the defaults.
        told: wraps the groups of frames, to show progress.
    """
    config = config or RevisitConfig()
    found: list[FoundLoop] = []
    solution = solve(loops_of(found))
    for frames in told(groups(chain.way_m, config)):
        for revisit in revisits(solution, chain.way_m, frames, config)[:_MAX_PASSES]:
            Ts = solution.Ts_map_base
            loop = match(revisit, rigid.inverse(Ts[revisit.a]) @ Ts[revisit.b])
            if loop is None:
                continue
            found.append(loop)
            if loop.is_accepted:
                solution = solve(loops_of(found))
                break
    return without_outvoted(found, solution.is_kept), solution


def found_loop(
    revisit: Revisit, T_a_b: Float[np.ndarray, "4 4"], icp: IcpResult, reasons: tuple[str, ...]
) -> FoundLoop:
    """The loop that an ICP gives: its motion in the plane, height and tilt as the way has them.

    Args:
        revisit: the two stretches.
        T_a_b: motion between them by the way, where the ICP started.
        icp: `T_target_source` moves points of the base frame of `b` into that of `a`.
        reasons: why it is no loop.
    """
    heading = float(np.arctan2(T_a_b[1, 0], T_a_b[0, 0]))
    T_plane = rigid.planar_pose(float(T_a_b[0, 3]), float(T_a_b[1, 3]), heading)
    covariance = np.diag(_MATCH_SIGMA**2)
    if np.isfinite(icp.covariance).all():
        covariance[np.ix_(PLANE, PLANE)] += icp.covariance
    T_found = icp.T_target_source @ rigid.inverse(T_plane) @ T_a_b
    return FoundLoop(revisit.a, revisit.b, T_found, covariance, 0.0, reasons)
