"""Counts that a run keeps on disk while it goes over a drive (room: mapping; host).

In: an object whose arrays are counted up, their names. Out: a file, and the arrays back from it.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.storage import npz_arrays, write_npz


class KeptCounts:
    """What is counted up can be written and taken in again."""

    COUNTED: ClassVar[Sequence[str]] = ()
    """Names of the arrays."""

    def save(self, path: Path) -> None:
        """Writes what was counted so far."""
        write_npz(path, {name: getattr(self, name) for name in self.COUNTED})

    def restore(self, path: Path) -> None:
        """Takes in what `save` wrote of the same elements.

        Raises:
            SemlocError: it is of others.
        """
        counted = npz_arrays(path, f"counts {path}", names=tuple(self.COUNTED))
        own = {name: np.asarray(getattr(self, name)) for name in self.COUNTED}
        form, expected = ({name: (values.shape, values.dtype) for name, values in c.items()} for c in (counted, own))
        if form != expected:
            found, wanted = (next(iter(arrays.values())).shape for arrays in (counted, own))
            raise SemlocError(f"counts {path}: shape {found}, expected {wanted}; begin anew with another --out")
        for name, values in counted.items():
            setattr(self, name, values)
