"""Colours of a top view of the road, and how fine the image is there (room: perception; host).

In: the top view of one image. Out: TopView; what is white or yellow, what is grass.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from semloc_jax.perception.ground_view import GroundView

_GREEN = 0.012
"""Share by which green exceeds both red and blue in grass; white paint, yellow paint and road have none."""
_RED = 0.1
_YELLOW_BLUE = 0.6
"""Largest share of blue in what yellow paint has more of than the road, of the smaller of green and red."""
_YELLOW_RED = 0.9
"""Least share of red there, of green: grass in the sun is yellow, too, but has no more red than green."""
_GREY = 0.05
"""Largest share by which blue is less than both green and red on a grey road."""
_BESIDE_M = 0.3
"""Where the road beside a stroke is looked at."""


@dataclass(frozen=True)
class TopView:
    """A top view with its colours, and how fine the image is there."""

    picture: np.ndarray
    """BGR, uint8[h w 3], smoothed."""
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
        return cls(cv2.GaussianBlur(top, (0, 0), 1.5), foot, view)

    @property
    def metres_per_px(self) -> float:
        """Size of a pixel of the top view."""
        return 1.0 / float(self.view.bev.fx)

    def pixel_m(self, uv: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Metres of road in one pixel of the image at places of the top view, along directions; float[n]."""
        ends = []
        for sign in (-1.0, 1.0):
            ends.append(self.view.image_uv.reshape(-1, 2).take(self._pixels(uv + 2.0 * sign * direction), axis=0))
        image_px = np.hypot(*(ends[1] - ends[0]).T)
        # Over the rim of what is seen the difference says nothing: such points count as fine.
        return np.where(image_px > 1e3, 0.0, 4.0 * self.metres_per_px / np.maximum(image_px, 1e-3))

    def colours(self, uv: np.ndarray) -> np.ndarray:
        """BGR at places, float32[3 n]."""
        return self.picture.reshape(-1, 3).take(self._pixels(uv), axis=0).T.astype(np.float32) + np.float32(1.0)

    def _pixels(self, uv: np.ndarray) -> np.ndarray:
        """Numbers of the pixels next to places, int[n]."""
        height, width = self.picture.shape[:2]
        u, v = (np.rint(uv[:, i]).astype(np.intp).clip(0, size - 1) for i, size in enumerate((width, height)))
        return v * width + u


def whiteness(image: np.ndarray) -> np.ndarray:
    """Least of the three colours, float32[h w]: white has all of them, grass in the sun lacks blue.

    Args:
        image: BGR, uint8[h w 3].
    """
    blue, green, red = cv2.split(image)
    return cv2.min(blue, cv2.min(green, red)).astype(np.float32)


def are_white(view: TopView, uv: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Whether places may be white paint, or yellow as pale as white, bool[n].

    Concrete between two strokes of yellow has more blue than they, but less green and red. Beside an edge line, grass
    in the sun may have more, but not on both sides.

    Args:
        view: the top view.
        uv: places, float[n 2].
        normal: unit vectors across, float[n 2].
    """
    own = view.colours(uv)
    darker = np.minimum(*(side[1] + side[2] for side in _beside(view, uv, normal)))
    return is_white_or_yellow(own) & (own[1] + own[2] > darker)


def are_on_grey(view: TopView, uv: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Whether places may be paint on a grey road, or are yellower than the darker of both sides, bool[n].

    Arguments as `are_white`. On grey, green and red show paint of either colour with the least noise.
    """
    own, (left, right) = view.colours(uv), _beside(view, uv, normal)
    on_grey = (_yellowness(left) < _GREY) & (_yellowness(right) < _GREY)
    blue, green, red = own - np.where(left.sum(axis=0) < right.sum(axis=0), left, right)
    is_yellower = (blue < _YELLOW_BLUE * np.minimum(green, red)) & (red > _YELLOW_RED * green)
    return (on_grey | is_yellower) & is_white_or_yellow(own)


def _beside(view: TopView, uv: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colours to both sides of places, float32[3 n] each."""
    step = (_BESIDE_M / view.metres_per_px) * normal
    return view.colours(uv - step), view.colours(uv + step)


def is_white_or_yellow(bgr: np.ndarray) -> np.ndarray:
    """Whether colours may be those of paint, bool[n] of float[3 n]."""
    red = bgr[2] - bgr[1] > _RED * bgr.sum(axis=0)
    return ~red & (_greenness(bgr) < _GREEN)


def is_no_grass(bgr: np.ndarray) -> np.ndarray:
    """Whether colours may be those of the ground beside paint, bool[n] of float[3 n]."""
    return _greenness(bgr) < 2 * _GREEN


def _yellowness(bgr: np.ndarray) -> np.ndarray:
    return (np.minimum(bgr[1], bgr[2]) - bgr[0]) / bgr.sum(axis=0)


def _greenness(bgr: np.ndarray) -> np.ndarray:
    return np.minimum(bgr[1] - bgr[0], bgr[1] - bgr[2]) / bgr.sum(axis=0)
