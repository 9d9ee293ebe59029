"""Whether the parts of a map agree about a pose (room: alignment; host).

In: elements and classes of map samples; the poses that parts of them lead to. Out: parts, the spread of their poses,
and how far kinds of elements contradict each other.
A pose is no better than the map: where elements lie anywhere or lines were painted anew, those that agree by chance
hold a pose that looks sure by its residuals. Halves of the elements that are solved alone end elsewhere then. What was
moved together (lines that were painted anew, a row of posts) is divided by no half: kinds of elements are.
"""

from dataclasses import dataclass

import numpy as np

from semloc_jax.alignment.posterior import differences
from semloc_jax.structs import STANDING_CLASSES, ElementClass

_LINES = (ElementClass.LANE_MARKING,)
_KINDS = (_LINES, tuple(STANDING_CLASSES))
"""Each is compared with all else in the map: what is painted anew or set up anew together."""
NUM_KINDS = 2 * len(_KINDS)
"""Parts that `kinds` makes."""


@dataclass(frozen=True)
class AgreementConfig:
    """How the halves are made. All values are ours."""

    num_splits: int = 8
    """Of the elements into two halves, at random."""
    seed: int = 0


def halves(element: np.ndarray, config: AgreementConfig) -> np.ndarray:
    """Which samples each half has, bool[1 + 2 splits, p]; the first row has all of them.

    Args:
        element: of each sample, int[p]; all samples of one element are of one half.
        config: Number of splits.
    """
    drawn = np.random.default_rng(config.seed).random((config.num_splits, int(element.max(initial=0)) + 1)) < 0.5
    first = drawn[:, np.maximum(element, 0)]
    return np.concatenate([np.ones((1, len(element)), bool), first, ~first])


def disagreement(T_local_base: np.ndarray, Ts_half: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Variance of a pose as the halves have it, float[3] (forward, left [m^2], heading [rad^2]).

    The halves of a mean scatter about it as it does about the truth (the delete-half jackknife). An estimate that drops
    outliers, and was searched for where most elements agree, is less sure of its place: by how much the halves scatter
    more than its residuals promise, to the side and in heading alike, that much more is taken again. A half may end in
    another basin by chance: the largest deviation along each axis is left out.

    Args:
        T_local_base: float[4 4], the pose that all elements lead to.
        Ts_half: float[n 4 4], those of the halves.
        variance: float[3], what the residuals promise.
    """
    away, turn = differences(T_local_base, Ts_half)
    found = np.sort(np.column_stack([away, turn]) ** 2, axis=0)[:-1].mean(axis=0)
    again = max(float((found / np.maximum(variance, 1e-12))[1:].min()), 1.0)
    return found * np.array([again, again, 1.0])


@dataclass(frozen=True)
class KindsApart:
    """Where one kind of element puts the vehicle, as seen from where all else puts it.

    Attributes:
        kinds_chi2: squared distance over its covariance, three degrees of freedom; 0 where a kind is not in view.
        kinds_ahead_m: along the vehicle.
        kinds_left_m: across.
    """

    kinds_chi2: float = 0.0
    kinds_ahead_m: float = 0.0
    kinds_left_m: float = 0.0


def kinds(label: np.ndarray) -> np.ndarray:
    """Which samples are of one kind, and which of all others, for each kind in turn, bool[4, p].

    Args:
        label: `ElementClass` of each sample, int[p]; -1 for none.
    """
    own = [np.isin(label, of) for of in _KINDS]
    return np.array([part for kind in own for part in (kind, ~kind & (label >= 0))])


def kinds_apart(Ts: np.ndarray, covariance: np.ndarray) -> KindsApart:
    """The two kinds that contradict each other most.

    Two estimates from different observations differ by the sum of their covariances; a kind that sees little has a
    large one and contradicts nothing.

    Args:
        Ts: float[4 4 4], poses by the parts of `kinds`.
        covariance: float[4 3 3], of forward, left [m] and heading [rad] of each.
    """
    found = KindsApart()
    for one in range(0, len(Ts), 2):
        away, turn = differences(Ts[one + 1], Ts[one : one + 1])
        step = np.array([*away[0], turn[0]])
        total = covariance[one] + covariance[one + 1]
        if not (np.isfinite(step).all() and np.isfinite(total).all()):
            continue
        chi2 = float(step @ np.linalg.lstsq(total, step, rcond=None)[0])
        if chi2 > found.kinds_chi2:
            found = KindsApart(chi2, float(step[0]), float(step[1]))
    return found
