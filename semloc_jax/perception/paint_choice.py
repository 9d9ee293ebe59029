"""Which strokes of a top view are paint on a road (room: perception; host).

In: Strokes, the top view with its colours. Out: those that are paint, by contrast, colour, direction and company.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from semloc_jax.perception.ground_view import GroundView
from semloc_jax.perception.paint_profiles import MIN_CONTRAST, RidgeProfiles
from semloc_jax.perception.paint_strokes import Stroke

_FLANK_M = 0.12
_GREEN = 0.012
"""Share by which green exceeds both red and blue in grass; white paint, yellow paint and road have none."""
_RED = 0.1
_SOFT_M, _SOFT_PX = 0.06, 1.0
"""Edges of paint are as sharp as the picture; those of shade are softer by the width of the sun."""
_MIN_WIDTH_PX = 1.5
"""A bar across the view that is no wider in the image may be anything that is bright."""
_RADIAL_RAD = 0.1
"""What stands is smeared along its ray."""


@dataclass(frozen=True)
class StrokeLimits:
    """What a stroke of paint is like."""

    min_length_m: float
    min_length_px: float
    """In pixels of the image along the stroke: far away all that stands or is lit is smeared into a stroke."""
    max_scatter_m: float
    """Root mean square of the ridge's distance from a smooth curve."""
    max_width_scatter: float
    """Median deviation of the width, as a share of the width."""
    min_contrast: float
    """Median contrast of the weaker side, in log brightness."""
    grey_sides: int
    """On how many sides the ground must have no colour of grass."""


ALONG = StrokeLimits(1.2, 2.0, 0.03, 0.25, 0.2, 1)
"""Strokes that run with the road."""
ACROSS = StrokeLimits(1.2, 4.0, 0.02, 0.12, 0.3, 2)
"""Strokes of any direction: stop lines, crosswalks, arrows."""
CONTINUED = StrokeLimits(0.6, 1.0, 0.03, 0.3, 0.12, 1)
"""Strokes in line with one that is paint."""


