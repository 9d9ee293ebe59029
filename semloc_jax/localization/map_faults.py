"""Which elements of the map the drive contradicts (room: localization; host).

In: how much of each element every frame saw and missed. Out: ElementTrust, a weight for each element, candidates for a
change of the map. What is wrong in the map is wrong in every frame; what a mask misses is missed in some. A frame costs
what lies around it: only elements that were in view are kept.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from semloc_jax.localization.track_state import ElementTrust
from semloc_jax.maps import SemanticMap


@dataclass(frozen=True)
class TrustConfig:
    """When an element of the map is no longer trusted. All values are our choice."""

    memory: float = 0.97
    """What a frame leaves of the frames before it."""
    min_frames: float = 4.0
    """An element that was in view less often keeps its weight."""
    min_visible_px: float = 8.0
    """A frame that sees less of an element says nothing about it."""
    good_share: float = 0.55
    """Elements that are missed by no more than this share keep their weight."""
    bad_share: float = 0.85
    """From here on an element hardly counts."""
    least_weight: float = 0.05
    candidate_share: float = 0.7
    """Elements that are missed by more than this are reported."""
    candidate_frames: float = 8.0
    candidate_px: float = 250.0
    """An element of which all frames together saw less says little: thin and far paint is missed by any network."""


class MapChange(NamedTuple):
    """An element that the map may have wrong."""

    row: int
    """Its place in the map."""
    element_id: str
    label: str
    missed_share: float
    num_frames: int
    weight: float


def full_trust(num_elements: int) -> ElementTrust:
    """Nothing seen yet of a map of so many elements."""
    return ElementTrust(np.zeros(0, np.int64), *(np.zeros(0) for _ in range(3)), np.int64(num_elements))


def updated(
    trust: ElementTrust,
    visible_px: Float[np.ndarray, " element"],
    missed_px: Float[np.ndarray, " element"],
    config: TrustConfig,
    rows: Int[np.ndarray, " element"] | None = None,
) -> ElementTrust:
    """The trust after one well aligned frame; elements out of view keep theirs.

    Args:
        trust: Before the frame.
        visible_px: Contour of each element that the frame shows [px].
        missed_px: Robust cost of it [px].
        config: Memory, and how little says nothing.
        rows: Which elements of the map these are, each named once; None: all, in their order.
    """
    rows = np.arange(len(visible_px)) if rows is None else rows
    is_seen = visible_px >= config.min_visible_px
    rows, visible_px, missed_px = rows[is_seen], visible_px[is_seen], missed_px[is_seen]
    trust = _with_rows(trust, rows)
    at = np.searchsorted(trust.rows, rows)
    # A frame counts by how much it shows, but none by more than a few: near views are not everything.
    gain = np.minimum(visible_px, 100.0) / np.maximum(visible_px, 1e-9)
    seen_px, in_vain_px, num_frames = trust.seen_px.copy(), trust.missed_px.copy(), trust.num_frames.copy()
    seen_px[at] = config.memory * seen_px[at] + gain * visible_px
    in_vain_px[at] = config.memory * in_vain_px[at] + gain * missed_px
    num_frames[at] += 1.0
    return trust._replace(seen_px=seen_px, missed_px=in_vain_px, num_frames=num_frames)


def _with_rows(trust: ElementTrust, rows: np.ndarray) -> ElementTrust:
    """The trust with a place for every one of the rows."""
    new = np.setdiff1d(rows, trust.rows)
    if not len(new):
        return trust
    at = np.searchsorted(trust.rows, new)
    known = (np.insert(values, at, 0.0) for values in (trust.seen_px, trust.missed_px, trust.num_frames))
    return ElementTrust(np.insert(trust.rows, at, new), *known, trust.num_in_map)


def missed_share(trust: ElementTrust) -> Float[np.ndarray, " element"]:
    """Share of each element of the trust that lay on no boundary of its class; 0 for what was not seen."""
    return np.where(trust.seen_px > 0, trust.missed_px / np.maximum(trust.seen_px, 1e-9), 0.0)


def weights(
    trust: ElementTrust, config: TrustConfig, rows: Int[np.ndarray, " element"] | None = None
) -> Float[np.ndarray, " element"]:
    """Weight of each element, 1 for those that nothing speaks against.

    Args:
        trust: What the drive says so far.
        config: What counts against an element.
        rows: Rows of the wanted elements, in any order; None: all of them.
    """
    rows = np.arange(int(trust.num_in_map)) if rows is None else rows
    found = np.ones(len(rows))
    if not len(trust.rows):
        return found
    at = np.minimum(np.searchsorted(trust.rows, rows), len(trust.rows) - 1)
    is_known = trust.rows[at] == rows
    found[is_known] = _weight_of_known(trust, config)[at[is_known]]
    return found


def _weight_of_known(trust: ElementTrust, config: TrustConfig) -> Float[np.ndarray, " element"]:
    share = missed_share(trust)
    badness = np.clip((share - config.good_share) / (config.bad_share - config.good_share), 0.0, 1.0)
    badness = badness * np.clip(trust.num_frames / config.min_frames - 1.0, 0.0, 1.0)
    return 1.0 - (1.0 - config.least_weight) * badness


def map_changes(trust: ElementTrust, semantic_map: SemanticMap, config: TrustConfig) -> list[MapChange]:
    """Elements that the drive contradicts, the clearest first."""
    share, weight = missed_share(trust), _weight_of_known(trust, config)
    is_seen = (trust.num_frames >= config.candidate_frames) & (trust.seen_px >= config.candidate_px)
    doubtful = np.flatnonzero((share >= config.candidate_share) & is_seen)
    found = []
    for k in doubtful:
        row = int(trust.rows[k])
        element = semantic_map.element_at(row)
        known = (float(share[k]), int(trust.num_frames[k]), float(weight[k]))
        found.append(MapChange(row, element.id, element.label.name.lower(), *known))
    return sorted(found, key=lambda change: -change.missed_share)
