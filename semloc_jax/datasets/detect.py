"""Which data set a folder is (room: datasets; host).

In: a path. Out: Sequence.
"""

from pathlib import Path

from semloc_jax.datasets.base import Sequence
from semloc_jax.datasets.drive import is_drive, read_drive
from semloc_jax.datasets.folder import read_folder
from semloc_jax.datasets.pandaset import is_pandaset, read_pandaset
from semloc_jax.errors import SemlocError


def open_sequence(path: str | Path) -> Sequence:
    """Sequence of a folder whose type is guessed from its files: drive, PandaSet, or plain folder with calibration.

    Raises:
        SemlocError: the folder is missing or looks like none of them.
    """
    path = Path(path)
    if not path.is_dir():
        raise SemlocError(
            f"data set {path}: no such folder; expected a drive, a PandaSet sequence or images + calib.yaml"
        )
    if is_drive(path):
        return read_drive(path)
    if is_pandaset(path):
        return read_pandaset(path)
    return read_folder(path)
