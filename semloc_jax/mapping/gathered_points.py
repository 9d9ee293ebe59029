"""Marking points of the last frames, laid over each other (room: mapping; host).

In: the points of each frame in odom, and which places it showed. Out: the points that the looks agree on.
What a network takes for a point by the light or the shape of one picture is elsewhere in the next, paint is not.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

FAINTEST = 0.15
"""Points that are less sure say nothing."""
_AGREED = 0.3
"""Mean confidence of all looks at a place from which it counts, those that do not show it with 0."""
_SAME_M, _SAME_WAY = 0.35, 0.5
"""Points so near to each other whose directions differ by less than 60 deg are one: at an L a network wavers between
both of its legs."""


@dataclass(frozen=True)
class PointLook:
    """The marking points of one frame.

    Attributes:
        places: `float64[n 2]` in odom [m].
        inward: unit directions into the slots.
        confidence: of each, down to `FAINTEST`.
        shows: whether the frame shows places of odom, `float64[k 2]`.
    """

    places: Float[np.ndarray, "n 2"]
    inward: Float[np.ndarray, "n 2"]
    confidence: Float[np.ndarray, " n"]
    shows: Callable[[Float[np.ndarray, "k 2"]], Bool[np.ndarray, " k"]]


def agreed_points(
    looks: Sequence[PointLook], threshold: float
) -> tuple[Float[np.ndarray, "k 2"], Float[np.ndarray, "k 2"]]:
    """Places [m] and unit directions of the points of the newest frame that the frames before it agree on.

    Where a point is says the newest frame alone: the odometry drifts, and sights of one thing are to be new ones.

    Args:
        looks: of one frame or more, the newest one last.
        threshold: confidence from which a point counts that one frame alone looks at.
    """
    places, inward, sure = (np.concatenate([getattr(look, part) for look in looks]) for part in _PARTS)
    frame = np.repeat(np.arange(len(looks)), [len(look.places) for look in looks])
    # The surest point of each frame; the newest frame comes last.
    groups = [rows[np.unique(frame[rows], return_index=True)[1]] for rows in _groups(places, inward, sure)]
    groups = [rows for rows in groups if frame[rows[-1]] == len(looks) - 1]
    if not groups:
        return np.zeros((0, 2)), np.zeros((0, 2))
    newest = places[[rows[-1] for rows in groups]]
    turn = np.array([sure[rows] @ inward[rows] for rows in groups])
    shown = np.sum([look.shows(newest) for look in looks], axis=0)
    num = np.maximum(shown, [len(rows) for rows in groups])
    mean = np.array([sure[rows].sum() for rows in groups]) / num
    kept = mean >= np.where(num > 1, _AGREED, threshold)
    return newest[kept], turn[kept] / np.linalg.norm(turn[kept], axis=1, keepdims=True)


_PARTS = ("places", "inward", "confidence")


def _groups(places: np.ndarray, inward: np.ndarray, sure: np.ndarray) -> list[np.ndarray]:
    """Rows of the points of one place, the surest first; each point is in one group."""
    left, groups = np.ones(len(places), bool), []
    for k in np.argsort(-sure, kind="stable"):
        if left[k]:
            near = np.linalg.norm(places - places[k], axis=1) < _SAME_M
            rows = np.flatnonzero(left & near & (inward @ inward[k] > _SAME_WAY))
            left[rows] = False
            groups.append(rows[np.argsort(-sure[rows], kind="stable")])
    return groups
