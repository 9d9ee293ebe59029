"""What one drive saw of the world that all have seen (room: mapping; host).

In: CrowdWorld, a drive where it lies by now. Out: Seen: which of its things and places of lines are those of the world.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from semloc_jax.mapping.crowd.correction import Correction
from semloc_jax.mapping.crowd.world import CrowdWorld, turned_by
from semloc_jax.mapping.crowd.world_lines import line_sights

_LINE_SIGMA_M = 0.04
"""A line is off alike over several metres: its stations count less than they are many."""


@dataclass
class Seen:
    """What one drive saw of the world.

    Attributes:
        pairs: rows of its things and of those of the world.
        line, station: which stations of which lines.
        places: `float64[k 3]` where the drive itself places the line there [m].
        sigma_m: of each.
        factor: how much larger its errors are than it says, along, across and of lines.
    """

    pairs: Int[np.ndarray, "n 2"]
    line: Int[np.ndarray, " k"]
    station: Int[np.ndarray, " k"]
    places: Float[np.ndarray, "k 3"]
    sigma_m: Float[np.ndarray, " k"]
    factor: Float[np.ndarray, "3"] = field(default_factory=lambda: np.ones(3))


def seen_by(world: CrowdWorld, correction: Correction, gate_m: float) -> Seen:
    """What a drive saw of the world, by where it lies now."""
    if correction.sights.is_base:
        return _seen_by_base(world, correction)
    things = correction.sights.things
    along = turned_by(things.along, correction.turn(things.centre))
    pairs = world.paired(things, correction.moved_things(), along, gate_m)
    rows = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0))]
    for kind, pieces in correction.pieces().items():
        lines = [k for k, line in enumerate(world.lines) if line.kind == kind]
        if lines:
            own = line_sights([world.lines[k] for k in lines], [piece for _, piece in pieces], gate_m)
            rows.append((np.array(lines)[own.line], own.station, own.places, own.sigma_m))
    line, station, places, sigma = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    return Seen(pairs, line, station, places, np.maximum(sigma, _LINE_SIGMA_M))


def _seen_by_base(world: CrowdWorld, correction: Correction) -> Seen:
    """What a base map says: of all that was born of it, that it is where it was born."""
    own = np.flatnonzero(world.source[:, 0] == 0)
    pairs = np.stack([world.source[own, 1], own], axis=1)
    placed = {line.element.id: line for line in correction.placed_lines}
    rows = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0))]
    for k, line in enumerate(world.lines):
        if line.source[0] == 0:
            said = placed[line.source[1].id]
            num = len(said.placed)
            rows.append((np.full(num, k), np.arange(num), said.placed, np.full(num, said.sigma_m)))
    line, station, places, sigma = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    least_m = _LINE_SIGMA_M * correction.sights.num_drives**-0.5
    return Seen(pairs, line, station, places, np.maximum(sigma, least_m))
