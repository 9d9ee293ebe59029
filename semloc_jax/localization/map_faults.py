"""Which elements of the map the drive contradicts (room: localization; host).

In: how much of each element every frame saw and missed. Out: ElementTrust, a weight for each element, candidates for a
change of the map. What is wrong in the map is wrong in every frame; what a mask misses is missed in some.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from semloc_jax.localization.track_state import ElementTrust
from semloc_jax.maps import SemanticMap


@dataclass(frozen=True)
class TrustConfig:
    """When an element is no longer believed. All values are ours."""

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

    element_id: str
    label: str
    missed_share: float
    num_frames: int
    weight: float


def full_trust(num_elements: int) -> ElementTrust:
    """Nothing seen yet."""
    return ElementTrust(*(np.zeros(num_elements) for _ in ElementTrust._fields))


def updated(
    trust: ElementTrust,
    visible_px: Float[np.ndarray, " element"],
    missed_px: Float[np.ndarray, " element"],
    config: TrustConfig,
) -> ElementTrust:
    """The trust after one well aligned frame; elements out of view keep theirs."""
    seen = visible_px >= config.min_visible_px
    keep = np.where(seen, config.memory, 1.0)
    # A frame counts by how much it shows, but none by more than a few: near views are not everything.
    gain = np.where(seen, np.minimum(visible_px, 100.0) / np.maximum(visible_px, 1e-9), 0.0)
    return ElementTrust(
        keep * trust.seen_px + gain * visible_px,
        keep * trust.missed_px + gain * missed_px,
        trust.num_frames + seen,
    )


def missed_share(trust: ElementTrust) -> Float[np.ndarray, " element"]:
    """Share of each element that lay on no boundary of its class; 0 for what was not seen."""
    return np.where(trust.seen_px > 0, trust.missed_px / np.maximum(trust.seen_px, 1e-9), 0.0)


def weights(trust: ElementTrust, config: TrustConfig) -> Float[np.ndarray, " element"]:
    """Weight of each element, 1 for those that nothing speaks against."""
    share = missed_share(trust)
    badness = np.clip((share - config.good_share) / (config.bad_share - config.good_share), 0.0, 1.0)
    badness = badness * np.clip(trust.num_frames / config.min_frames - 1.0, 0.0, 1.0)
    return 1.0 - (1.0 - config.least_weight) * badness


def map_changes(trust: ElementTrust, semantic_map: SemanticMap, config: TrustConfig) -> list[MapChange]:
    """Elements that the drive contradicts, the clearest first."""
    share, weight = missed_share(trust), weights(trust, config)
    is_seen = (trust.num_frames >= config.candidate_frames) & (trust.seen_px >= config.candidate_px)
    doubtful = np.flatnonzero((share >= config.candidate_share) & is_seen)
    found = [
        MapChange(
            semantic_map.element_at(int(k)).id,
            semantic_map.element_at(int(k)).label.name.lower(),
            float(share[k]),
            int(trust.num_frames[k]),
            float(weight[k]),
        )
        for k in doubtful
    ]
    return sorted(found, key=lambda change: -change.missed_share)
