"""Maps of stretches of a drive's own way, to look for loops in (room: mapping; host).

In: a drive, its masks, its chain. Out: what a mapper makes of a stretch, in the frame `odom` of the chain.
Along so short a way the chain hardly drifts. A stretch is mapped as a whole: at the seams of smaller pieces elements
are seen too seldom to stay. Posts and signs are in it: along solid lines they alone tell how far the vehicle has come.
"""

from collections import OrderedDict
from dataclasses import replace

import numpy as np
from jaxtyping import Int

from semloc_jax.datasets import Drive
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.chain import Chain
from semloc_jax.mapping.drive_looks import step_between_m
from semloc_jax.mapping.looking import Looker
from semloc_jax.mapping.mapper import MapConfig, make_map
from semloc_jax.maps import SemanticMap

LOOK_EVERY_M = 1.2
"""Way between the frames that look: a map to find a place in needs fewer than one to keep; ours."""
SPACING_M = 0.04
"""Distance of the places on the road that are looked at: likewise."""
_KEPT = 4
"""Stretches that stay in memory."""


class StretchMaps:
    """What a mapper makes of stretches of a drive."""

    def __init__(self, drive: Drive, masks: MaskSource, chain: Chain, config: MapConfig | None = None) -> None:
        """Nothing is made before it is asked for."""
        config = config or MapConfig()
        self.drive, self.masks, self.chain = drive, masks, chain
        look, settle = replace(config.look, spacing_m=SPACING_M), replace(config.settle, rounds=0)
        self.config = replace(config, look=look, settle=settle)
        self._looker: Looker | None = None
        self._made: OrderedDict[tuple[int, int], SemanticMap | None] = OrderedDict()

    def __call__(self, frames: Int[np.ndarray, " k"]) -> SemanticMap | None:
        """The map of some frames in a row; None where nothing was seen."""
        if not len(frames):
            return None
        # Whole steps of the way, so that nearly the same stretch is the same.
        _, first = np.unique(np.floor(self.chain.way_m[frames] / LOOK_EVERY_M), return_index=True)
        rows = frames[first]
        key = int(rows[0]), int(rows[-1])
        if key not in self._made:
            self._made[key] = self._map_of(rows)
            while len(self._made) > _KEPT:
                self._made.popitem(last=False)
        self._made.move_to_end(key)
        return self._made[key]

    def _map_of(self, rows: np.ndarray) -> SemanticMap | None:
        frames = [self.drive.frames[row] for row in rows]
        poses = self.chain.Ts_odom_base[rows]
        if self._looker is None:
            self._looker = Looker(self.drive, self.masks, self.config.look, step_between_m(poses))
        try:
            made = make_map(self.drive, self.masks, frames, poses, self.config, looker=self._looker)
        # Nothing that stays was seen along the stretch; what is wrong with the whole drive, its own map will say.
        except SemlocError:
            return None
        return made.belief_map.map
