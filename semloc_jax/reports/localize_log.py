"""Results of single frames, one line each, on disk before the next frame begins (room: reports).

In: LocalizationResult after LocalizationResult. Out: results.jsonl; and back, number for number.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from semloc_jax.alignment.result import LocalizationResult, Mode, ModeEvidence
from semloc_jax.datasets import Frame
from semloc_jax.errors import SemlocError
from semloc_jax.reports.tables import EVIDENCE
from semloc_jax.storage import append_line, reading, whole_lines, write_text
from semloc_jax.structs import SolveStatus

FILE = "results.jsonl"
_ARRAYS = ("T_map_base", "covariance", "weak_direction")
_NUMBERS = ("weight", "score", "cost", "coverage", "inlier_ratio")
_OFF_ROTATION = 1e-4
"""Poses may come from float32."""


def begin(folder: Path) -> None:
    """An empty log: what an earlier run left there is none of this one."""
    write_text(folder / FILE, "")


def append(folder: Path, result: LocalizationResult) -> None:
    """Add the line of one frame."""
    line = {
        "frame": result.frame.id,
        "time_s": result.frame.time_s,
        "T_map_base": np.asarray(result.T_map_base, dtype=np.float64).tolist(),
        "T_map_prior": np.asarray(result.T_map_prior, dtype=np.float64).tolist(),
        "status": result.status.name,
        "localized": bool(result.localized),
        "reasons": list(result.reasons),
        "modes": [_mode_line(mode) for mode in result.modes],
        "held": list(result.held),
        "protection": [value if np.isfinite(value) else None for value in result.protection],
        "misleading": float(result.misleading),
        "times": {name: float(seconds) for name, seconds in result.times.items()},
    }
    append_line(folder / FILE, json.dumps(line))


def read(folder: Path, frames: Sequence[Frame]) -> list[LocalizationResult]:
    """The results of an earlier run, a line that was cut by a kill left out.

    Raises:
        SemlocError: a line is not what `append` writes, or of a frame that is not among these.
    """
    by_id = {frame.id: frame for frame in frames}
    path = folder / FILE
    with reading(f"results {path}"):
        lines = [json.loads(line) for line in whole_lines(path)]
        if len({line["frame"] for line in lines}) < len(lines):
            raise ValueError("two results of one frame")
        return [_result(line, by_id) for line in lines]


def _mode_line(mode: Mode) -> dict[str, Any]:
    arrays = {name: np.asarray(getattr(mode, name), dtype=np.float64).tolist() for name in _ARRAYS}
    evidence = None
    if mode.evidence is not None:
        evidence = {name: float(getattr(mode.evidence, name)) for name in EVIDENCE}
        evidence["status"] = mode.evidence.status.name
    return arrays | {name: float(getattr(mode, name)) for name in _NUMBERS} | {"evidence": evidence}


def _mode(line: dict[str, Any]) -> Mode:
    evidence = line["evidence"]
    if evidence is not None:
        evidence = ModeEvidence(**evidence | {"status": SolveStatus[evidence["status"]]})
    values = np.array(line["covariance"], dtype=np.float64), np.array(line["weak_direction"], dtype=np.float64)
    arrays = dict(zip(_ARRAYS, (_pose(line["T_map_base"]), values[0].reshape(6, 6), values[1].reshape(6)), strict=True))
    return Mode(**arrays, **{name: float(line[name]) for name in _NUMBERS}, evidence=evidence)


def _protection(values: Any) -> tuple[float, float, float]:
    lateral_m, along_m, heading_deg = (np.inf if value is None else float(value) for value in values)
    return lateral_m, along_m, heading_deg


def _pose(values: Any) -> np.ndarray:
    """A pose of a line; whoever changed the file may have left none."""
    T = np.array(values, dtype=np.float64).reshape(4, 4)
    R = T[:3, :3]
    if not np.isfinite(T).all() or not np.allclose(R @ R.T, np.eye(3), atol=_OFF_ROTATION):
        raise ValueError("a matrix that is no pose")
    return T


def _result(line: dict[str, Any], by_id: dict[str, Frame]) -> LocalizationResult:
    modes = [_mode(mode) for mode in line["modes"]]
    frame = by_id.get(line["frame"])
    if frame is None:
        raise SemlocError(f"holds a result of frame {line['frame']}, which is not chosen; give the --frames of the run")
    if line["time_s"] != frame.time_s:
        raise SemlocError(
            f"frame {frame.id}: its result is of {line['time_s']} s, the drive says {frame.time_s} s; start again with "
            "another --out"
        )
    return LocalizationResult(
        frame=frame,
        T_map_base=_pose(line["T_map_base"]),
        T_map_prior=_pose(line["T_map_prior"]),
        status=SolveStatus[line["status"]],
        localized=line["localized"],
        reasons=tuple(line["reasons"]),
        modes=tuple(modes),
        times=line["times"],
        held=tuple(line["held"]),
        protection=_protection(line["protection"]),
        misleading=float(line["misleading"]),
    )
