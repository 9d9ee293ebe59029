"""A film of the top view of a drive, on which something is drawn (room: reports; host).

In: frames, masks. Out: an mp4 file; its last picture.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from semloc_jax import viz
from semloc_jax.cameras import Rig
from semloc_jax.datasets import Drive, Frame
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.perception.surround import SurroundView
from semloc_jax.reports.film import Film

SIZE_M = 16.0
_PX_M = 0.02
Picture = UInt8[np.ndarray, "h w 3"]


class TopViewFilm:
    """The top view of each frame, of its images where there are any, else of its masks."""

    def __init__(self, path: Path, drive: Drive, masks: MaskSource, chosen: Sequence[int]):
        """Where it goes; the frames give its speed."""
        times = [drive.frames[k].time_s for k in chosen]
        rate_hz = 1.0 / max(float(np.median(np.diff(times))), 0.04) if len(times) > 1 else 1.0
        self.film, self.masks = Film(path, rate_hz), masks
        rig: Rig = drive.rig.select(masks.cameras)
        self.has_images = bool(chosen) and all(drive.frames[chosen[0]].has("rgb", name) for name in rig.names)
        self.view = SurroundView.around(rig if self.has_images else masks.camera_rig(rig), SIZE_M, _PX_M)

    def add(self, frame: Frame, draw: Callable[[Picture, SurroundView], Picture]) -> None:
        """The top view of a frame with what `draw` adds to it."""
        if self.has_images:
            top = self.view.stitch([frame.image(name) for name in self.masks.cameras])[..., ::-1]
        else:
            top = viz.mask_picture(self.view.stitch(self.masks.masks(frame)), self.masks.table)
        self.film.add(draw(top, self.view))


@contextmanager
def top_view_film(
    path: Path, drive: Drive, masks: MaskSource, chosen: Sequence[int], is_wanted: bool
) -> Iterator[TopViewFilm | None]:
    """A film in its place when the block ends, no file where the block fails; None where nobody wants it."""
    if not is_wanted:
        yield None
        return
    made = TopViewFilm(path, drive, masks, chosen)
    with made.film:
        yield made
