"""`semloc track --fault`: a drive with something wrong, or all faults one after another (room: reports).

In: opened inputs, the name of a fault. Out: inputs with the fault; faults.csv and faults.md.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from semloc_jax.inputs.drive_inputs import Inputs
from semloc_jax.storage import write_text

if TYPE_CHECKING:
    from semloc_jax.fusion.prediction import MotionLog
    from semloc_jax.localization.localizer import Localizer
    from semloc_jax.maps import SemanticMap


def disturbed(inputs: Inputs, name: str, seed: int) -> Inputs:
    """The inputs with a fault in the drive or in the map.

    Raises:
        SemlocError: there is no such fault, or it does not fit the drive.
    """
    from semloc_jax.simulation.faults import with_fault

    fault = with_fault(name, inputs.drive, inputs.map, seed)
    return dataclasses.replace(inputs, drive=fault.drive, map=fault.semantic_map)


def write_matrix(
    inputs: Inputs, make_localizer: "Callable[[SemanticMap, MotionLog], Localizer]", folder: Path, seed: int
) -> tuple[str, int]:
    """Run every fault that the drive allows and write faults.csv and faults.md.

    Returns:
        The table, and the number of frames that were called TRACKING beyond an alert limit.
    """
    from tqdm import tqdm

    from semloc_jax.analysis.fault_matrix import FaultOutcome, fault_matrix, to_markdown
    from semloc_jax.errors import SemlocError
    from semloc_jax.reports.tables import write_csv
    from semloc_jax.simulation.faults import FAULTS

    columns = [field.name for field in dataclasses.fields(FaultOutcome)]
    outcomes: list[FaultOutcome] = []
    left_out: list[str] = []
    for name in tqdm(FAULTS, unit="fault", disable=None):
        try:
            outcomes += fault_matrix([name], inputs.drive, inputs.map, inputs.masks, make_localizer, seed)
        except SemlocError as error:
            left_out.append(f"left out: {error}")
            continue
        # After each fault: a matrix takes minutes.
        write_csv(folder / "faults.csv", columns, [dataclasses.astuple(outcome) for outcome in outcomes])
    table = to_markdown(outcomes)
    write_text(folder / "faults.md", table + "\n")
    return "\n".join([*left_out, table]), sum(outcome.false_confident for outcome in outcomes)
