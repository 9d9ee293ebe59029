"""Which landmark each shape in the masks is: by radius, class, chi-square gate, one to one (room: alignment; host).

In: a Prediction, sights. Out: Match list.
Signs and posts are assigned one to one (Hungarian). A lane is cut into many curves by dashes and traffic: each curve
takes the lane that it fits best.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.explicit.pairs import PAIRS, Match
from semloc_jax.alignment.explicit.prediction import Prediction
from semloc_jax.alignment.explicit.sights import ShapeSight
from semloc_jax.structs import ElementClass

_NONE = 1e6
"""Cost of a pair that is none."""


def associated(prediction: Prediction, sights: Sequence[ShapeSight]) -> list[Match]:
    """The pairs of shapes and landmarks, one to one for what stands.

    Shapes that could be something else as well are left out, unless there are no others: two lines of a double one are
    told apart where other landmarks have said enough.
    """
    found: list[Match] = []
    doubtful: list[Match] = []
    for camera in range(len(prediction.rig)):
        own = [sight for sight in sights if sight.camera == camera]
        for label, pair in PAIRS.items():
            wanted = [sight for sight in own if sight.label == label]
            candidates = prediction.candidates(label, camera)
            if not wanted or not candidates:
                continue
            pairs = [[pair(prediction, k, sight) for k in candidates] for sight in wanted]
            costs = np.array([[np.inf if p is None else p[0] for p in row] for row in pairs])
            for i, j in _chosen(costs, is_one_to_one=label != ElementClass.LANE_MARKING):
                others = np.delete(costs[i], j)
                is_clear = others.min(initial=np.inf) - costs[i, j] > prediction.config.clearly
                if prediction.distance_m(candidates[j], camera) < prediction.config.reach_m(label):
                    (found if is_clear else doubtful).append(pairs[i][j][1])
    return found or doubtful


def _chosen(costs: Float[np.ndarray, "a b"], is_one_to_one: bool) -> list[tuple[int, int]]:
    """Pairs of rows and columns, infinite ones left out."""
    if is_one_to_one:
        from scipy.optimize import linear_sum_assignment  # with it come SciPy's Fourier transforms and sparse graphs

        rows, columns = linear_sum_assignment(np.minimum(costs, _NONE))
    else:
        rows, columns = np.arange(len(costs)), costs.argmin(axis=1)
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if np.isfinite(costs[i, j])]
