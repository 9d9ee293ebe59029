"""`semloc localize --fault`: single frames with something wrong, or all faults one after another (room: reports).

In: opened inputs, the configuration, the name of a fault. Out: faults.csv, line by line, and faults.md.
"""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from semloc_jax.inputs.drive_inputs import Inputs

if TYPE_CHECKING:
    from semloc_jax.alignment.frame_localizer import LocalizeConfig
    from semloc_jax.alignment.pose_prior import PriorSource
    from semloc_jax.analysis.frame_faults import FrameFaultOutcome
    from semloc_jax.datasets import Drive

_NUM_WORST = 10


def report_frame_faults(
    inputs: Inputs,
    wanted: str,
    make_prior: "Callable[[Drive], PriorSource]",
    chosen: slice,
    settings: "LocalizeConfig",
    out: Path | None = None,
    options: Mapping[str, Any] | None = None,
    seed: int = 0,
    resume: Path | None = None,
) -> tuple[Path, str, int]:
    """Localize the frames with every fault in turn that fits the drive.

    Args:
        inputs: Drive, map and masks.
        wanted: Which faults, see `simulation.hostile.suite`.
        make_prior: The prior of a drive.
        chosen: Which frames.
        settings: Of the localizer.
        out: Folder; None for the usual one.
        options: What the record keeps of the options.
        seed: Of the faults.

    Returns:
        The folder, the worst ten with what was left out, and the number of false frames under faults that something can
        see.

    Raises:
        SemlocError: a fault was named that is not known, or none of those named fits the drive.
    """
    from tqdm import tqdm

    from semloc_jax.analysis.frame_faults import FrameFaultOutcome, frame_fault, frame_rows
    from semloc_jax.errors import SemlocError
    from semloc_jax.reports import run_inputs
    from semloc_jax.reports.fault_tables import TABLE, append, taken_up
    from semloc_jax.reports.folder import make_folder, write_record

    rows = frame_rows(wanted)
    folder = make_folder(out, resume)
    parts = run_inputs.fingerprint(inputs, (settings, str(chosen)), options or {})
    run_inputs.begun(folder, parts, is_resumed=resume is not None)
    if resume is None:  # rows of an earlier suite in this folder are of another run
        (folder / TABLE).unlink(missing_ok=True)
    write_record(folder, settings, options or {})
    outcomes = taken_up(folder / TABLE, FrameFaultOutcome)
    done, left_out = {(o.fault, o.severity) for o in outcomes}, []
    for row in tqdm([r for r in rows if (r.fault, r.severity) not in done], unit="fault", disable=None):
        try:
            case = (row, inputs.drive, inputs.map, inputs.masks, make_prior, chosen, settings, seed)
            outcome = frame_fault(*case)
        except SemlocError as error:
            left_out.append(f"left out: {error}")
            continue
        append(folder / TABLE, [f.name for f in dataclasses.fields(outcome)], [dataclasses.astuple(outcome)])
        outcomes.append(outcome)
    if not outcomes:
        raise SemlocError("\n".join([f"drive {inputs.drive.name}: no fault could be put into it", *left_out]))
    return folder, *_told(outcomes, left_out, folder)


def _told(outcomes: "list[FrameFaultOutcome]", left_out: list[str], folder: Path) -> tuple[str, int]:
    """Writes all faults, the worst first; the worst ten as text, and the number of false frames that count."""
    from semloc_jax.analysis.frame_faults import to_markdown, worst_first
    from semloc_jax.storage import write_text

    ranked = worst_first(outcomes)
    write_text(folder / "faults.md", to_markdown(ranked) + "\n")
    shown = [o for o in ranked if not o.severity] + [o for o in ranked if o.severity][:_NUM_WORST]
    counted = [o for o in outcomes if o.counts]
    false, localized = sum(o.false for o in counted), sum(o.localized for o in counted)
    told = (
        f"{len({o.fault for o in counted})} faults, {len(counted)} rows: {false} of {localized} localized frames false"
    )
    return "\n".join([*dict.fromkeys(left_out), to_markdown(shown), told]), false
