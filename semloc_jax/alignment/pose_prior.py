"""First guess of the vehicle pose, as the solver takes it (room: alignment; host).

In: place and heading with standard deviations, the road of the map. Out: T_map_base, Prior.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from semloc_jax.alignment.pose import Prior
from semloc_jax.datasets import Frame
from semloc_jax.errors import SemlocError
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.maps import SemanticMap


@dataclass(frozen=True)
class RoadSigmas:
    """How far a vehicle may stand off the plane of the road at its place. All values are ours.

    A loaded or braking car pitches and rolls by some tenths of a degree; the plane itself is fitted to map paint.
    """

    height_m: float = 0.03
    roll_pitch_deg: float = 0.5


@dataclass(frozen=True)
class PosePrior:
    """Horizontal position and heading with standard deviations; the rest comes from the road of the map."""

    x_m: float
    y_m: float
    heading_rad: float
    sigma_xy_m: float
    sigma_heading_rad: float

    def on_road(self, semantic_map: SemanticMap) -> np.ndarray:
        """T_map_base of a vehicle that stands there on the road.

        Raises:
            SemlocError: the prior is not finite, or the map has no road there.
        """
        if not np.isfinite([self.x_m, self.y_m, self.heading_rad, self.sigma_xy_m, self.sigma_heading_rad]).all():
            raise SemlocError(f"prior pose {self}: NaN or infinite; expected finite numbers")
        return semantic_map.road_pose(self.x_m, self.y_m, self.heading_rad)

    def to_solver(self, T_map_base: np.ndarray, frame: LocalFrame, road: RoadSigmas) -> Prior:
        """The Gaussian prior of the solver around `T_map_base`, in a local frame."""
        tilt = np.deg2rad(road.roll_pitch_deg)
        sigma = [self.sigma_xy_m, self.sigma_xy_m, road.height_m, tilt, tilt, self.sigma_heading_rad]
        return Prior(jnp.asarray(frame.from_map(T_map_base)), jnp.asarray(sigma, jnp.float32))


PriorSource = Callable[[Frame], PosePrior]
