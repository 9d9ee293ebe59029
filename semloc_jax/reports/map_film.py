"""The film of a map that grows: what `semloc map --video` writes (room: reports; host).

In: a made map, the drive, its poses. Out: map.mp4: the map in the images of the first camera as far as it was seen by
then, with a plan of it.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, UInt8

from semloc_jax import viz
from semloc_jax.datasets import Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.settling import Progress
from semloc_jax.maps import BeliefMap, sample
from semloc_jax.reports.film import Film
from semloc_jax.reports.pictures import RADIUS_M, SPACING_M, camera_picture
from semloc_jax.reports.track_pictures import VIDEO_WIDTH_PX
from semloc_jax.structs import ElementClass
from semloc_jax.viz.insets import GrowingPlan
from semloc_jax.viz.style import class_name
from semloc_jax.viz.tracking import banner

_NEW_S = 1.0
"""So long after it was first seen an element is drawn white in the plan."""
_BAR = "#1b5e20"


class MapFilm:
    """Draws one picture for each frame."""

    def __init__(
        self,
        made: BeliefMap,
        masks: MaskSource,
        frames: Sequence[Frame],
        Ts_map_base: Float[np.ndarray, "n 4 4"],
        name: str,
    ):
        """Prepare a map.

        Args:
            made: the map.
            masks: of the drive.
            frames: those that looked, in time order.
            Ts_map_base: their poses.
            name: of the drive; what has another provenance was there before it.
        """
        self.map, self.masks, self.frames, self.poses = made.map, masks, frames, Ts_map_base
        held = [made.beliefs[element.id] for element in made.map.elements]
        is_own = np.array([b.provenance == name and b.first_seen_s is not None for b in held], dtype=bool)
        self._first_s = np.where(is_own, [b.first_seen_s or 0.0 for b in held], -np.inf)
        step_m = np.linalg.norm(np.diff(Ts_map_base[:, :2, 3], axis=0), axis=1)
        self._way_m = np.concatenate([[0.0], np.cumsum(step_m)])
        self._plan = GrowingPlan(made.map.elements, Ts_map_base[:, :2, 3])
        self._row = {element.id: k for k, element in enumerate(made.map.elements)}

    def known(self, time_s: float) -> Bool[np.ndarray, " m"]:
        """Elements that were seen by a time."""
        return self._first_s <= time_s + 1e-6

    def picture(self, row: int, width_px: int = VIDEO_WIDTH_PX) -> UInt8[np.ndarray, "h w 3"]:
        """The picture of a frame; red green blue."""
        frame = self.frames[row]
        known = self.known(frame.time_s)
        local_map = self.map.query(self.poses[row][:3, 3], RADIUS_M)
        samples = sample(local_map, SPACING_M)
        image, contours, ids = camera_picture(local_map, samples, self.masks, frame, self.poses[row])
        # A line that was cut at the border of what is shown keeps its id.
        shown = np.array([known[self._row[name]] for name in ids], dtype=bool)
        image = viz.draw_contours(*viz.at_width(image, contours.where(shown), width_px))
        is_new = self._first_s > frame.time_s - _NEW_S
        image = self._plan.inset(image, known, known & is_new, row)
        labels = Counter(e.label for e, k in zip(self.map.elements, known, strict=True) if k)
        text = f"{frame.id}  {int(known.sum())} elements   {self._way_m[row]:.0f} m"
        return banner(image, _BAR, text, _counts(labels))


def _counts(labels: Counter[ElementClass]) -> str:
    return ", ".join(f"{count} {class_name(label)}" for label, count in labels.most_common())


def write_map_film(path: Path, film: MapFilm, progress: Progress = lambda items, _: items) -> Path:
    """Write all frames as a film, which takes its place when it is whole.

    Args:
        path: where it goes.
        film: what is shown.
        progress: shows how far it has come.

    Raises:
        SemlocError: fewer than two frames, or this OpenCV cannot write films.
    """
    if len(film.frames) < 2:
        raise SemlocError(f"video {path}: {len(film.frames)} frame; expected at least 2; leave out --video")
    times_s = [frame.time_s for frame in film.frames]
    with Film(path, 1.0 / max(float(np.median(np.diff(times_s))), 0.04)) as out:
        for row in progress(range(len(film.frames)), "film"):
            out.add(film.picture(row))
    return path
