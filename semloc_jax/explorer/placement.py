"""A vehicle pose that the user drags: a place on the road, and the offsets from the road (room: explorer).

In: a pose or six numbers. Out: Placement, T_map_base.
"""

from dataclasses import astuple, dataclass

import numpy as np

from semloc_jax.maps import SemanticMap


@dataclass(frozen=True)
class Placement:
    """x, y and heading in the map frame; height, roll and pitch against the plane of the road there.

    The heading is that of the x axis seen from above. A positive pitch lowers the nose, a positive roll the right side.
    """

    x_m: float
    y_m: float
    yaw_deg: float
    height_m: float = 0.0
    roll_deg: float = 0.0
    pitch_deg: float = 0.0

    @classmethod
    def of(cls, T_map_base: np.ndarray, semantic_map: SemanticMap) -> "Placement":
        """The six numbers of a pose.

        Raises:
            SemlocError: the map has no road near the pose.
        """
        yaw, pitch, roll = _angles(T_map_base)
        road = semantic_map.road_pose(*map(float, T_map_base[:2, 3]), yaw)
        _, road_pitch, road_roll = _angles(road)
        tilt = np.rad2deg([yaw, roll - road_roll, pitch - road_pitch])
        return cls(*map(float, (*T_map_base[:2, 3], tilt[0], T_map_base[2, 3] - road[2, 3], *tilt[1:])))

    def pose(self, semantic_map: SemanticMap) -> np.ndarray:
        """T_map_base `float64[4 4]`; the inverse of `of`.

        Raises:
            SemlocError: the map has no road near the place.
        """
        yaw = float(np.deg2rad(self.yaw_deg))
        T = semantic_map.road_pose(self.x_m, self.y_m, yaw)
        _, pitch, roll = _angles(T)
        T[:3, :3] = _rotation(yaw, pitch + np.deg2rad(self.pitch_deg), roll + np.deg2rad(self.roll_deg))
        T[2, 3] += self.height_m
        return T

    def on_road(self) -> "Placement":
        """The same place with all wheels on the road."""
        return Placement(*astuple(self)[:3])


def _angles(T: np.ndarray) -> tuple[float, float, float]:
    """Yaw, pitch and roll [rad] of R = Rz(yaw) Ry(pitch) Rx(roll)."""
    R = T[:3, :3]
    yaw, pitch = np.arctan2(R[1, 0], R[0, 0]), np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    return float(yaw), float(pitch), float(np.arctan2(R[2, 1], R[2, 2]))


def _rotation(yaw: float, pitch: float, roll: float) -> np.ndarray:
    (cy, cp, cr), (sy, sp, sr) = np.cos([yaw, pitch, roll]), np.sin([yaw, pitch, roll])
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return about_z @ about_y @ about_x
