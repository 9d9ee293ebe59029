"""How high everything is, when each drive has heights of its own (room: mapping; host).

In: Fused. Out: height of each thing and of each station of the lines. Satellite heights are off by metres and odometry
lets them drift: a drive's heights are off by one number at each node of its way, a walk from node to node.
"""

from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve

from semloc_jax.geometry import polyline
from semloc_jax.mapping.crowd.fusion import Fused

_NODE_M = 25.0
_FIRST_M, _BASE_M, _WALK_M, _SEEN_M, _SMOOTH_M, _FREE_M = 3.0, 0.02, 0.15, 0.08, 0.02, 100.0
"""Standard deviations: of a drive's first node, of a base map, of the walk, of one sight, of a line's bend; ours."""


def heights(fused: Fused) -> tuple[Float[np.ndarray, " n"], list[np.ndarray]]:
    """Height of the lowest point of each thing, and of each station of each line [m]."""
    world = fused.world
    first_station = len(world.kind) + np.cumsum([0, *(len(line.reference) for line in world.lines)])
    size = int(first_station[-1])
    rows, columns, values, targets, count = [], [], [], [], 0

    def add(entries: list[tuple[np.ndarray, np.ndarray]], target: np.ndarray, sigma_m: float) -> None:
        nonlocal count
        for column, value in entries:
            rows.append(count + np.arange(len(target)))
            columns.append(np.asarray(column, dtype=np.int64))
            values.append(np.broadcast_to(value, len(target)) / sigma_m)
        targets.append(target / sigma_m)
        count += len(target)

    for k, (drive, seen) in enumerate(zip(fused.drives, fused.seen, strict=True)):
        if k in fused.distrusted:
            continue
        sights = drive.sights
        things = sights.things
        z = np.array([e.points[:, 2].min() for e in things.elements])[seen.pairs[:, 0]]
        xy = np.vstack([things.centre[seen.pairs[:, 0]], seen.places[:, :2]])
        column = np.concatenate([seen.pairs[:, 1], first_station[seen.line] + seen.station])
        measured = np.concatenate([z, seen.places[:, 2]])
        if sights.is_base:
            add([(column, np.ones(len(column)))], measured, _BASE_M)
            continue
        length_m = float(polyline.arc_length(sights.way)[-1])
        num = max(round(length_m / _NODE_M), 1) + 1
        at = np.clip(sights.feet(xy)[0] * (num - 1) / length_m, 0.0, num - 1 - 1e-9)
        low, share = at.astype(int), at % 1.0
        ones = np.ones(len(column))
        add([(column, ones), (size + low, share - 1.0), (size + low + 1, -share)], measured, _SEEN_M)
        add([(np.array([size]), np.ones(1))], np.zeros(1), _FIRST_M)
        nodes = np.arange(num - 1)
        add([(size + nodes, -np.ones(num - 1)), (size + nodes + 1, np.ones(num - 1))], np.zeros(num - 1), _WALK_M)
        size += num
    for line, first in zip(world.lines, first_station[:-1], strict=True):
        inner = np.arange(max(len(line.reference) - 2, 0))
        ones = np.ones(len(inner))
        places = [(first + inner, ones), (first + inner + 1, -2.0 * ones), (first + inner + 2, ones)]
        add(places, np.zeros(len(inner)), _SMOOTH_M)
    everything = np.arange(int(first_station[-1]))
    add([(everything, np.ones(len(everything)))], np.zeros(len(everything)), _FREE_M)
    A = coo_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (count, size)).tocsc()
    found = spsolve((A.T @ A).tocsc(), A.T @ np.concatenate(targets))
    things = found[: len(world.kind)]
    return things, [found[a:b] for a, b in pairwise(first_station)]
