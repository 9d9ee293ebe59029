"""Which landmark each shape in the masks is: by radius, class, chi-square gate, one to one (room: alignment; host).

In: landmarks, sights, a predicted pose with covariance. Out: Match list, and which landmarks should be in view.
Signs and posts are assigned one to one (Hungarian). A lane is cut into many curves by dashes and traffic: each curve
takes the lane that it fits best.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment
from scipy.special import chdtri

from semloc_jax.alignment.compact_landmarks import Landmark
from semloc_jax.alignment.explicit_sights import ProjectedPoints, ShapeSight, projected
from semloc_jax.cameras import Camera, Rig
from semloc_jax.geometry import rigid
from semloc_jax.perception.primitives import Primitives
from semloc_jax.perception.sight_lines import sight_lines
from semloc_jax.perception.sign_outlines import SignOutline
from semloc_jax.residuals.seen_point import PointSight
from semloc_jax.structs import ElementClass

ROUNDING_PX = 0.2
"""Standard deviation of any place in a mask that is left however well a shape fits: masks lie beside images."""
_AXIS_PLACES = 12
"""Places of a post by which rows find their height."""
_NONE = 1e6


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


class Match(NamedTuple):
    """A shape that is held for a landmark."""

    landmark: int
    sight: ShapeSight
    points: Float[np.ndarray, "k 3"]
    """Points of the landmark that belong to the places of the shape, in the local frame [m]."""
    used: tuple[int, ...]
    """Which places of the shape these are."""
    has_end: tuple[bool, bool] = (False, False)
    """Of a post: whether its lower and upper end are those of the map."""


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


def associated(prediction: Prediction, sights: Sequence[ShapeSight]) -> list[Match]:
    """The pairs of shapes and landmarks, one to one for what stands.

    Shapes that could be something else as well are left out, unless there are no others: two lines of a double one are
    told apart where other landmarks have said enough.
    """
    found: list[Match] = []
    doubtful: list[Match] = []
    for camera in range(len(prediction.rig)):
        own = [sight for sight in sights if sight.camera == camera]
        for label, pair in _PAIRS.items():
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
        rows, columns = linear_sum_assignment(np.minimum(costs, _NONE))
    else:
        rows, columns = np.arange(len(costs)), costs.argmin(axis=1)
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if np.isfinite(costs[i, j])]


def _distance(r: np.ndarray, J: np.ndarray, noise: np.ndarray, prediction: Prediction) -> float | None:
    """Normalised square of residuals whose gate they pass, with the volume of what was possible; else None."""
    S = J @ prediction.covariance @ J.T + noise
    chi2 = float(r @ np.linalg.solve(S, r))
    if not chi2 < prediction.config.gate(len(r)):
        return None
    return chi2 + float(np.linalg.slogdet(S)[1])


def _is_alike(seen_px: float, expected_px: float, config: AssociationConfig) -> bool:
    low, high = sorted((seen_px, expected_px))
    return bool(high - low <= config.size_px or high <= config.size_ratio * low)


def _sign_pair(prediction: Prediction, k: int, sight: ShapeSight) -> tuple[float, Match] | None:
    landmark, outline = prediction.landmarks[k], sight.shape
    if not are_of_one_shape(landmark, outline):
        return None
    first = PointSight(*(leaf[:1] for leaf in sight.sights))
    at = offsets(prediction.T_local_base, landmark.middle[None], first)
    if not _is_alike(half_px(outline), landmark.radius_m / at.distance_m[0] * sight.px_per_rad, prediction.config):
        return None
    noise = outline.centre_sigma_px**2 + (sight.px_per_rad * prediction.config.map_sigma_m / at.distance_m[0]) ** 2
    cost = _distance(at.off[0], at.by_pose[0], noise * np.eye(2), prediction)
    if cost is None:
        return None
    return cost, sign_match(prediction.T_local_base, k, landmark, sight)


def are_of_one_shape(landmark: Landmark, outline: SignOutline) -> bool:
    """Whether a sign of the map may look like an outline; a patch may be anything."""
    return "patch" in (outline.shape, landmark.shape) or outline.shape == landmark.shape


def sign_match(T_local_base: Float[np.ndarray, "4 4"], k: int, landmark: Landmark, sight: ShapeSight) -> Match:
    """A sign taken for a landmark: by its corners where both have them, else by its centre.

    Args:
        T_local_base: About where the vehicle is: decides which corner is which.
        k: Place of the landmark.
        landmark: The sign of the map.
        sight: As it is seen.
    """
    if sight.shape.shape == landmark.shape and len(sight.shape.corners):
        points = _in_order(T_local_base, landmark.points, sight)
        return Match(k, sight, points, tuple(range(1, 1 + len(points))))
    return Match(k, sight, landmark.middle[None], (0,))


def half_px(outline) -> float:
    """Size of an outline as `Landmark.radius_m` has it."""
    return outline.radius_px if outline.shape == "circle" else 0.5 * float(np.sqrt(outline.area_px))


def _in_order(T_local_base: np.ndarray, corners: np.ndarray, sight: ShapeSight) -> np.ndarray:
    """The corners of the map in the cyclic order that fits the seen ones best."""
    num, best = len(corners), None
    sights = PointSight(*(leaf[1:] for leaf in sight.sights))
    for way in (corners, corners[::-1]):
        for shift in range(num):
            order = np.roll(way, shift, axis=0)
            off = offsets(T_local_base, order, sights).off
            cost = float(np.sum((off - off.mean(axis=0)) ** 2))
            if best is None or cost < best[0]:
                best = cost, order
    return best[1]


def _post_pair(prediction: Prediction, k: int, sight: ShapeSight) -> tuple[float, Match] | None:
    points, view = prediction.of(k, sight.camera)
    seen = np.isfinite(view.uv).all(axis=1)
    lamp, rows = sight.shape, sight.uv[:, 1]
    if seen.sum() < 2:
        return None
    order = np.argsort(view.uv[seen, 1])
    v, p = view.uv[seen, 1][order], points[seen][order]
    covered = min(rows[0], v[-1]) - max(rows[1], v[0])
    if covered < 0.6 * (rows[0] - rows[1]):
        return None
    on_axis = np.stack([np.interp(rows, v, p[:, i]) for i in range(3)], axis=1)
    at = offsets(prediction.T_local_base, on_axis, sight.sights)
    normal = lamp.axis.normal(rows)
    r, J = np.einsum("ni,ni->n", normal, at.off), np.einsum("ni,nij->nj", normal, at.by_pose)
    if abs(r[0] - r[1]) > prediction.config.tilt * (rows[0] - rows[1]) + 4.0 * ROUNDING_PX:
        return None
    noise = lamp.axis.covariance_across(rows) + np.diag(
        (sight.px_per_rad * prediction.config.map_sigma_m / at.distance_m) ** 2
    )
    cost = _distance(r, J, noise, prediction)
    if cost is None:
        return None
    ends = prediction.landmarks[k].points
    off = offsets(prediction.T_local_base, ends, sight.sights)
    along = np.array([-normal[:, 1], normal[:, 0]]).T
    d, D = np.einsum("ni,ni->n", along, off.off), np.einsum("ni,nij->nj", along, off.by_pose)
    spread = lamp.end_sigma_px**2 + np.einsum("ni,ij,nj->n", D, prediction.covariance, D)
    is_end = (d**2 < prediction.config.gate(1) * spread) & np.array(lamp.has_end)
    chosen = np.where(is_end[:, None], ends, on_axis)
    return cost, Match(k, sight, chosen, (0, 1), (bool(is_end[0]), bool(is_end[1])))


def _lane_pair(prediction: Prediction, k: int, sight: ShapeSight) -> tuple[float, Match] | None:
    """As MLVHM: the point of the lane in the row of each place of the curve."""
    points, view = prediction.of(k, sight.camera)
    near = view.in_view & (view.distance_m < prediction.config.reach_m(sight.label))
    if near.sum() < 2:
        return None
    order = np.argsort(view.uv[near, 1])
    v, p = view.uv[near, 1][order], points[near][order]
    rows = sight.uv[:, 1]
    used = np.flatnonzero((rows >= v[0]) & (rows <= v[-1]))
    if len(used) < max(2, len(rows) // 2):
        return None
    on_lane = np.stack([np.interp(rows[used], v, p[:, i]) for i in range(3)], axis=1)
    at = offsets(prediction.T_local_base, on_lane, PointSight(*(leaf[used] for leaf in sight.sights)))
    normal = sight.shape.normal(rows[used])
    r, J = np.einsum("ni,ni->n", normal, at.off), np.einsum("ni,nij->nj", normal, at.by_pose)
    scale = sight.px_per_rad / at.distance_m
    width_px, expected_px = sight.shape.width_across(rows[used]), prediction.landmarks[k].width_m * scale
    # Across the view the road is foreshortened.
    wide_px = float((expected_px * np.abs(normal[:, 0])).mean())
    if wide_px > 0.0 and not _is_alike(float(width_px.mean()), wide_px, prediction.config):
        return None
    noise = lane_noise(sight, rows[used], at.distance_m, prediction.config)
    cost = _distance(r, J, noise, prediction)
    return None if cost is None else (cost, Match(k, sight, on_lane, tuple(int(i) for i in used)))


def lane_noise(
    sight: ShapeSight,
    rows: Float[np.ndarray, " k"],
    distance_m: Float[np.ndarray, " k"],
    config: AssociationConfig,
) -> Float[np.ndarray, "k k"]:
    """Covariance of the places of a curve against a lane of the map, across it [px^2]."""
    shared_px = sight.px_per_rad / distance_m * config.map_sigma_m
    # A curve knows no more than its coefficients, at however many places it is asked. Its places are taken one by one:
    # how it bends tells more of wobbly masks than of the pose.
    repeats = max(len(rows) / len(sight.shape.coefficients), 1.0)
    own = repeats * np.diagonal(sight.shape.covariance_across(rows)) + ROUNDING_PX**2
    return np.diag(own) + np.outer(shared_px, shared_px)


_PAIRS = {
    ElementClass.SIGN: _sign_pair,
    ElementClass.POLE: _post_pair,
    ElementClass.LANE_MARKING: _lane_pair,
}
"""Cost and match of a landmark and a shape of each class; None where they are not the same."""
