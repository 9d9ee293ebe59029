"""Halves of a map that end on borders which the other half explains (room: alignment; host).

In: where halves of the map end, what they see there. Out: what they see without borders that are taken.
A line whose paint is worn finds that of its neighbour where the neighbour is left out: the half then explains the masks
a decimetre or four aside, and says nothing of where the map lies.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from semloc_jax.alignment.seen_samples import SeenSamples
from semloc_jax.structs import MapSamples

_TAKEN_M = 0.15
"""A contour that lies nearer than this to where another of its class lies at the pose stands on the same border."""
_NEXT_M = 1.0
"""Samples of one contour are nearer to each other than this."""
_OTHER_CLASS_M = 1e3


def without_taken(
    seen: SeenSamples,
    T_map_base: Float[np.ndarray, "4 4"],
    Ts_half: Float[np.ndarray, "n 4 4"],
    parts: Bool[np.ndarray, "n p"],
    samples: MapSamples,
    channel: Int[np.ndarray, " p"],
    far_px: float,
) -> SeenSamples:
    """What halves see at their ends, with samples on a border that the other half explains at the pose as far from any.

    Args:
        seen: Of at least n poses, the first of them the ends of the halves.
        T_map_base: The pose that all of the map leads to.
        Ts_half: Where each half ends.
        parts: Samples of each half.
        samples: Of the map.
        channel: Of each sample; -1 for none.
        far_px: Distance that counts as far from any border [px].
    """
    p_map = np.asarray(samples.p_map, np.float64)
    at_pose = _seen_from(T_map_base, p_map)
    tangent = np.asarray(samples.tangent_map, np.float64) @ T_map_base[:3, :3]
    by_class = _OTHER_CLASS_M * channel[:, None]
    signed_px = seen.signed_px.copy()
    for k, (T, part) in enumerate(zip(Ts_half, parts, strict=True)):
        others = np.flatnonzero(~part & np.asarray(samples.valid) & (channel >= 0))
        rows = np.flatnonzero(seen.pose == k)
        if not len(others) or not len(rows):
            continue
        own = seen.sample[rows]
        here = _seen_from(T, p_map[own])
        tree = cKDTree(np.column_stack([at_pose[others], by_class[others]]))
        away_m, nearest = tree.query(np.column_stack([here, by_class[own]]), distance_upper_bound=_NEXT_M)
        near = np.flatnonzero(np.isfinite(away_m))
        other = others[nearest[near]]
        step = here[near] - at_pose[other]
        across = step - np.sum(step * tangent[other], axis=1, keepdims=True) * tangent[other]
        signed_px[rows[near[np.linalg.norm(across, axis=1) < _TAKEN_M]]] = far_px
    return replace(seen, signed_px=signed_px)


def _seen_from(T_map_base: np.ndarray, p_map: np.ndarray) -> np.ndarray:
    return (p_map - T_map_base[:3, 3]) @ T_map_base[:3, :3]
