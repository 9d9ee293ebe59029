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
from semloc_jax.geometry import rigid
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.maps import RoadSpread, SemanticMap

_FLAT = RoadSpread()


@dataclass(frozen=True)
class RoadSigmas:
    """How far a vehicle may stand off a flat road. All values are ours.

    A loaded or braking car pitches and rolls by some tenths of a degree. Where the road is crowned, what the map leaves
    open of its surface under the vehicle comes on top.
    """

    height_m: float = 0.03
    roll_pitch_deg: float = 0.5

    def on(self, spread: RoadSpread) -> np.ndarray:
        """Standard deviations `float64[3]` of height [m], roll and pitch [rad] on a road of this spread."""
        tilt = np.deg2rad(self.roll_pitch_deg)
        # 0 locks a direction: it stays locked on any road.
        own = np.array([self.height_m, tilt, tilt])
        return np.where(own > 0.0, np.hypot(own, spread), 0.0)


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

    def to_solver(
        self, T_map_base: np.ndarray, frame: LocalFrame, road: RoadSigmas, spread: RoadSpread = _FLAT
    ) -> Prior:
        """The Gaussian prior of the solver around `T_map_base`, in a local frame.

        Args:
            T_map_base: pose on the road of the map.
            frame: local frame.
            road: how far a vehicle stands off it.
            spread: how far the road is from a plane there; see `SemanticMap.road_spread`.
        """
        sigma = [self.sigma_xy_m, self.sigma_xy_m, *road.on(spread), self.sigma_heading_rad]
        return Prior(jnp.asarray(frame.from_map(T_map_base)), jnp.asarray(sigma, jnp.float32))


def levelled(
    T_local_found: np.ndarray, prior: Prior, semantic_map: SemanticMap, frame: LocalFrame, road: RoadSigmas
) -> tuple[np.ndarray, Prior]:
    """Pose and prior at the same places, but with height, roll and pitch of the road where the pose was found.

    Args:
        T_local_found: pose that is to be refined, in the local frame.
        prior: around the first guess, in the local frame.
        semantic_map: the map; where it has no road at that pose both stay as they are.
        frame: local frame.
        road: how far a vehicle stands off the road.
    """
    T = frame.to_map(T_local_found)
    try:
        T, spread = semantic_map.road_under(*T[:2, 3], float(np.arctan2(T[1, 0], T[0, 0])), near_z_m=float(T[2, 3]))
    except SemlocError:
        return T_local_found, prior
    T_local_base = frame.from_map(T, np.float64)
    planar = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    back = rigid.log(rigid.inverse(T_local_base) @ np.asarray(prior.T_local_base, np.float64)) * planar
    sigma = np.asarray(prior.sigma, np.float64).copy()
    sigma[2:5] = road.on(spread)
    T_around = jnp.asarray(T_local_base @ rigid.exp(back), jnp.float32)
    around = Prior(T_around, jnp.asarray(sigma, jnp.float32), prior.terms)
    return T_local_base.astype(np.float32), around


PriorSource = Callable[[Frame], PosePrior]
