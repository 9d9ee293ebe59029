"""The folder of a run: trajectory, tables, metrics and the record of how it came about (room: reports).

In: localization results, truth, configuration.
Out: trajectory.tum, frames.csv, hypotheses.csv, metrics.json, errors.png, config.yaml.
"""

import csv
import shlex
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from semloc_jax.alignment.result import LocalizationResult
from semloc_jax.datasets import Drive
from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import Metric, Trajectory, evaluate, format_metrics, pose_errors, write_metrics, write_tum
from semloc_jax.inputs.config_files import RECORD_KEY, to_file, to_plain
from semloc_jax.runtime import prepare as runtime
from semloc_jax.structs import SolveStatus

SIGMAS = ("sigma_lateral_m", "sigma_longitudinal_m", "sigma_heading_deg")
POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
ERRORS = ("lateral_m", "longitudinal_m", "heading_deg")
DEFAULT_ROOT = Path("results")
_MIN_SHIFTED, _CLEAR_SHIFT_M = 5, 0.5
"""A shift of all poses against their priors is told from so many frames and metres on; ours."""
OF_VARIANT = (
    *("frames.reference", "frames.estimated", "estimated", "recall.0.3m_0.5m_0.5deg"),
    *("lateral.median", "longitudinal.median", "heading.median"),
)
"""Metrics that are also given for each weather or lighting, where a drive has several."""


def make_folder(out: Path | None) -> Path:
    """The folder for a run; without a wish `results/<time>`, to which the link `results/latest` points.

    Raises:
        SemlocError: the folder cannot be made.
    """
    folder = out or DEFAULT_ROOT / time.strftime("%Y-%m-%d_%H-%M-%S")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SemlocError(
            f"output folder {folder}: {error.strerror}; give --out a folder that can be written"
        ) from error
    if out is None:
        latest = DEFAULT_ROOT / "latest"
        try:
            latest.unlink(missing_ok=True)
            latest.symlink_to(folder.name, target_is_directory=True)
        except OSError:  # file systems without links: the folder is named by its time anyway
            pass
    return folder


def localized_trajectory(results: Sequence[LocalizationResult]) -> Trajectory:
    """Poses of the frames that were localized, in time order."""
    found = sorted((r for r in results if r.localized), key=lambda r: r.frame.time_s)
    time_s = np.array([r.frame.time_s for r in found], dtype=np.float64)
    return Trajectory(time_s, np.array([r.T_map_base for r in found], dtype=np.float64).reshape(-1, 4, 4))


def write_tables(results: Sequence[LocalizationResult], truth: Mapping[str, np.ndarray], folder: Path) -> None:
    """Write trajectory.tum (localized frames), frames.csv (every frame) and hypotheses.csv (every mode).

    Args:
        results: One for each frame.
        truth: True T_map_base by frame id; may be empty.
        folder: Where to write.
    """
    write_tum(localized_trajectory(results), folder / "trajectory.tum")
    error_columns = [f"error_{key}" for key in ERRORS] if truth else []
    columns = ["frame", "time_s", "localized", "status", "reasons", *POSE, "cost", "coverage", *SIGMAS, "time_ms"]
    write_csv(folder / "frames.csv", [*columns, *error_columns], (_frame_row(r, truth) for r in results))
    columns = ["frame", "rank", "weight", *POSE, "cost", "coverage", *SIGMAS]
    write_csv(folder / "hypotheses.csv", columns, (row for r in results for row in _mode_rows(r)))


def truth_of(drive: Drive, results: Sequence[LocalizationResult]) -> dict[str, np.ndarray]:
    """True poses T_map_base by frame id, of the frames that lie inside the reference trajectory."""
    if drive.truth is None:
        return {}
    first, last = drive.truth.time_s[0], drive.truth.time_s[-1]
    return {r.frame.id: drive.truth_at(r.frame) for r in results if first <= r.frame.time_s <= last}


