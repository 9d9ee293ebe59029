"""Where a drive lies in a map that is there already (room: mapping; host).

In: the chain of a drive, masks, a map, a first guess of the way. Out: places, accepted or not; the way with them.
As for loops: a place counts where several frames agree on it, nothing else explains them nearly as well, and the way
allows it. The way before the first place may be off by what satellite fixes or a start leave open.
"""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.errors import SemlocError
from semloc_jax.fusion.window_state import sqrt_information
from semloc_jax.geometry import rigid
from semloc_jax.mapping.chain import Chain
from semloc_jax.mapping.chain_graph import ChainSolution, MapPlaces
from semloc_jax.mapping.found_loops import FoundLoop, row_of
from semloc_jax.mapping.loops import LoopConfig, Once, against, weighed_by_way
from semloc_jax.mapping.place_search import Look, lead_nats, search_places, views_of
from semloc_jax.mapping.revisits import Revisit, groups
from semloc_jax.maps import SemanticMap
from semloc_jax.perception import ClassTable
from semloc_jax.storage import write_text

THE_MAP = -1
"""Stands for the map where a loop names its earlier frame."""
_LEAST_ROTATION_RAD = 0.01
"""What a map without heights leaves open of roll and pitch."""
COLUMNS = "t,x,y,z,qx,qy,qz,qw,sigma_lateral_m,sigma_longitudinal_m,nats_over_second,accepted,reasons"


def find_places(
    chain: Chain,
    look: Look,
    base: SemanticMap,
    table: ClassTable,
    solve: Callable[[MapPlaces], ChainSolution],
    config: LoopConfig,
    once: Once = lambda _, search: search(),
    told: Callable[[Iterable], Iterable] = iter,
) -> tuple[list[FoundLoop], ChainSolution]:
    """Every group of frames that was searched in the map, and the way with the accepted ones.

    Args:
        chain: way of the drive.
        look: masks of a frame and their cameras.
        base: the map.
        table: class table of the masks.
        solve: the way with the places that were accepted so far.
        config: when a place counts.
        once: gives what an earlier run found, or searches.
        told: wraps the groups, to show progress.

    Raises:
        SemlocError: the drive was found nowhere in the map.
    """
    localizer, num = FrameLocalizer(base, table, config.scene), len(chain.times_s)
    found: dict[tuple[int, ...], FoundLoop] = {}

    def look_at(frames: tuple[int, ...], way: ChainSolution, is_second_look: bool) -> None:
        b = frames[len(frames) // 2]
        revisit = Revisit(THE_MAP, b, frames, way.covariance(np.array([b])), is_second_look)
        if revisit.sigma_xy_m > config.revisit.max_sigma_m:
            return
        place = once(revisit, lambda: _searched(localizer, look, revisit, way, config))
        if place is not None:
            found[frames] = place

    solution = solve(places_of([], num))
    for frames in told(groups(chain.way_m, config.revisit)):
        look_at(frames, solution, is_second_look=False)
        if frames in found and found[frames].is_accepted:
            solution = solve(places_of(found.values(), num))
    open_ones = [frames for frames, place in found.items() if not place.is_accepted]
    if len(open_ones) < len(found):
        for frames in told(open_ones):  # by the way as the first look leaves it: no second look confirms another
            look_at(frames, solution, is_second_look=True)
        solution = solve(places_of(found.values(), num))
    if not any(place.is_accepted for place in found.values()):
        reasons = sorted({reason for place in found.values() for reason in place.reasons})
        raise SemlocError(
            f"base map {base.name}: none of {len(found)} groups of frames was found in it"
            f"{f' ({reasons[0]})' if reasons else ''}; give --start a pose in it, and check that it covers the drive"
        )
    return list(found.values()), solution


def _searched(
    localizer: FrameLocalizer, look: Look, revisit: Revisit, solution: ChainSolution, config: LoopConfig
) -> FoundLoop | None:
    T = solution.Ts_map_base[revisit.b]
    T_b_map = rigid.inverse(T)
    views = views_of(look, revisit.frames, revisit.b, solution)
    sigma_xy_m = max(revisit.sigma_xy_m, config.least_prior_m)
    sigma_heading_rad = max(revisit.sigma_heading_rad, float(np.deg2rad(config.least_prior_deg)))
    try:
        places = search_places(localizer, views, T, sigma_xy_m, sigma_heading_rad)
    except SemlocError:  # the map has no class of these masks, or no road there
        return None
    if not places:
        return FoundLoop(revisit.a, revisit.b, T, revisit.covariance, 0.0, ("no frame sees the map",))
    if revisit.is_second_look:
        places = weighed_by_way(places, T, sigma_xy_m, sigma_heading_rad)
    best, lead = places[0], lead_nats(places)
    covariance = best.covariance + np.diag(np.square(config.map_sigma))
    off = rigid.log(T_b_map @ best.T_map_middle)
    reasons = tuple(against(best, lead, off, covariance + revisit.covariance, config))
    return FoundLoop(revisit.a, revisit.b, best.T_map_middle, covariance, lead, reasons)


def places_of(found: Iterable[FoundLoop], num: int) -> MapPlaces:
    """The accepted ones, for the graph of so many frames."""
    Ts, info = np.tile(np.eye(4), (num, 1, 1)), np.zeros((num, 6, 6))
    for place in found:
        if place.is_accepted:
            Ts[place.b] = place.T_a_b
            open_rad = np.diag([0.0, 0.0, 0.0, _LEAST_ROTATION_RAD, _LEAST_ROTATION_RAD, 0.0]) ** 2
            info[place.b] = sqrt_information(place.covariance + open_rad)
    return MapPlaces(Ts, info)


def heights_of(found: Iterable[FoundLoop], num: int) -> MapPlaces:
    """What the accepted ones say of heights alone, for a graph in which the same masks say the rest themselves."""
    Ts, info = places_of(found, num)
    height = np.zeros_like(info)
    for k in np.flatnonzero(info.any(axis=(1, 2))):
        height[k, 2, 2] = np.linalg.inv(info[k].T @ info[k])[2, 2] ** -0.5
    return MapPlaces(Ts, height)


def write_places(path: str | Path, found: Sequence[FoundLoop], times_s: Float[np.ndarray, " n"]) -> None:
    """Write `places.csv`: every place in the base map that was searched.

    Args:
        path: File.
        found: The places.
        times_s: Of the frames of the chain.
    """
    lines = [COLUMNS, *(f"{times_s[place.b]:.9f},{row_of(place)}" for place in found)]
    write_text(path, "\n".join(lines) + "\n")
