"""Films that take their place when they are whole, those of the top view of a drive among them (room: reports; host).

In: pictures uint8[h w 3], red green blue, one after the other; frames, masks. Out: an mp4 file.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from semloc_jax import viz
from semloc_jax.cameras import Rig
from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.perception.surround import SurroundView
from semloc_jax.storage import writing


class Film:
    """A film that is being written; as a context it is put in its place, or dropped where the run fails."""

    def __init__(self, path: Path, rate_hz: float):
        """Where it goes, and its pictures a second."""
        self.path, self.rate_hz = path, rate_hz
        self._place = writing(path)
        self._partial = self._place.__enter__()
        self._writer: cv2.VideoWriter | None = None

    def add(self, picture: np.ndarray) -> None:
        """One more picture; all are of the size of the first.

        Raises:
            SemlocError: this OpenCV cannot write films.
        """
        if self._writer is None:
            size = picture.shape[1], picture.shape[0]
            self._writer = cv2.VideoWriter(
                str(self._partial), cv2.VideoWriter_fourcc(*"mp4v"), max(self.rate_hz, 1.0), size
            )
            if not self._writer.isOpened():
                raise SemlocError(f"film {self.path}: OpenCV cannot write mp4 here; leave out --video")
        self._writer.write(np.ascontiguousarray(picture[..., ::-1]))

    def __enter__(self) -> "Film":
        """Itself."""
        return self

    def __exit__(self, failed: type[BaseException] | None, *details: object) -> None:
        """Close it, or drop it where the run failed."""
        if failed is None:
            self.close()
        else:
            self.drop()

    def close(self) -> Path:
        """Put the film in its place."""
        if self._writer is not None:
            self._writer.release()
        self._place.__exit__(None, None, None)
        return self.path

    def drop(self) -> None:
        """Leave no film, since the run failed."""
        if self._writer is not None:
            self._writer.release()
        self._partial.unlink(missing_ok=True)


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
