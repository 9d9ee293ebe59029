"""`semloc localize --fault`: single frames with something wrong, or all faults one after another (room: reports).

In: opened inputs, the configuration, the name of a fault. Out: faults.csv and faults.md.
"""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from semloc_jax.inputs.drive_inputs import Inputs

if TYPE_CHECKING:
    from semloc_jax.alignment.frame_localizer import LocalizeConfig
    from semloc_jax.alignment.pose_prior import PriorSource
    from semloc_jax.datasets import Drive

ALL = "all"


def report_frame_faults(
    inputs: Inputs,
    name: str,
    make_prior: "Callable[[Drive], PriorSource]",
    chosen: slice,
    settings: "LocalizeConfig",
    out: Path | None = None,
    options: Mapping[str, Any] | None = None,
    seed: int = 0,
) -> tuple[Path, str, int]:
    """Localize the frames with one fault, or with every fault in turn that fits the drive.

    Args:
        inputs: Drive, map and masks.
        name: A fault with its severity, such as focal:3; a fault alone for all severities; `all`.
        make_prior: The prior of a drive.
        chosen: Which frames.
        settings: Of the localizer.
        out: Folder; None for the usual one.
        options: What the record keeps of the options.
        seed: Of the faults.

    Returns:
        The folder, the table with what was left out, and the number of false frames under faults.

    Raises:
        SemlocError: a fault was named that is not known or does not fit the drive.
    """
    from tqdm import tqdm

    from semloc_jax.analysis.frame_faults import FrameFaultOutcome, fault_names, frame_fault, to_markdown
    from semloc_jax.errors import SemlocError
    from semloc_jax.reports.folder import make_folder, write_record
    from semloc_jax.reports.tables import write_csv

    own = [n for n in fault_names() if n.partition(":")[0] == name]
    names = fault_names() if name == ALL else own or [name]
    folder = make_folder(out)
    write_record(folder, settings, options or {})
    columns = [field.name for field in dataclasses.fields(FrameFaultOutcome)]
    outcomes: list[FrameFaultOutcome] = []
    left_out: list[str] = []
    for one in tqdm(names, unit="fault", disable=None):
        try:
            case = (one, inputs.drive, inputs.map, inputs.masks, make_prior, chosen, settings, seed)
            outcomes.append(frame_fault(*case))
        except SemlocError as error:
            if name != ALL:
                raise
            left_out.append(f"left out: {error}")
            continue
        # After each fault: a suite takes minutes.
        write_csv(folder / "faults.csv", columns, [dataclasses.astuple(outcome) for outcome in outcomes])
    table = to_markdown(outcomes)
    (folder / "faults.md").write_text(table + "\n", encoding="utf-8")
    false = sum(outcome.false for outcome in outcomes if outcome.severity)
    return folder, "\n".join([*left_out, table]), false
