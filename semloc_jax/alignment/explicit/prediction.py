"""What cameras should see of the landmarks from a predicted pose (room: alignment; host).

In: landmarks, a pose with covariance. Out: Prediction: their pixels, which are in view, how much of them should show.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri

from semloc_jax.alignment.explicit.landmarks import Landmark
from semloc_jax.alignment.explicit.sights import ProjectedPoints, projected
from semloc_jax.cameras import Camera, Rig
from semloc_jax.geometry import rigid
from semloc_jax.perception.primitives import Primitives
from semloc_jax.perception.sight_lines import sight_lines
from semloc_jax.residuals.seen_point import PointSight
from semloc_jax.structs import ElementClass

_AXIS_PLACES = 12
"""Places of a post by which rows find their height."""


@dataclass(frozen=True)
class AssociationConfig:
    """What may be what. All values are ours."""

    upright_radius_m: float = 60.0
    lane_radius_m: float = 35.0
    gate_probability: float = 0.99
    """A pair beyond this quantile of the chi-square distribution is none."""
    size_ratio: float = 1.6
    size_px: float = 2.5
    """Sizes that differ by more than this ratio and this many pixels are those of different things."""
    tilt: float = 0.06
    """A line that leans against a post by more than this slope is an arm or something else."""
    least_sign_px: float = 6.0
    """Half the side of a sign in view that should be seen."""
    least_high_px: float = 30.0
    """Height in the image of a post or a lane that should be seen."""
    clearly: float = 9.0
    """By so much the normalised square of a pair is less than that of any other pair of the shape."""
    map_sigma_m: float = 0.02
    """Of a landmark against its neighbours."""

    def gate(self, size: int) -> float:
        """Chi-square limit of so many residuals."""
        return float(chdtri(size, 1.0 - self.gate_probability))

    def reach_m(self, label: ElementClass) -> float:
        """How far a landmark of a class may be."""
        return self.lane_radius_m if label == ElementClass.LANE_MARKING else self.upright_radius_m


class Offsets(NamedTuple):
    """Points beside measured pixels, with derivatives by the right tangent of the pose."""

    off: Float[np.ndarray, "n 2"]
    by_pose: Float[np.ndarray, "n 2 6"]
    distance_m: Float[np.ndarray, " n"]


def offsets(T_local_base: np.ndarray, points: Float[np.ndarray, "n 3"], sights: PointSight) -> Offsets:
    """The same as `residuals.seen_point`, of many, in numpy."""
    p_base = (points - T_local_base[:3, 3]) @ T_local_base[:3, :3]
    R_cam_base = np.swapaxes(sights.T_base_cam[:, :3, :3], 1, 2)
    q = np.einsum("nij,nj->ni", R_cam_base, p_base - sights.T_base_cam[:, :3, 3])
    depth = np.einsum("ni,ni->n", sights.ray_cam, q)
    distance = np.linalg.norm(q, axis=1)
    depth = np.maximum(depth, 0.1 * distance)
    off = np.einsum("nij,nj->ni", sights.pixels, q) / depth[:, None]
    by_q = (sights.pixels - off[:, :, None] * sights.ray_cam[:, None]) / depth[:, None, None]
    move = np.concatenate([np.tile(-np.eye(3), (len(q), 1, 1)), rigid.skew(p_base)], axis=2)
    return Offsets(off, by_q @ R_cam_base @ move, distance)


@dataclass(frozen=True)
class Prediction:
    """Where the vehicle should be, and what its cameras should see there.

    Attributes:
        T_local_base: Predicted pose.
        covariance: Of its right tangent.
        landmarks: Of the map around.
        rig: Cameras.
        config: What may be what.
    """

    T_local_base: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]
    landmarks: Sequence[Landmark]
    rig: Rig
    config: AssociationConfig

    @cached_property
    def parts(self) -> tuple[Float[np.ndarray, "n 3"], np.ndarray]:
        """Points by which landmarks are found in an image, and where those of each begin."""
        parts = [_sought(landmark) for landmark in self.landmarks]
        return np.concatenate([np.zeros((0, 3)), *parts]), np.cumsum([0, *(len(part) for part in parts)])

    @cached_property
    def views(self) -> tuple[ProjectedPoints, ...]:
        """These points in each camera."""
        Ts = self.T_local_base @ np.asarray(self.rig.T_base_cam, np.float64)
        return tuple(projected(camera, T, self.parts[0]) for camera, T in zip(self.rig.cameras, Ts, strict=True))

    def of(self, landmark: int, camera: int) -> tuple[np.ndarray, ProjectedPoints]:
        """Points of a landmark, and where a camera sees them."""
        own = slice(*self.parts[1][landmark : landmark + 2])
        view = self.views[camera]
        return self.parts[0][own], ProjectedPoints(view.uv[own], view.in_view[own], view.distance_m[own])

    def candidates(self, label: ElementClass, camera: int) -> list[int]:
        """Landmarks of a class that are in view of a camera, however far: far ones are what a shape could be, too."""
        found = []
        for k, landmark in enumerate(self.landmarks):
            if landmark.label != label:
                continue
            if self.of(k, camera)[1].in_view.any() and (landmark.normal is None or self._faces(landmark, camera)):
                found.append(k)
        return found

    def distance_m(self, landmark: int, camera: int) -> float:
        """Distance of the nearest part of a landmark that a camera sees [m]."""
        view = self.of(landmark, camera)[1]
        return float(view.distance_m[view.in_view].min(initial=np.inf))

    def _faces(self, landmark: Landmark, camera: int) -> bool:
        place = (self.T_local_base @ np.asarray(self.rig.T_base_cam, np.float64)[camera])[:3, 3]
        return bool(landmark.normal @ (place - landmark.middle) > 0.0)

    def expected_px(self, primitives: Sequence[Primitives]) -> Float[np.ndarray, " landmark"]:
        """How much outline of each landmark all cameras should show together [px]; 0 for what is out of view, hidden,
        or too small."""
        found = np.zeros(len(self.landmarks))
        for camera, own in enumerate(primitives):
            for label in (ElementClass.SIGN, ElementClass.POLE, ElementClass.LANE_MARKING):
                for k in self.candidates(label, camera):
                    found[k] += self._outline_px(k, camera, own)
        return found

    def _outline_px(self, k: int, camera: int, primitives: Primitives) -> float:
        landmark, config, view = self.landmarks[k], self.config, self.of(k, camera)[1]
        uv = view.uv[view.in_view]
        if primitives.is_hidden(uv).mean() > 0.5 or self.distance_m(k, camera) > config.reach_m(landmark.label):
            return 0.0
        if landmark.label == ElementClass.SIGN:
            half_px = landmark.radius_m / float(view.distance_m[0]) * _px_per_rad(self.rig.cameras[camera])
            return 8.0 * half_px if half_px >= config.least_sign_px else 0.0
        rows = uv[view.distance_m[view.in_view] < config.reach_m(landmark.label), 1]
        high_px = float(np.ptp(rows)) if len(rows) else 0.0
        return 2.0 * high_px if high_px >= config.least_high_px else 0.0


def _px_per_rad(camera: Camera) -> float:
    """Pixels of a small angle in the middle of an image."""
    middle = 0.5 * np.array(camera.resolution, np.float64)
    pixels = sight_lines(camera, middle[None]).pixels[0]
    return float(np.sqrt(np.linalg.norm(np.cross(pixels[0], pixels[1]))))


def _sought(landmark: Landmark) -> np.ndarray:
    if landmark.label == ElementClass.SIGN:
        return landmark.middle[None]
    if landmark.label == ElementClass.POLE:
        share = np.linspace(0.0, 1.0, _AXIS_PLACES)[:, None]
        return landmark.points[0] + share * (landmark.points[1] - landmark.points[0])
    return landmark.points
