"""Lines as elements again: runs of stations that are there (room: mapping; host).

In: world lines, heights and presence of their stations. Out: an element and a belief for each run.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from semloc_jax.mapping.crowd.elements import LEAST_TOLD_BY, TOLD_ASIDE_M, logit_of, surveyed_belief
from semloc_jax.mapping.crowd.fusion import Fused
from semloc_jax.mapping.crowd.looks_chain import Looks
from semloc_jax.mapping.crowd.presence import Presence
from semloc_jax.mapping.crowd.sights import CROWD
from semloc_jax.mapping.crowd.stations import STATION_M, runs_of
from semloc_jax.mapping.crowd.world import LEAST_LINE_M
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
        is_surveyed: whether it is all of a line of a surveyed base map, there where that has it.
    """

    element: MapElement
    belief: Belief
    source: int
    part: int
    is_surveyed: bool = False


def lines_of(found: Fused, heights: Sequence[np.ndarray], looks: Looks, there: Presence) -> list[LineRun]:
    """The parts of all lines that are there.

    Args:
        found: the lines of all drives.
        heights: of the stations of each [m].
        looks: at the stations of all, in their order.
        there: what the looks say.
    """
    parts: list[LineRun] = []
    lines, surveyed = found.world.lines, _surveyed(found)
    first = np.cumsum([0, *(len(line.reference) for line in lines)])
    counts = looks.counts
    part_of: dict[tuple[int, str], int] = {}
    for k, line in enumerate(lines):
        rows = slice(int(first[k]), int(first[k + 1]))
        runs = runs_of(_closed(there.stays[rows]))
        for a, b in sorted(runs, key=lambda run: (run[0] - run[1], run[0])):
            if (b - a - 1) * STATION_M < LEAST_LINE_M:
                continue
            place, source = line.source
            part = part_of.get((place, source.id), 0)
            part_of[place, source.id] = part + 1
            points = np.column_stack([line.xy[a:b], heights[k][a:b]])
            ends = (source.true_ends[0] and a == 0, source.true_ends[1] and b == len(line.reference))
            belief = _belief(counts[rows][a:b], there.now[rows][a:b])
            if k in surveyed and (a, b) == (0, len(line.reference)):
                parts.append(LineRun(source, surveyed_belief(surveyed[k], belief), place, part, True))
                continue
            attributes = source.attributes if found.drives[place].sights.is_base else {}
            element = replace(source, points=points, true_ends=ends, attributes=attributes)
            parts.append(LineRun(element, belief, place, part))
    return parts


def _surveyed(found: Fused) -> dict[int, Belief]:
    """Which lines are whole lines of a surveyed base map that lie where it says, and its beliefs in them."""
    if not found.drives or not found.drives[0].is_held:
        return {}
    base = found.drives[0]
    num = {line.element.id: len(line.placed) for line in base.placed_lines}
    beliefs = {element.id: belief for element, belief in base.sights.lines}
    first = np.cumsum([0, *(len(line.reference) for line in found.world.lines)])
    told_by = np.zeros(int(first[-1]), dtype=np.int64)
    for seen in found.seen[1:]:
        told_by[first[seen.line] + seen.station] += 1
    return {
        k: beliefs[line.source[1].id]
        for k, line in enumerate(found.world.lines)
        if line.source[0] == 0
        and len(line.reference) == num[line.source[1].id]
        and not ((np.abs(line.offset_m) > TOLD_ASIDE_M) & (told_by[first[k] : first[k + 1]] >= LEAST_TOLD_BY)).any()
    }


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
    return Belief(
        sigma_m,
        STATION_M,
        logit_of(float(np.median(now))),
        int(np.median(seen)),
        int(np.median(missed)),
        provenance=CROWD,
    )
