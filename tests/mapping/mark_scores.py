"""Precision, recall and F1 of classes of marks."""

import numpy as np

from semloc_jax.simulation.mark_samples import MarkKind


def f1_scores(true: np.ndarray, found: np.ndarray) -> dict[MarkKind, tuple[int, float, float, float]]:
    """Number, precision, recall and F1 of every class that is there or was found."""
    scores = {}
    for kind in MarkKind:
        is_true, is_found = true == kind, found == kind
        if not (is_true | is_found).any():
            continue
        hits = float((is_true & is_found).sum())
        precision, recall = hits / max(is_found.sum(), 1), hits / max(is_true.sum(), 1)
        f1 = 2 * hits / (is_true.sum() + is_found.sum())
        scores[kind] = int(is_true.sum()), float(precision), float(recall), float(f1)
    return scores
