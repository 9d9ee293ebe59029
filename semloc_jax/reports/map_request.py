"""What a map is made of, and the folder that it is made in (room: reports; host).

In: a drive, its masks, how the map is made. Out: a MapRequest, what a run that was killed has made of it.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.mapper import MapConfig
from semloc_jax.mapping.parts import Parts
from semloc_jax.reports.run_inputs import FILE as INPUTS
from semloc_jax.reports.run_inputs import begun, file_digest, fingerprint_without_map
from semloc_jax.storage import json_document, remove_folder

_PARTS = "parts"
"""What a run that is not finished has made so far."""


class MapRequest(NamedTuple):
    """A map that is asked for.

    Args:
        drive: the drive.
        masks: what its cameras see.
        frames: those that look, in time order.
        settings: how the map is made.
        start: what fixes the frame of the map; see `mapping.gauge.gauge_of`.
        base: map that is there already: the drive is found in it, updates its beliefs and adds to it.
        has_loops: whether places that the drive comes to again tie its way down.
        options: what config.yaml keeps besides the configuration.
    """

    drive: Drive
    masks: MaskSource
    frames: Sequence[Frame]
    settings: MapConfig
    start: str | None = None
    base: Path | None = None
    has_loops: bool = True
    options: Mapping[str, Any] = {}

    @property
    def looking(self) -> list[int]:
        """Rows of the frames that look, among all of the drive."""
        return [frame.index for frame in self.frames]

    def made_of(self) -> dict[str, str]:
        """A hash for each part of what the map depends on."""
        same = {name: value for name, value in self.options.items() if name not in ("overlays", "video")}
        made_of = fingerprint_without_map(self.drive, self.masks, self.settings, same)
        return made_of if self.base is None else {**made_of, "base": file_digest(self.base)}

    def is_made(self, folder: Path) -> bool:
        """Whether a folder holds a finished map of just this request."""
        if not all((folder / name).is_file() for name in ("metrics.json", "map.gpkg", INPUTS)):
            return False
        if (folder / _PARTS).exists():
            return False
        return json_document((folder / INPUTS).read_bytes(), str(folder / INPUTS)) == self.made_of()

    def parts(self, folder: Path, is_resumed: bool) -> Parts:
        """The parts of a new run, or those of the run that is resumed.

        Raises:
            SemlocError: there is nothing to resume in the folder, or it began with another drive or configuration.
        """
        if is_resumed and not (folder / _PARTS).is_dir():
            raise SemlocError(
                f"--resume {folder}: has no folder '{_PARTS}': that run is finished, or is none of this verb"
            )
        if not is_resumed:
            # What an earlier run left there is none of this one: it goes before the folder says what this began with.
            remove_folder(folder / _PARTS)
        begun(folder, self.made_of(), is_resumed)
        return Parts(folder / _PARTS)