@dataclass(frozen=True)
class TopView:
    """A top view with its colours, and how fine the image is there."""

    picture: np.ndarray
    """BGR, float32[h w 3], smoothed."""
    foot_uv: np.ndarray
    """Point below the camera [px]."""
    view: GroundView

    @classmethod
    def of(cls, top: np.ndarray, view: GroundView, T_base_cam: np.ndarray) -> "TopView":
        """The top view of one image.

        Args:
            top: uint8[h w 3] BGR.
            view: where its pixels lie in the image.
            T_base_cam: pose of the camera above the road.
        """
        x_m, y_m = T_base_cam[:2, 3]
        scale = float(view.bev.fx)
        foot = np.array([float(view.bev.cx) - y_m * scale, float(view.bev.cy) - x_m * scale])
        return cls(cv2.GaussianBlur(top, (0, 0), 1.5).astype(np.float32), foot, view)

    @property
    def metres_per_px(self) -> float:
        """Size of a pixel of the top view."""
        return 1.0 / float(self.view.bev.fx)

    def pixel_m(self, uv: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Metres of road in one pixel of the image at places of the top view, along directions; float[n]."""
        ends = []
        for sign in (-1.0, 1.0):
            at = np.round(uv + 2.0 * sign * direction).astype(int)
            u, v = (np.clip(at[..., i], 0, self.view.visible.shape[1 - i] - 1) for i in (0, 1))
            ends.append(self.view.image_uv[v, u])
        image_px = np.linalg.norm(ends[1] - ends[0], axis=-1)
        # Over the rim of what is seen the difference says nothing: such points count as fine.
        return np.where(image_px > 1e3, 0.0, 4.0 * self.metres_per_px / np.maximum(image_px, 1e-3))

    def colours(self, uv: np.ndarray) -> np.ndarray:
        """BGR at places, float32[n 3]."""
        u, v = (np.clip(np.round(uv[..., i]).astype(int), 0, self.picture.shape[1 - i] - 1) for i in (0, 1))
        return self.picture[v, u] + 1.0


def sharp_points(ridges: RidgeProfiles, view: TopView) -> RidgeProfiles:
    """The points of ridges that may be paint: two sharp edges, white or yellow."""
    allowed_m = _SOFT_M + _SOFT_PX * view.pixel_m(ridges.uv, ridges.normal)
    colour = view.colours(ridges.uv)
    red = colour[:, 2] - colour[:, 1] > _RED * colour.sum(axis=1)
    keep = (ridges.contrast > MIN_CONTRAST) & (ridges.width_m > 0.05) & (ridges.rise_m < allowed_m)
    return ridges.at(keep & ~red & (_greenness(colour) < _GREEN))


def choose_paint(strokes: Sequence[Stroke], view: TopView) -> list[Stroke]:
    """The strokes that are paint.

    Strokes in the direction of the road need less contrast than others, and those that continue a stroke need least.

    Args:
        strokes: from `find_strokes`.
        view: the top view.
    """
    strokes = [stroke for stroke in strokes if stroke.length_m >= 0.5]
    direction = road_direction([stroke for stroke in strokes if _passes(stroke, view, ALONG)], view)
    chosen, rest = [], []
    for stroke in strokes:
        along = direction is not None and _turn(stroke, direction) < _tolerance_rad(stroke, view)
        crossing = not _is_radial(stroke, view) and _passes(stroke, view, ACROSS)
        accepted = (along and _passes(stroke, view, ALONG)) or crossing
        (chosen if accepted else rest).append(stroke)
    return chosen + [
        stroke for stroke in rest if _passes(stroke, view, CONTINUED) and any(_continues(stroke, of) for of in chosen)
    ]


def road_direction(strokes: Sequence[Stroke], view: TopView) -> float | None:
    """Direction [rad] in the top view that most strokes near the camera share; None where there are too few."""
    if not strokes:
        return None
    angle = np.array([_angle(stroke) for stroke in strokes])
    weight = np.array(
        [stroke.length_m * stroke.contrast / (1.0 + _distance(stroke, view) / 10.0) for stroke in strokes]
    )
    turn = np.abs((angle[:, None] - angle[None] + np.pi / 2) % np.pi - np.pi / 2)
    votes = (np.exp(-0.5 * (turn / 0.03) ** 2) * weight[None]).sum(axis=1)
    best = int(votes.argmax())
    return float(angle[best]) if (turn[best] < 0.05) @ np.array([stroke.length_m for stroke in strokes]) > 3.0 else None


def _passes(stroke: Stroke, view: TopView, limits: StrokeLimits) -> bool:
    across_px_m, along_px_m = _pixel_m(stroke, view)
    shape = (
        stroke.length_m >= max(limits.min_length_m, limits.min_length_px * along_px_m)
        and stroke.scatter_m <= limits.max_scatter_m
        and stroke.width_scatter <= limits.max_width_scatter
        and stroke.contrast >= limits.min_contrast
        and stroke.width_m > max(0.06, _MIN_WIDTH_PX * across_px_m if across_px_m > along_px_m else 0.0)
        and stroke.rise_m < _SOFT_M + _SOFT_PX * across_px_m
    )
    return shape and _has_colours_of_paint(stroke, view, limits.grey_sides)


def _pixel_m(stroke: Stroke, view: TopView) -> tuple[float, float]:
    """Metres in one pixel of the image across and along the stroke."""
    place, normal = _middle(stroke), stroke.normal[len(stroke.normal) // 2]
    along = np.array([-normal[1], normal[0]])
    return tuple(float(view.pixel_m(place[None], part[None])[0]) for part in (normal, along))


def _has_colours_of_paint(stroke: Stroke, view: TopView, grey_sides: int) -> bool:
    """White or yellow in the middle, no grass on as many sides as asked."""
    uv, normal = stroke.uv[stroke.painted], stroke.normal[stroke.painted]
    if not len(uv):
        return False
    half = 0.5 * stroke.width_m + _FLANK_M
    middle, left, right = (
        view.colours(uv + normal * (side * half / view.metres_per_px)).mean(axis=0) for side in (0.0, -1.0, 1.0)
    )
    green = _greenness(np.stack([middle, left, right]))
    if green[0] > _GREEN or middle[2] - middle[1] > _RED * middle.sum():
        return False
    return int((green[1:] < 2 * _GREEN).sum()) >= grey_sides


def _greenness(bgr: np.ndarray) -> np.ndarray:
    return np.minimum(bgr[..., 1] - bgr[..., 0], bgr[..., 1] - bgr[..., 2]) / bgr.sum(axis=-1)


def _is_radial(stroke: Stroke, view: TopView) -> bool:
    """Whether a stroke runs along its ray."""
    return _turn(stroke, _bearing(stroke, view)) < _RADIAL_RAD


def _angle(stroke: Stroke) -> float:
    first, last = stroke.uv[0], stroke.uv[-1]
    return float(np.arctan2(*(last - first)[::-1]))


def _turn(stroke: Stroke, direction: float) -> float:
    return float(abs((_angle(stroke) - direction + np.pi / 2) % np.pi - np.pi / 2))


def _middle(stroke: Stroke) -> np.ndarray:
    return stroke.uv[stroke.painted].mean(axis=0) if stroke.painted.any() else stroke.uv.mean(axis=0)


def _distance(stroke: Stroke, view: TopView) -> float:
    return float(np.linalg.norm(_middle(stroke) - view.foot_uv)) * view.metres_per_px


def _bearing(stroke: Stroke, view: TopView) -> float:
    return float(np.arctan2(*(_middle(stroke) - view.foot_uv)[::-1]))


def _tolerance_rad(stroke: Stroke, view: TopView) -> float:
    """Roads bend: 3 deg near by, 0.25 deg more each metre beyond 10 m."""
    return float(np.deg2rad(3.0 + 0.25 * max(_distance(stroke, view) - 10.0, 0.0)))


def _continues(stroke: Stroke, of: Stroke) -> bool:
    """Whether a stroke lies on the straight prolongation of another, within 0.1 m and 2 deg of it and 12 m away."""
    step = np.linalg.norm(of.uv[1] - of.uv[0])  # 0.1 m
    offset = (_middle(stroke) - _middle(of)) / step * 0.1
    tangent = (of.uv[-1] - of.uv[0]) / np.linalg.norm(of.uv[-1] - of.uv[0])
    along, across = abs(offset @ tangent), abs(offset[0] * tangent[1] - offset[1] * tangent[0])
    return bool(along < 12.0 and across < 0.1 + 0.01 * along and _turn(stroke, _angle(of)) < np.deg2rad(2.0))
