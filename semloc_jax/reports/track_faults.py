"""`semloc track --fault`: a drive with something wrong, or the hostile suite (room: reports).

In: opened inputs, the name of a fault. Out: inputs with the fault; faults.csv, faults_frames.csv, pictures.
Every fault is a line of faults.csv as soon as it is done, so a suite that was killed goes on where it stood.
"""

import csv
import dataclasses
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import betaincinv

from semloc_jax.errors import SemlocError
from semloc_jax.inputs.drive_inputs import Inputs
from semloc_jax.reports.fault_tables import TABLE, append, taken_up
from semloc_jax.storage import write_text, writing

if TYPE_CHECKING:
    from semloc_jax.analysis.fault_matrix import FaultOutcome, JudgedRun
    from semloc_jax.fusion.prediction import MotionLog
    from semloc_jax.localization.localizer import Localizer
    from semloc_jax.maps import SemanticMap
    from semloc_jax.simulation.hostile import FaultRow

FRAMES = "faults_frames.csv"
_NUM_WORST = 10
_DIRECTIONS = ("lateral_m", "longitudinal_m", "heading_deg")
FRAME_COLUMNS = (
    *("fault", "severity", "time_s", "is_tracking"),
    *(f"{kind}_{key}" for kind in ("error", "protection", "sigma") for key in _DIRECTIONS),
)


def disturbed(inputs: Inputs, name: str, seed: int) -> Inputs:
    """The inputs with a fault in the drive or in the map.

    Raises:
        SemlocError: there is no such fault, or it does not fit the drive.
    """
    from semloc_jax.simulation.faults import with_fault

    fault = with_fault(name, inputs.drive, inputs.map, seed)
    return dataclasses.replace(inputs, drive=fault.drive, map=fault.semantic_map)


def write_suite(
    inputs: Inputs,
    make_localizer: "Callable[[SemanticMap, MotionLog], Localizer]",
    rows: "Sequence[FaultRow]",
    folder: Path,
    seed: int,
) -> tuple[str, int]:
    """Run every fault that the drive allows and write faults.csv, faults_frames.csv, faults.md and stanford.png.

    Faults that faults.csv holds already are not run again.

    Args:
        inputs: Drive with truth, map, masks.
        make_localizer: Of a map and a motion log.
        rows: The faults.
        seed: Of the faults.

    Returns:
        The worst ten with what was left out and the sums, and the number of frames that were called TRACKING with an
        error beyond a protection level, under faults that something can see.
    """
    from tqdm import tqdm

    from semloc_jax.analysis.fault_matrix import FaultOutcome, run_fault, to_markdown, worst_first
    from semloc_jax.reports.fault_tables import write_figures

    done = {(o.fault, o.severity): o for o in taken_up(folder / TABLE, FaultOutcome)}
    _cut(folder / FRAMES, set(done))
    outcomes, left_out = list(done.values()), []
    for row in tqdm([r for r in rows if (r.fault, r.severity) not in done], unit="fault", disable=None):
        try:
            outcome, run = run_fault(row, inputs.drive, inputs.map, inputs.masks, make_localizer, seed)
        except SemlocError as error:
            left_out.append(f"left out: {error}")
            continue
        # The frames first: a fault counts as done once its line is there.
        append(folder / FRAMES, FRAME_COLUMNS, _frame_rows(row, run))
        append(folder / TABLE, [f.name for f in dataclasses.fields(outcome)], [dataclasses.astuple(outcome)])
        outcomes.append(outcome)
    if not outcomes:
        raise SemlocError("\n".join([f"drive {inputs.drive.name}: no fault could be put into it", *left_out]))
    ranked = worst_first(outcomes)
    write_text(folder / "faults.md", to_markdown(ranked) + "\n")
    worst = [o for o in ranked if not o.counts][:1] + [o for o in ranked if o.counts][:_NUM_WORST]
    text = [*dict.fromkeys(left_out), to_markdown(worst), summary(outcomes), write_figures(folder)]
    return "\n".join(filter(None, text)), sum(o.false for o in outcomes if o.counts)


def summary(outcomes: "Sequence[FaultOutcome]") -> str:
    """The sums over the faults that something can see."""
    seen = [o for o in outcomes if o.counts]
    frames = max(sum(o.frames for o in seen), 1)
    tracking, false, refused = (sum(getattr(o, key) for o in seen) for key in ("tracking", "false", "refused_right"))
    apart = [o for o in outcomes if o.severity and o.apart]
    # Clopper and Pearson: what the rate is below, with a probability of 95 %.
    most = float(betaincinv(false + 1, tracking - false, 0.95)) if tracking > false else 1.0
    return (
        f"{len({o.fault for o in seen})} faults, {len(seen)} rows: {tracking / frames:.1%} of {frames} frames "
        "TRACKING, "
        f"{false} of them false (an error beyond its protection level) in {sum(o.false > 0 for o in seen)} rows; "
        f"misleading information in less than {most:.2%} of the TRACKING frames under faults (95 %); "
        f"{refused / frames:.1%} right and refused. Set apart, since nothing can see them: "
        f"{', '.join(sorted({o.fault for o in apart})) or 'none'}, {sum(o.false for o in apart)} false"
    )


def _frame_rows(row: "FaultRow", run: "JudgedRun") -> Iterable[list[Any]]:
    for k in np.flatnonzero(run.has_pose):
        numbers = np.concatenate([run.errors[k], run.levels[k], run.sigmas[k]])
        yield [row.fault, row.severity, f"{run.time_s[k]:.6f}", int(run.is_tracking[k]), *(f"{v:.6g}" for v in numbers)]


def _cut(path: Path, done: set[tuple[str, int]]) -> None:
    """Take out the frames of faults that are not done."""
    if not path.is_file():
        return
    with path.open(newline="", encoding="utf-8") as file:
        lines = [line for line in csv.reader(file) if len(line) == len(FRAME_COLUMNS)][1:]
    kept = [line for line in lines if (line[0], int(line[1])) in done]
    with writing(path) as partial, partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(FRAME_COLUMNS)
        writer.writerows(kept)
