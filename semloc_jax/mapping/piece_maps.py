"""Maps of pieces of a drive's own way, to look for loops in (room: mapping; host).

In: a drive, its masks, its chain. Out: what a mapper makes of a stretch, in the frame `odom` of the chain.
Each piece is made once, when a stretch asks for it; along so short a way the chain hardly drifts.
"""

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Int

from semloc_jax.datasets import Drive
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.mapping.chain import Chain
from semloc_jax.mapping.mapper import MapConfig, make_map
from semloc_jax.maps import MapElement, SemanticMap

PIECE_M = 20.0
"""Way of one piece; ours. A stretch of 60 m is at most four of them."""
LOOK_EVERY_M = 2.0
"""Way between the frames that look: a map to find a place in needs fewer than one to keep; ours."""
_KEPT = 24
"""Pieces that stay in memory: those of a stretch, and of the one before."""


class PieceMaps:
    """What a mapper makes of stretches of a drive."""

    def __init__(self, drive: Drive, masks: MaskSource, chain: Chain, config: MapConfig | None = None) -> None:
        """Nothing is made before it is asked for."""
        self.drive, self.masks, self.chain, self.config = drive, masks, chain, config
        self._piece_of_frame = np.floor(chain.way_m / PIECE_M).astype(int)
        self._made: OrderedDict[int, tuple[MapElement, ...]] = OrderedDict()

    def __call__(self, frames: Int[np.ndarray, " k"]) -> SemanticMap | None:
        """The map of the pieces that some frames lie in; None where nothing was seen."""
        elements = [element for piece in np.unique(self._piece_of_frame[frames]) for element in self._of(int(piece))]
        return SemanticMap(tuple(elements), name=f"stretch of {self.drive.name}") if elements else None

    def _of(self, piece: int) -> tuple[MapElement, ...]:
        if piece not in self._made:
            self._made[piece] = tuple(self._elements(piece))
            while len(self._made) > _KEPT:
                self._made.popitem(last=False)
        self._made.move_to_end(piece)
        return self._made[piece]

    def _elements(self, piece: int) -> Iterator[MapElement]:
        rows = np.flatnonzero(self._piece_of_frame == piece)
        _, first = np.unique(np.floor(self.chain.way_m[rows] / LOOK_EVERY_M), return_index=True)
        rows = rows[first]
        frames = [self.drive.frames[row] for row in rows]
        try:
            made = make_map(self.drive, self.masks, frames, self.chain.Ts_odom_base[rows], self.config)
        # Nothing that stays was seen along the piece; what is wrong with the whole drive, its own map will say.
        except SemlocError:
            return
        for element in made.belief_map.map.elements:
            yield replace(element, id=f"{piece}/{element.id}")
