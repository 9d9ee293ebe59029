"""Lines as elements again: runs of stations that are there (room: mapping; host).

In: world lines, heights and presence of their stations. Out: an element and a belief for each run.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from semloc_jax.mapping.crowd.presence import Looks, Presence
from semloc_jax.mapping.crowd.sights import CROWD
from semloc_jax.mapping.crowd.stations import STATION_M, runs_of
from semloc_jax.mapping.crowd.world import LEAST_LINE_M
from semloc_jax.mapping.crowd.world_lines import WorldLine
from semloc_jax.maps import Belief, MapElement

_GAP_STATIONS = 3
"""A line goes on over so many stations that nobody sees."""
_SIGMA_M = 0.04
_LEAST_SIGMA_M = 0.005


@dataclass(frozen=True)
class LineRun:
    """A part of a line that is there.

    Attributes:
        element: with the id of what it was born of.
        belief: in it.
        source: place of the drive it was born of.
        part: 0 for the longest part of its line, then 1, 2 ...
    """

    element: MapElement
    belief: Belief
    source: int
    part: int


def lines_of(lines: Sequence[WorldLine], heights: Sequence[np.ndarray], looks: Looks, there: Presence) -> list[LineRun]:
    """The parts of all lines that are there.

    Args:
        lines: all of them.
        heights: of the stations of each [m].
        looks: at the stations of all, in their order.
        there: what the looks say.
    """
    found: list[LineRun] = []
    first = np.cumsum([0, *(len(line.reference) for line in lines)])
    counts = looks.counts
    part_of: dict[tuple[int, str], int] = {}
    for k, line in enumerate(lines):
        rows = slice(int(first[k]), int(first[k + 1]))
        runs = runs_of(_closed(there.now[rows] > 0.5))
        for a, b in sorted(runs, key=lambda run: (run[0] - run[1], run[0])):
            if (b - a - 1) * STATION_M < LEAST_LINE_M:
                continue
            place, source = line.source
            part = part_of.get((place, source.id), 0)
            part_of[place, source.id] = part + 1
            points = np.column_stack([line.xy[a:b], heights[k][a:b]])
            ends = (source.true_ends[0] and a == 0, source.true_ends[1] and b == len(line.reference))
            element = replace(source, points=points, true_ends=ends, attributes={})
            found.append(LineRun(element, _belief(counts[rows][a:b], there.now[rows][a:b]), place, part))
    return found


def _closed(is_there: Bool[np.ndarray, " k"]) -> Bool[np.ndarray, " k"]:
    """Short gaps between stations that are there are closed."""
    closed = is_there.copy()
    rows = np.flatnonzero(is_there)
    for a, b in pairwise(rows):
        if b - a - 1 <= _GAP_STATIONS:
            closed[a:b] = True
    return closed


def _belief(counts: Int[np.ndarray, "k 2"], now: Float[np.ndarray, " k"]) -> Belief:
    """Of a run of stations: how many drives saw and missed each, and how likely each is there."""
    seen, missed = counts.T
    sigma_m = round(max(_SIGMA_M / float(np.sqrt(max(np.median(seen), 1.0))), _LEAST_SIGMA_M), 3)
    p = float(np.clip(np.median(now), 1e-6, 1.0 - 1e-6))
    logit = float(np.clip(np.round(2.0 * np.log(p / (1.0 - p))) / 2.0, -6.0, 6.0))
    return Belief(sigma_m, STATION_M, logit, int(np.median(seen)), int(np.median(missed)), provenance=CROWD)
