"""A film that takes its place when it is whole (room: reports; host).

In: pictures uint8[h w 3], red green blue, one after the other. Out: an mp4 file.
"""

from pathlib import Path

import cv2
import numpy as np

from semloc_jax.errors import SemlocError
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
