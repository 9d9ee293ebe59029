"""A drive looked at twice: to find what there may be, and to count what is there (room: mapping; host).

In: frames, their poses, a Looker. Out: a Gatherer and the counts, filled.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from semloc_jax.datasets import Frame
from semloc_jax.mapping.existence import Counting
from semloc_jax.mapping.looking import Gatherer, Look, Looker
from semloc_jax.mapping.mark_looks import MarkLooks
from semloc_jax.mapping.parts import Parts
from semloc_jax.mapping.profile_by_marks import road_profile
from semloc_jax.mapping.settling import Progress
from semloc_jax.mapping.uprights import UprightCounting

_STILL_M = 0.05
"""A vehicle that has not moved sees the same mistakes again."""


class DriveLooks:
    """The looks of all frames in which the vehicle has moved."""

    def __init__(
        self,
        looker: Looker,
        frames: Sequence[Frame],
        Ts_map_base: Float[np.ndarray, "n 4 4"],
        progress: Progress,
        parts: Parts | None,
    ) -> None:
        """Only how the road lies beside the way is looked at; what a run that was killed has finished is in `parts`."""
        self.looker, self.frames, self.Ts_map_base = looker, frames, Ts_map_base
        self.progress, self.parts, self.moving = progress, parts, _moving(Ts_map_base)
        self.profile = road_profile(self._marks(), Ts_map_base)

    def gather(self, gatherer: Gatherer, with_uprights: bool) -> None:
        """Every look joins what is gathered."""
        frames = self.parts.gathered(gatherer, self.moving) if self.parts else self.moving
        for index in self.progress(frames, "looking"):
            for camera, look in enumerate(self._looks(index)):
                gatherer.add(look, self.looker.rays[camera] if with_uprights else None)

    def count(self, counting: Counting, standing: UprightCounting) -> None:
        """Every look says which elements it shows and which it misses."""
        frames = self.parts.counted(counting, standing, self.moving) if self.parts else self.moving
        for index in self.progress(frames, "counting"):
            looks = list(self._looks(index))
            time_s = self.frames[index].time_s
            counting.add(looks, time_s)
            if standing.uprights:
                standing.add([look.mask for look in looks], self.looker.rays, self.Ts_map_base[index], time_s)

    def _looks(self, index: int) -> Iterator[Look]:
        return self.looker.looks(self.frames[index], index, self.Ts_map_base, self.profile)

    def _marks(self) -> MarkLooks:
        """Short marks that the frames show."""
        masks = self.looker.masks
        shown = (
            (index, mask, rays)
            for index in self.progress(self.moving, "marks")
            for mask, rays in zip(masks.masks(self.frames[index]), self.looker.rays, strict=True)
        )
        return MarkLooks.of(shown, masks.table)


def step_between_m(Ts_map_base: Float[np.ndarray, "n 4 4"]) -> float:
    """Way between the frames of a drive that count [m], in the median; 0 where it stands."""
    way_m = np.linalg.norm(np.diff(Ts_map_base[_moving(Ts_map_base), :2, 3], axis=0), axis=1)
    return float(np.median(way_m)) if len(way_m) else 0.0


def _moving(Ts_map_base: np.ndarray) -> list[int]:
    """Frames in which the vehicle has moved on since the last one that counts."""
    chosen = [0]
    for index in range(1, len(Ts_map_base)):
        if np.linalg.norm(Ts_map_base[index, :2, 3] - Ts_map_base[chosen[-1], :2, 3]) >= _STILL_M:
            chosen.append(index)
    return chosen
