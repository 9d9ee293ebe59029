"""Paint of which a drive saw a part only, though both ends of that part are clear (room: mapping; host).

In: dashes and bars that one drive saw. Out: which are shorter than those of their row. Wear and traffic cut paint off:
the middle of what is left lies 0.4 to 1.6 m from that of the dash. Whole dashes of a road are as long as some others
within centimetres, and so are the bars of a crosswalk; what is left of one is as long as chance has it.
"""

import numpy as np
from jaxtyping import Bool, Float

FRAGMENTED = ("dash", "crosswalk")
"""Kinds that are painted in rows of equal lengths."""
_REACH_M = {"dash": (150.0, 40.0), "crosswalk": (1.5, 8.0)}
"""How far along and across its direction those lie that it is compared with."""
_ALIKE, _LEAST, _OF_ALL = 0.05, 3, 0.1
"""A length is one of paint if so many have it within that share, and of all that is near so large a share; ours."""
_SHORTER, _SHORTER_M = 0.8, 0.3
"""What is left is shorter than that share of a length of paint, and by more than borders of masks are off; ours."""


def are_fragments(
    kind: np.ndarray,
    centre: Float[np.ndarray, "n 2"],
    along: Float[np.ndarray, "n 2"],
    half_m: Float[np.ndarray, "n 2"],
) -> Bool[np.ndarray, " n"]:
    """Which things are parts of longer ones.

    Args:
        kind: as `map_shapes` names them.
        centre: [m].
        along: unit, along the longest side.
        half_m: half the length and half the width.
    """
    found = np.zeros(len(kind), dtype=bool)
    for name, (ahead_m, aside_m) in _REACH_M.items():
        own = np.flatnonzero(kind == name)
        offset = centre[own][None] - centre[own][:, None]
        ahead = np.einsum("ijk,ik->ij", offset, along[own])
        aside = offset[..., 1] * along[own, None, 0] - offset[..., 0] * along[own, None, 1]
        is_near = (np.abs(ahead) < ahead_m) & (np.abs(aside) < aside_m)
        length_m = 2.0 * half_m[own, 0]
        alike = np.abs(length_m[:, None] - length_m) < _ALIKE * length_m[:, None]
        least = np.maximum(_LEAST, _OF_ALL * is_near.sum(axis=1))
        is_usual = is_near.astype(float) @ alike.T.astype(float) >= least[:, None]  # [seen from one, length of another]
        usual_m = np.where(is_near & is_usual, length_m, 0.0).max(axis=1, initial=0.0)
        is_short = length_m < np.minimum(_SHORTER * usual_m, usual_m - _SHORTER_M)
        found[own] = is_short & ~np.diagonal(is_usual)
    return found
