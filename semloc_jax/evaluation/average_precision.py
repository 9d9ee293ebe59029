"""Average precision of boxes with classes (room: evaluation; host).

In: boxes that were found with their confidence, true boxes, picture by picture. Out: AP at an overlap, recall and
precision at a threshold. AP is the area under precision, made falling, over recall (all points, as in VOC 2010).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float


class BoxSet(NamedTuple):
    """Boxes of one class in one picture.

    Args:
        found: float64[n 4], left, top, right, lower border.
        confidence: float64[n].
        true: float64[m 4].
        is_asked: bool[m]; others may be found or not: neither right nor wrong.
    """

    found: Float[np.ndarray, "n 4"]
    confidence: Float[np.ndarray, " n"]
    true: Float[np.ndarray, "m 4"]
    is_asked: Bool[np.ndarray, " m"]


class BoxScore(NamedTuple):
    """What was found of one class.

    Args:
        average_precision: NaN where nothing is asked.
        num_true: boxes that are asked for.
        recall, precision: of boxes above the threshold; NaN where there is nothing to share.
    """

    average_precision: float
    num_true: int
    recall: float
    precision: float


_LEAST_OVERLAP = 0.5
"""Share of the union that a box and the true one must have in common."""


def box_score(pictures: Sequence[BoxSet], threshold: float = 0.5) -> BoxScore:
    """Average precision of one class over some pictures.

    Each found box, the surest first, takes the true box that it overlaps most, if nobody took that before. One that
    takes a box that is not asked for, or lies in one for the most part, counts for nothing.

    Args:
        pictures: found and true boxes of each.
        threshold: confidence from which recall and precision are told.
    """
    sure, right = [], []
    for picture in pictures:
        order, taken = np.argsort(-picture.confidence, kind="stable"), np.zeros(len(picture.true), bool)
        for k in order:
            said = _judged(picture.found[k], picture, taken)
            if said is not None:
                sure.append(float(picture.confidence[k]))
                right.append(said)
    num = int(sum(picture.is_asked.sum() for picture in pictures))
    order = np.argsort(-np.array(sure), kind="stable")
    hits, confidence = np.array(right, bool)[order], np.array(sure)[order]
    above = confidence >= threshold
    recall = float(hits[above].sum() / num) if num else float("nan")
    precision = float(hits[above].mean()) if above.any() else float("nan")
    if not num:
        return BoxScore(float("nan"), 0, recall, precision)
    good = np.cumsum(hits)
    falling = np.maximum.accumulate((good / np.arange(1, len(hits) + 1))[::-1])[::-1]
    return BoxScore(float(falling[hits].sum() / num), num, recall, precision)


def _judged(box: np.ndarray, picture: BoxSet, taken: np.ndarray) -> bool | None:
    """Whether a box is right; None where it counts for nothing."""
    if len(picture.true):
        shared = box_overlap(box, picture.true)
        free = np.where(taken, -1.0, shared)
        best = int(free.argmax())
        if free[best] >= _LEAST_OVERLAP:
            taken[best] = True
            return True if picture.is_asked[best] else None
        others = picture.true[~picture.is_asked]
        if len(others) and _inside(box, others).max() > _LEAST_OVERLAP:
            return None
    return False


def box_overlap(box: Float[np.ndarray, " 4"], others: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, " n"]:
    """Share of the union of a box and each other that both cover."""
    common = _common(box, others)
    area = np.prod(box[2:] - box[:2]) + np.prod(others[:, 2:] - others[:, :2], axis=1)
    return common / np.maximum(area - common, 1e-9)


def _inside(box: np.ndarray, others: np.ndarray) -> Float[np.ndarray, " n"]:
    return _common(box, others) / max(float(np.prod(box[2:] - box[:2])), 1e-9)


def _common(box: np.ndarray, others: np.ndarray) -> Float[np.ndarray, " n"]:
    low, high = np.maximum(box[:2], others[:, :2]), np.minimum(box[2:], others[:, 2:])
    return np.prod(np.maximum(high - low, 0.0), axis=1)
