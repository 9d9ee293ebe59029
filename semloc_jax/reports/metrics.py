"""Errors of a run against the truth (room: reports; host).

In: localization results, truth. Out: metrics.json, errors.png, text.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.datasets import Drive
from semloc_jax.evaluation import Metric, Trajectory, evaluate, format_metrics, integrity, pose_errors, write_metrics
from semloc_jax.evaluation.metrics import ALERT_LIMITS
from semloc_jax.reports.tables import ERRORS, SIGMAS, localized_trajectory

_MIN_SHIFTED, _CLEAR_SHIFT_M = 5, 0.5
"""A common shift of the poses against their priors is reported from so many frames and metres on; our choice."""
OF_VARIANT = (
    *("frames.reference", "frames.estimated", "estimated", "recall.0.3m_0.5m_0.5deg"),
    *("lateral.median", "longitudinal.median", "heading.median"),
)
"""Metrics that are also given for each weather or lighting, where a drive has several."""


_ERRORS_SAID = ("lateral", "longitudinal", "height", "heading", "pitch", "roll")


def error_table(metrics: Sequence[Metric]) -> str:
    """The errors of the six directions as a table; what metrics.json has beside them is for programs."""
    return format_metrics([m for m in metrics if m.key.rpartition(".")[0] in _ERRORS_SAID])


def truth_of(drive: Drive, results: Sequence[LocalizationResult]) -> dict[str, np.ndarray]:
    """True poses T_map_base by frame id, of the frames that lie inside the reference trajectory."""
    if drive.truth is None:
        return {}
    first, last = drive.truth.time_s[0], drive.truth.time_s[-1]
    return {r.frame.id: drive.truth_at(r.frame) for r in results if first <= r.frame.time_s <= last}


def write_metrics_of(results: Sequence[LocalizationResult], truth: Mapping[str, np.ndarray], folder: Path) -> str:
    """Write metrics.json and, of several frames, errors.png over those with a truth; return in words how good they are.

    Shares count frames that were not localized as missed. Where the frames are of several variants, the main metrics of
    each follow under its name.
    """
    known = sorted((r for r in results if r.frame.id in truth), key=lambda r: r.frame.time_s)
    estimate, reference = localized_trajectory(known), _true_trajectory(known, truth)
    metrics = [*_metrics(estimate, reference), *integrity_metrics(known, truth)]
    if len(estimate) > 1:
        from semloc_jax.viz import errors_over_time, save

        missed_s = [r.frame.time_s for r in known if not r.localized]
        prior = Trajectory(np.array([r.frame.time_s for r in known]), np.array([r.T_map_prior for r in known]))
        save(errors_over_time(estimate, reference, 1e-6, missed_s=missed_s, prior=prior), folder / "errors.png")
    said = [line for line in (_headline(metrics), error_table(metrics)) if line]
    variants = dict.fromkeys(r.frame.variant for r in known)
    for variant in variants if len(variants) > 1 else ():
        own = [r for r in known if r.frame.variant == variant]
        part = [m for m in _metrics(localized_trajectory(own), _true_trajectory(own, truth)) if m.key in OF_VARIANT]
        metrics += [replace(m, key=f"{variant}.{m.key}") for m in part]
        said.append(f"{variant}: " + ", ".join(f"{m.key} {m.value:.3g} {m.unit}" for m in part))
    write_metrics(metrics, folder / "metrics.json")
    return "\n".join(said)


def _headline(metrics: Sequence[Metric]) -> str:
    """How many of the localized frames are near the truth; nothing where none was localized."""
    value, limit = {m.key: m.value for m in metrics}, ALERT_LIMITS[0]
    num = value["frames.estimated"]
    if not num:
        return ""
    near = value[f"inside.{limit.name}"] * value["frames.reference"]
    return f"{near:.0f} of {num:.0f} localized frames lie within {limit} of the truth"


def _true_trajectory(known: Sequence[LocalizationResult], truth: Mapping[str, np.ndarray]) -> Trajectory:
    time_s = np.array([r.frame.time_s for r in known], dtype=np.float64)
    return Trajectory(time_s, np.array([truth[r.frame.id] for r in known], dtype=np.float64).reshape(-1, 4, 4))


def _metrics(estimate: Trajectory, reference: Trajectory) -> list[Metric]:
    if len(estimate) > 0:
        return evaluate(estimate, reference, max_difference_s=1e-6)
    return [
        Metric("frames.reference", float(len(reference)), "frames", "report"),
        Metric("frames.estimated", 0.0, "frames", "report"),
        Metric("estimated", 0.0, "share", "higher"),
    ]


def integrity_metrics(known: Sequence[LocalizationResult], truth: Mapping[str, np.ndarray]) -> list[Metric]:
    """Sigma coverage, Stanford counts and the stated probability of misleading, of the frames with a place and a truth;
    those that were not localized count as unavailable."""
    placed = [r for r in known if r.modes]
    if not placed:
        return []
    offered, found = np.array([r.localized for r in placed]), []
    errors = pose_errors(np.array([r.T_map_base for r in placed]), np.array([truth[r.frame.id] for r in placed]))
    levels = np.array([r.protection for r in placed])
    sigmas = np.array([[getattr(r.modes[0], key) for key in SIGMAS] for r in placed])
    for k, key in enumerate(ERRORS):
        known_by = sigmas[:, k], levels[:, k], getattr(ALERT_LIMITS[0], key)
        found += integrity.integrity_metrics(key.rsplit("_", 1)[0], errors[key], *known_by, offered)
    size = np.abs(np.column_stack([errors[key] for key in ERRORS]))
    beyond = offered & (size > levels).any(axis=1)
    stated = float(np.mean([r.misleading for r in placed if r.localized])) if offered.any() else float("nan")
    return [
        *found,
        Metric("integrity.beyond_level", float(beyond.sum()), "frames", "lower"),
        Metric("integrity.stated_misleading", stated, "share", "report"),
    ]


def shifts(found: Sequence[LocalizationResult]) -> np.ndarray:
    """How far the localized poses lie from their priors, x and y of the map, `float64[n 2]` [m]."""
    return np.array([(r.T_map_base - r.T_map_prior)[:2, 3] for r in found if r.localized]).reshape(-1, 2)


def shift_text(moved: np.ndarray) -> str | None:
    """A sentence on a shift between priors and poses that is the same in every frame; None where there is none.

    The bias of a receiver drifts and is about a metre; the shift of a wrong datum is constant over the whole drive.
    """
    if len(moved) < _MIN_SHIFTED:
        return None
    shift = np.median(moved, axis=0)
    spread = float(np.median(np.linalg.norm(moved - shift, axis=1)))
    if np.hypot(*shift) < max(_CLEAR_SHIFT_M, 2.0 * spread):
        return None
    return (
        f"the poses lie {shift[0]:+.2f} m in x and {shift[1]:+.2f} m in y of the map from their priors, within "
        f"{spread:.2f} m the same in every frame: the bias of the receiver, or a datum or map origin that does not fit"
    )
