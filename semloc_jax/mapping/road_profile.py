"""Height of the road beside a way (room: mapping; host).

In: heights by distance to the left of the way. Out: RoadProfile, which tells them at places.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class RoadProfile:
    """Height of the road above the plane of the vehicle, beside each pose of a way.

    Attributes:
        left_m: `float64[k]` distances to the left of the way, ascending [m].
        height_m: `float64[n k]`, for each pose [m].
    """

    left_m: Float[np.ndarray, " k"]
    height_m: Float[np.ndarray, "n k"]

    def at(self, pose: Int[np.ndarray, " m"], left_m: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Height [m] at distances to the left of some poses, given by their rows."""
        step_m = self.left_m[1] - self.left_m[0]
        at = np.clip((left_m - self.left_m[0]) / step_m, 0, len(self.left_m) - 1.001)
        column = at.astype(np.int32)
        share = at - column
        return (1.0 - share) * self.height_m[pose, column] + share * self.height_m[pose, column + 1]