def write_metrics_of(results: Sequence[LocalizationResult], truth: Mapping[str, np.ndarray], folder: Path) -> str:
    """Write metrics.json and, of several frames, errors.png over those with a truth; return the metrics as a table.

    Shares count frames that were not localized as missed. Where the frames are of several variants, the main metrics of
    each follow under its name.
    """
    known = sorted((r for r in results if r.frame.id in truth), key=lambda r: r.frame.time_s)
    estimate, reference = localized_trajectory(known), _true_trajectory(known, truth)
    metrics = _metrics(estimate, reference)
    if len(estimate) > 1:
        from semloc_jax.viz import errors_over_time, save

        missed_s = [r.frame.time_s for r in known if not r.localized]
        save(errors_over_time(estimate, reference, 1e-6, missed_s=missed_s), folder / "errors.png")
    said = [format_metrics(metrics)]
    variants = dict.fromkeys(r.frame.variant for r in known)
    for variant in variants if len(variants) > 1 else ():
        own = [r for r in known if r.frame.variant == variant]
        part = [m for m in _metrics(localized_trajectory(own), _true_trajectory(own, truth)) if m.key in OF_VARIANT]
        metrics += [replace(m, key=f"{variant}.{m.key}") for m in part]
        said.append(f"{variant}: " + ", ".join(f"{m.key} {m.value:.3g} {m.unit}" for m in part))
    write_metrics(metrics, folder / "metrics.json")
    return "\n".join(said)


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


def write_record(folder: Path, settings: Any, options: Mapping[str, Any]) -> None:
    """Write config.yaml: the resolved configuration, which can be read back, and how the run came about.

    Args:
        folder: Where to write.
        settings: The configuration.
        options: Options of the verb that a configuration file may hold too.
    """
    record = {
        "command": shlex.join(["semloc", *sys.argv[1:]]),
        "time": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "versions": runtime.versions(),
        "device": runtime.device(),
    }
    content = {RECORD_KEY: record, **to_plain(dict(options)), **to_file(settings)}
    (folder / "config.yaml").write_text(yaml.safe_dump(content, sort_keys=False, width=120), encoding="utf-8")


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write a table."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(rows)


def _frame_row(result: LocalizationResult, truth: Mapping[str, np.ndarray]) -> list[Any]:
    best = result.modes[0] if result.modes else None
    quality = [_number(getattr(best, key, np.nan)) for key in ("cost", "coverage", *SIGMAS)]
    row = [
        result.frame.id,
        f"{result.frame.time_s:.9f}",
        int(result.localized),
        SolveStatus(result.status).name,
        "; ".join(result.reasons),
        *_pose_cells(result.T_map_base),
        *quality,
        _number(1e3 * sum(result.times.values())),
    ]
    if not truth:
        return row
    if result.frame.id not in truth or not np.isfinite(result.T_map_base).all():
        return row + [""] * len(ERRORS)
    errors = pose_errors(result.T_map_base, truth[result.frame.id])
    return row + [_number(errors[key]) for key in ERRORS]


def _mode_rows(result: LocalizationResult) -> Iterable[list[Any]]:
    for rank, mode in enumerate(result.modes):
        quality = [_number(getattr(mode, key)) for key in ("cost", "coverage", *SIGMAS)]
        yield [result.frame.id, rank, _number(mode.weight), *_pose_cells(mode.T_map_base), *quality]


def _pose_cells(T_map_base: np.ndarray) -> list[str]:
    if not np.isfinite(T_map_base).all():
        return [""] * len(POSE)
    quaternion = Rotation.from_matrix(T_map_base[:3, :3]).as_quat()
    return [f"{value:.6f}" for value in T_map_base[:3, 3]] + [f"{value:.9f}" for value in quaternion]


def _number(value: Any) -> str:
    return f"{float(value):.6g}" if np.isfinite(value) else ""


def shifts(found: Sequence[LocalizationResult]) -> np.ndarray:
    """How far the localized poses lie from their priors, x and y of the map, `float64[n 2]` [m]."""
    return np.array([(r.T_map_base - r.T_map_prior)[:2, 3] for r in found if r.localized]).reshape(-1, 2)


def shift_text(moved: np.ndarray) -> str | None:
    """A word on a shift between priors and poses that is the same in every frame; None where there is none.

    A receiver's own bias wanders and is about a metre; a datum that does not fit stays as it is over the whole drive.
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
