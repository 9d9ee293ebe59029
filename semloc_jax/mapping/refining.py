"""The way of a drive made to agree with its own map, element by element (room: mapping; host).

In: the way with its loops closed. Out: poses at which all frames see the same map, and how sure they are.
A draft of the map is drawn along the way; every frame says how each element of the draft should lie; poses and elements
are solved together, looked at again from there, and so on. The map itself is then drawn anew along the new way.
Where a map is there already, its elements take the place of the draft, each held where the map has it.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from semloc_jax.datasets import Drive
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation.map_shapes import POSTS, thing_of
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.base_map import Countable
from semloc_jax.mapping.base_places import heights_of
from semloc_jax.mapping.chain import Chain
from semloc_jax.mapping.chain_graph import ChainGraphConfig, way_graph
from semloc_jax.mapping.closing import ClosedWay
from semloc_jax.mapping.element_pulls import ElementPulls, PullConfig, Pulls, pieces_of
from semloc_jax.mapping.found_loops import loops_of
from semloc_jax.mapping.joint import RefineConfig, moved, solve_together
from semloc_jax.mapping.mapper import MapConfig, make_map
from semloc_jax.mapping.parts import Parts
from semloc_jax.mapping.sizing import sized
from semloc_jax.mapping.way_sigmas import WaySigmas, places_apart, way_sigmas, with_size
from semloc_jax.maps import BeliefMap, MapElement, SemanticMap
from semloc_jax.perception.surround import PAINT
from semloc_jax.structs import ElementClass

_DRAFT = "draft"
_SIZE_LEFT = 0.4
"""Sigma of the size of a map as a share of what odometry, fixes and loops state, at least: shapes that were drawn along
the way hold its size more firmly than anything knows it. Ours: sizes of 25 drives with one camera were off by 0.43 of
what their sensors stated (0.43, 0.44, 0.43 in three worlds), of five with four cameras by 0.26, one of them by 0.45."""
_BESIDE_PAINT_M = 12.0
"""Who sees a curb well sees paint so far from it as well; ours."""


class RefinedWay(NamedTuple):
    """The way that a map is drawn along."""

    Ts_map_base: Float[np.ndarray, "n 4 4"]
    sigmas: WaySigmas


def refined_way(
    drive: Drive,
    masks: MaskSource,
    looking: Sequence[int],
    chain: Chain,
    closed: ClosedWay,
    config: MapConfig,
    told: Callable[[Iterable, str], Iterable] = lambda items, _: items,
    parts: Parts | None = None,
    base: BeliefMap | None = None,
) -> RefinedWay:
    """Poses of all frames of a drive, after what its frames say of the elements around them, and their sigmas.

    Args:
        drive: the drive.
        masks: what its cameras see.
        looking: rows of the frames that look at the road.
        chain: its way by its own sensors.
        closed: the same with its loops.
        config: how maps are made; `config.refine` says how often and how closely.
        told: shows how far it has come.
        parts: keeps the draft, and the way when it is done.
        base: map that is there already, in whose frame the drive was laid.
    """
    if config.refine.rounds == 0:
        return _as_closed(chain, looking, closed)

    def solved() -> RefinedWay:
        if base is None:
            rows = _apart(chain.way_m, looking, config.refine.draft_every_m)
            draft_parts = None if parts is None else Parts(parts.folder / _DRAFT)
            elements = _draft(drive, masks, rows, closed.Ts_map_base, config, told, draft_parts)
            held = None
        else:
            elements, held = _held(base, closed.Ts_map_base[:, :2, 3], config)
        if not elements:
            return _as_closed(chain, looking, closed)
        rows = _apart(chain.way_m, looking, config.refine.every_m)
        return _agreed(drive, masks, rows, chain, closed, elements, held, config.refine, told)

    if parts is None:
        return solved()

    def arrays() -> dict[str, np.ndarray]:
        way = solved()
        return {"Ts_map_base": way.Ts_map_base, **way.sigmas._asdict()}

    stored = parts.way(arrays)
    return RefinedWay(stored.pop("Ts_map_base"), WaySigmas(**stored))


def _as_closed(chain: Chain, looking: Sequence[int], closed: ClosedWay) -> RefinedWay:
    """The way as odometry and loops have it."""
    rows = places_apart(chain.way_m, looking)
    return RefinedWay(closed.Ts_map_base, way_sigmas(closed.Ts_map_base[rows], _of_sensors(chain, closed, rows)))


def _of_sensors(chain: Chain, closed: ClosedWay, rows: Int[np.ndarray, " k"]) -> Float[np.ndarray, "c c"]:
    """Joint covariance of the right tangents of some poses by odometry, fixes and loops alone."""
    return closed.gauge.solve(chain, loops_of(closed.loops)).covariance(rows)


def _apart(way_m: np.ndarray, looking: Sequence[int], every_m: float) -> np.ndarray:
    """Those of some frames that are the first in each step of the way."""
    rows = np.asarray(looking)
    _, first = np.unique(np.floor(way_m[rows] / every_m), return_index=True)
    return rows[first]


def _draft(
    drive: Drive,
    masks: MaskSource,
    rows: np.ndarray,
    Ts_map_base: np.ndarray,
    config: MapConfig,
    told: Callable[[Iterable, str], Iterable],
    parts: Parts | None,
) -> list[MapElement]:
    """What a mapper makes of some frames; empty where nothing stays."""
    look = replace(config.look, spacing_m=config.refine.draft_spacing_m)
    coarse = replace(config, look=look, settle=replace(config.settle, rounds=0))
    frames = [drive.frames[row] for row in rows]
    try:
        made = make_map(
            drive, masks, frames, Ts_map_base[rows], coarse, progress=lambda i, n: told(i, f"draft: {n}"), parts=parts
        )
    except SemlocError:  # what is wrong with the drive, its map will say
        return []
    drawn = [e for e in made.belief_map.map.elements if e.label != ElementClass.PARKING_SLOT]
    return holding([piece for element in drawn for piece in pieces_of(element)])


def holding(pieces: Sequence[MapElement]) -> list[MapElement]:
    """What of a draft frames are held against: all but pieces of curbs with paint around them.

    A curb stands out of the road, so that each lane sees it elsewhere; where there is no paint it is better than none.
    """
    paint = [piece.points[:, :2] for piece in pieces if piece.label in PAINT]
    if not paint:
        return list(pieces)
    tree = cKDTree(np.concatenate(paint))
    return [
        piece
        for piece in pieces
        if piece.label != ElementClass.CURB or tree.query(piece.points[:, :2])[0].min() > _BESIDE_PAINT_M
    ]


def _held(
    base: BeliefMap, way: Float[np.ndarray, "n 2"], config: MapConfig
) -> tuple[list[MapElement], Float[np.ndarray, "e 2 2"]]:
    """Elements of a map near a way [m] and how it holds them, along and across each as it believes."""
    labels = {element.label for element in base.map.elements} - {ElementClass.PARKING_SLOT}
    near = Countable.of(base, way, labels, config.uprights)
    elements, held = [], []
    for element in [*near.paint, *(upright.element for upright in near.uprights)]:
        belief, along = base.beliefs[element.id], thing_of(element).along
        sigma_along_m = belief.sigma_across_m if element.label in POSTS else belief.sigma_along_m
        own = np.array([along / sigma_along_m, np.array([-along[1], along[0]]) / belief.sigma_across_m])
        pieces = pieces_of(element)
        elements += pieces
        held += [own] * len(pieces)
    return elements, np.reshape(held, (-1, 2, 2))


def _agreed(
    drive: Drive,
    masks: MaskSource,
    rows: np.ndarray,
    chain: Chain,
    closed: ClosedWay,
    elements: list[MapElement],
    held: Float[np.ndarray, "e 2 2"] | None,
    config: RefineConfig,
    told: Callable[[Iterable, str], Iterable],
) -> RefinedWay:
    """The way after all rounds."""
    gauge, Ts = closed.gauge, closed.Ts_map_base
    places = None if held is None else heights_of(closed.places, len(chain.times_s))
    graph, values = way_graph(chain, loops_of(closed.loops), gauge.gnss, gauge.start, ChainGraphConfig(), places)
    sure = places_apart(chain.way_m, rows.tolist()).tolist()
    joint = config.joint(len(masks.cameras))
    for k in range(config.rounds):
        config_k = PullConfig(reach_px=config.reach_of(k), by_contours=held is not None)
        pulling = ElementPulls(SemanticMap(tuple(elements)), masks.table, config_k)

        def pull(row: int, Ts: np.ndarray = Ts, pulling: ElementPulls = pulling) -> Pulls:
            frame = drive.frames[row]
            return pulling.of(masks.masks(frame), masks.seen_by(frame.rig), Ts[row])

        pulls = [pull(int(row)) for row in told(rows, f"agreeing, round {k + 1} of {config.rounds}")]
        of_size, pulls = sized(elements, pulls, Ts[rows])
        found = solve_together(graph, {**values, "pose": Ts}, rows.tolist(), pulls, of_size, joint, sure, held)
        Ts = found.Ts_map_base
        if held is None:
            elements = [moved(e, found.motions[e.id]) if e.id in found.motions else e for e in of_size]
    covariance = found.covariance
    if held is None:
        covariance = with_size(Ts[sure], covariance, _of_sensors(chain, closed, np.asarray(sure)), _SIZE_LEFT)
    return RefinedWay(Ts, way_sigmas(Ts[sure], covariance))
