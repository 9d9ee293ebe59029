"""Places a metre apart along a line (room: mapping; host).

In: vertices of a line. Out: its stations.
"""

import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.geometry import polyline

STATION_M = 1.0


def stations(xy: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "k c"]:
    """Places about a metre apart along a line, its ends among them."""
    xy = xy[np.append(True, np.linalg.norm(np.diff(xy[:, :2], axis=0), axis=1) > 1e-6)]
    if len(xy) < 2:
        return xy
    length_m = float(polyline.arc_length(xy)[-1])
    return polyline.interpolate(xy, np.linspace(0.0, length_m, max(round(length_m / STATION_M), 1) + 1))


def runs_of(is_in: Bool[np.ndarray, " k"]) -> list[tuple[int, int]]:
    """First place of each run, and the first place behind it."""
    borders = np.flatnonzero(np.diff(np.concatenate([[False], is_in, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in borders.reshape(-1, 2)]
