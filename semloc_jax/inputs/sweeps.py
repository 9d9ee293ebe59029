"""A PandaSet drive with a map made of some of its own sweeps (room: inputs).

In: `sweeps:START:STOP:STEP`. Out: the drive with its front camera calibrated, and the map.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

from semloc_jax.inputs.choices import parse_slice

if TYPE_CHECKING:
    from semloc_jax.datasets import Drive
    from semloc_jax.maps import SemanticMap

SWEEPS = "sweeps:"
"""Before the slice of the sweeps that make the map."""
DEFAULT = "sweeps:::2"
MAP_SWEEP, OTHER_SWEEP = "map_sweep", "other_sweep"
"""Variants of frames: those that the map was made of, and those that show how good it is."""


def has_sweeps(drive: "Drive") -> bool:
    """Whether a map can be made of the drive itself."""
    from semloc_jax.datasets import PandaSetDrive

    return isinstance(drive, PandaSetDrive)


def from_sweeps(drive: "Drive", text: str) -> "tuple[Drive, SemanticMap]":
    """The drive, calibrated on the sweeps and with its frames told apart by variant, and the map made of the sweeps.

    Raises:
        UsageError: the text holds no slice.
        SemlocError: the drive has no labelled points, or these sweeps show too little.
    """
    from semloc_jax.datasets.pandaset import build_map, calibrated
    from semloc_jax.errors import SemlocError

    sweeps = parse_slice(text.removeprefix(SWEEPS), f"--map {SWEEPS}")
    if not has_sweeps(drive):
        raise SemlocError(f"--map '{text}': drive {drive.name} has no labelled points; give --map FILE")
    chosen = range(len(drive))[sweeps]
    if not chosen:
        raise SemlocError(f"--map '{text}': no sweeps chosen of {len(drive)}; give e.g. --map {DEFAULT}")
    drive = calibrated(drive, sweeps)
    frames = tuple(replace(f, variant=MAP_SWEEP if f.index in chosen else OTHER_SWEEP) for f in drive.frames)
    return replace(drive, frames=frames), build_map(drive, sweeps)
