"""Which drives have a way that is bent more than those of the others (room: mapping; host).

In: drives as one solve has laid them onto each other. Out: by how much the way of each may bend.
A gyroscope that is off turns a whole way in one direction, and the elements beside it agree with it: only the ways of
the others tell. A world that has changed bends no way: it moves things, not all that lies around a place.
"""

from collections.abc import Sequence

import numpy as np

from semloc_jax.mapping.crowd.correction import Correction

_LEAST_DRIVES = 3
"""Two drives that are bent against each other do not say which of them is."""
_LEAST_USUAL = 0.3
"""Mean square of usual bends, in what was expected before: less makes no drive that bends as expected an exception."""
_STILL_USUAL, _MOST = 3.0, 4.0
"""Nearly all of the bend of a drive is one number, the bias of its gyroscope: a square of three times the median is no
exception yet. Of what bends farther the influence falls; how far at most. All ours."""


def judge_bends(drives: Sequence[Correction]) -> None:
    """Says of each drive how many times as much as usual its way may bend: never less."""
    own = [drive for drive in drives if drive.num_nodes]
    if len(own) < _LEAST_DRIVES:
        return
    square = np.array([drive.bend for drive in own])
    usual = max(float(np.median(square)), _LEAST_USUAL)
    bent = np.clip(square / (_STILL_USUAL * usual), 1.0, _MOST)
    for drive, factor in zip(own, bent.tolist(), strict=True):
        drive.bent = factor
