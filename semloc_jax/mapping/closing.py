"""The way of a drive with its loops closed in maps that it made itself (room: mapping; host).

In: a drive, its masks, chain and gauge. Out: ClosedWay: poses of its frames in the map, revisits that were searched.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.cameras import Rig
from semloc_jax.datasets import Drive
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.base_places import find_places, places_of
from semloc_jax.mapping.chain import Chain
from semloc_jax.mapping.chain_graph import MapPlaces
from semloc_jax.mapping.found_loops import FoundLoop
from semloc_jax.mapping.gauge import Gauge
from semloc_jax.mapping.loops import LoopConfig, LoopSearch, Once
from semloc_jax.mapping.mapper import MapConfig
from semloc_jax.mapping.parts import Parts
from semloc_jax.mapping.stretch_maps import StretchMaps
from semloc_jax.maps import SemanticMap

_GUESS_M, _GUESS_RAD = 2.0, 0.05
"""How far a start that is given may be off in a map that is there already; ours."""
_PLACES_EVERY_M = 25.0
"""Way between the groups of frames that are searched in it; ours."""
_PLACE_SIGMA_M = 0.5
"""How far a place in it may be open: it is where the map is, and may hold nothing but lines, which tie the way across
the road all the same; ours."""


class ClosedWay(NamedTuple):
    """The way of a drive in the frame of its map."""

    Ts_map_base: Float[np.ndarray, "n 4 4"]
    gauge: Gauge
    loops: list[FoundLoop]
    """Revisits that were searched, accepted or not."""
    places: list[FoundLoop]
    """Where groups of frames were searched in a base map, accepted or not; empty without one."""


def closed_way(
    drive: Drive,
    masks: MaskSource,
    chain: Chain,
    gauge: Gauge,
    config: MapConfig | None = None,
    told: Callable[[Iterable], Iterable] = iter,
    with_loops: bool = True,
    loop_config: LoopConfig | None = None,
    parts: Parts | None = None,
    base: SemanticMap | None = None,
) -> ClosedWay:
    """The most likely poses of all frames of a drive.

    Args:
        drive: the drive.
        masks: what its cameras see.
        chain: its way by its own sensors.
        gauge: what fixes the frame.
        config: how maps of stretches are made.
        told: wraps the groups of frames that are looked at, to show progress.
        with_loops: whether loops are looked for.
        loop_config: when a revisit is a loop; None for the defaults.
        parts: keeps what was searched; revisits that a run which was killed has searched are taken from there.
        base: a map that is there already, in whose frame the drive is laid; the gauge then is a first guess.

    Raises:
        SemlocError: the drive was found nowhere in the base map.
    """
    loop_config = loop_config or LoopConfig()

    def look(index: int) -> tuple[Sequence[np.ndarray], Rig]:
        frame = drive.frames[index]
        return masks.masks(frame), masks.seen_by(frame.rig)

    once: Once = parts.once if parts is not None else lambda _, search: search()
    places: list[FoundLoop] = []
    known: MapPlaces | None = None
    if base is not None:
        gauge = gauge.guessed(_GUESS_M, _GUESS_RAD)
        revisit = replace(loop_config.revisit, every_m=_PLACES_EVERY_M)
        config_here = replace(loop_config, revisit=revisit, max_sigma_m=_PLACE_SIGMA_M)
        places, solution = find_places(
            chain, look, base, masks.table, lambda p: gauge.solve(chain, places=p), config_here, once, told
        )
        known = places_of(places, len(chain.times_s))
    else:
        solution = gauge.solve(chain)
    if not with_loops or chain.way_m[-1] < loop_config.revisit.min_way_m:
        return ClosedWay(solution.Ts_map_base, gauge, [], places)
    map_of = StretchMaps(drive, masks, chain, config)
    search = LoopSearch(
        chain, look, map_of, masks.table, lambda loops: gauge.solve(chain, loops, known), loop_config, once
    )
    found, solution = search.run(told)
    return ClosedWay(solution.Ts_map_base, gauge, found, places)
