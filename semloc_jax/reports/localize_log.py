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
from semloc_jax.storage import append_line, reading, whole_lines, write_text
from semloc_jax.structs import SolveStatus

FILE = "results.jsonl"
_ARRAYS = ("T_map_base", "covariance", "weak_direction")
_NUMBERS = ("weight", "score", "cost", "coverage", "inlier_ratio")
_EVIDENCE = ("nats", "nats_per_piece", "explained", "border_offset_px", "log_prior")


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
        return [_result(json.loads(line), by_id) for line in whole_lines(path)]


def _mode_line(mode: Mode) -> dict[str, Any]:
    arrays = {name: np.asarray(getattr(mode, name), dtype=np.float64).tolist() for name in _ARRAYS}
    evidence = None
    if mode.evidence is not None:
        evidence = {name: float(getattr(mode.evidence, name)) for name in _EVIDENCE}
        evidence["status"] = mode.evidence.status.name
    return arrays | {name: float(getattr(mode, name)) for name in _NUMBERS} | {"evidence": evidence}


def _mode(line: dict[str, Any]) -> Mode:
    evidence = line["evidence"]
    if evidence is not None:
        evidence = ModeEvidence(**evidence | {"status": SolveStatus[evidence["status"]]})
    arrays = {name: np.array(line[name]) for name in _ARRAYS}
    return Mode(**arrays, **{name: line[name] for name in _NUMBERS}, evidence=evidence)


def _result(line: dict[str, Any], by_id: dict[str, Frame]) -> LocalizationResult:
    modes = [_mode(mode) for mode in line["modes"]]
    frame = by_id.get(line["frame"])
    if frame is None:
        raise SemlocError(f"holds a result of frame {line['frame']}, which is not chosen; give the --frames of the run")
    if line["time_s"] != frame.time_s:
        raise SemlocError(
            f"frame {frame.id}: its result is of {line['time_s']} s, the drive says {frame.time_s} s; begin anew with "
            "another --out"
        )
    return LocalizationResult(
        frame=frame,
        T_map_base=np.array(line["T_map_base"], dtype=np.float64),
        T_map_prior=np.array(line["T_map_prior"], dtype=np.float64),
        status=SolveStatus[line["status"]],
        localized=line["localized"],
        reasons=tuple(line["reasons"]),
        modes=tuple(modes),
        times=line["times"],
        held=tuple(line["held"]),
    )
