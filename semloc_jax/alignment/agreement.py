"""Whether the parts of a map agree about a pose (room: alignment; host).

In: elements of map samples; the poses that halves of them lead to. Out: halves, and the spread of their poses.
A pose is no better than the map: where elements lie anywhere or lines were painted anew, those that agree by chance
hold a pose that looks sure by its residuals. Halves of the elements that are solved alone end elsewhere then.
"""

from dataclasses import dataclass

import numpy as np

from semloc_jax.alignment.posterior import differences


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


def disagreement(T_map_base: np.ndarray, Ts_half: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Variance of a pose as the halves have it, float[3] (forward, left [m^2], heading [rad^2]).

    The halves of a mean scatter about it as it does about the truth (the delete-half jackknife). An estimate that drops
    outliers, and was searched for where most elements agree, is less sure of its place: by how much the halves scatter
    more than its residuals promise, to the side and in heading alike, that much more is taken again. A half may end in
    another basin by chance: the largest deviation along each axis is left out.

    Args:
        T_map_base: float[4 4], the pose that all elements lead to.
        Ts_half: float[n 4 4], those of the halves.
        variance: float[3], what the residuals promise.
    """
    away, turn = differences(T_map_base, Ts_half)
    found = np.sort(np.column_stack([away, turn]) ** 2, axis=0)[:-1].mean(axis=0)
    again = max(float((found / np.maximum(variance, 1e-12))[1:].min()), 1.0)
    return found * np.array([again, again, 1.0])
