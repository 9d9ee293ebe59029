"""A picture on an upright cylinder, painted from far to near (room: simulation; host).

In: polygons in space with colours. Out: the picture, and which thing each pixel shows.
Places are metres from the point of the road under the camera: x to the right, y ahead, z up.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Float, UInt8

_NEAREST_M = 0.2
_BEHIND_RAD = 2.6
"""What reaches so far around is cut by the seam of the cylinder: it is not painted."""
_FIXED_BITS = 3
"""Of a pixel, in the numbers that OpenCV takes."""

Colour = Float[np.ndarray, " 3"]
"""Blue, green, red in 0 ... 1."""


@dataclass
class Canvas:
    """What is painted on.

    Attributes:
        focal_px: pixels a radian.
        centre_px: column of straight ahead and row of the horizon.
        height_m: of the camera over the road.
        light: float64[3], unit vector towards the light.
        ambient: share of the light that comes from everywhere.
        picture: float32[h w 3].
        ids: uint8[h w], number of the thing that each pixel shows; 0 for none that counts.
        is_mirrored: what is painted hangs below the road, as a polished floor shows it.
    """

    focal_px: float
    centre_px: tuple[float, float]
    height_m: float
    light: Float[np.ndarray, " 3"]
    ambient: float
    picture: Float[np.ndarray, "h w 3"]
    ids: UInt8[np.ndarray, "h w"] = field(init=False)
    is_mirrored: bool = False

    def __post_init__(self) -> None:
        self.ids = np.zeros(self.picture.shape[:2], np.uint8)

    def pixels(self, places: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Where places are shown."""
        x, y, z = places.T
        range_m = np.maximum(np.hypot(x, y), _NEAREST_M)
        below_m = self.height_m - (-z if self.is_mirrored else z)
        u = self.centre_px[0] + self.focal_px * np.arctan2(x, y)
        return np.column_stack([u, self.centre_px[1] + self.focal_px * below_m / range_m])

    def shade(self, normal: Float[np.ndarray, " 3"]) -> float:
        """How bright a side is."""
        return self.ambient + (1.0 - self.ambient) * max(float(normal @ self.light), 0.0)

    def area(self, places: Float[np.ndarray, "n 3"], colour: Colour, thing: int = 0, num: int = 1) -> None:
        """Paint a polygon.

        Args:
            places: its corners in turn.
            colour: of all of it.
            thing: what it belongs to.
            num: pieces of each side: straight lines are bent here.
        """
        if num > 1:
            share = (np.arange(num) / num)[None, :, None]
            places = (places[:, None] + share * (np.roll(places, -1, axis=0) - places)[:, None]).reshape(-1, 3)
        if self._is_ahead(places):
            self.fill(self.pixels(places), colour, thing)

    def hull(self, places: Float[np.ndarray, "n 3"], colour: Colour, thing: int = 0) -> None:
        """Paint the outline of a convex body by some places of its surface."""
        if self._is_ahead(places):
            self.fill(cv2.convexHull(self.pixels(places).astype(np.float32))[:, 0], colour, thing)

    def fill(self, uv: Float[np.ndarray, "n 2"], colour: Colour, thing: int = 0) -> None:
        """Paint a polygon of pixels."""
        fixed = [np.round(np.clip(uv, -4e3, 4e3) * 2**_FIXED_BITS).astype(np.int32)]
        cv2.fillPoly(self.picture, fixed, tuple(float(c) for c in colour), cv2.LINE_8, _FIXED_BITS)
        cv2.fillPoly(self.ids, fixed, thing, cv2.LINE_8, _FIXED_BITS)

    def bar(self, ends: Float[np.ndarray, "2 3"], wide_m: float, colour: Colour, thing: int = 0) -> None:
        """Paint a round bar between two places."""
        if not self._is_ahead(ends):
            return
        (a, b), range_m = self.pixels(ends), np.maximum(np.linalg.norm(ends[:, :2], axis=1), _NEAREST_M)
        aside = np.array([a[1] - b[1], b[0] - a[0]]) / max(float(np.hypot(*(b - a))), 1e-6)
        half = 0.5 * wide_m * self.focal_px / range_m
        self.fill(
            np.array([a + half[0] * aside, b + half[1] * aside, b - half[1] * aside, a - half[0] * aside]),
            colour,
            thing,
        )

    def faces_us(self, places: Float[np.ndarray, "n 3"]) -> bool:
        """Whether a polygon is seen from the side from which its corners run against the clock."""
        uv = self.pixels(places)
        after = np.roll(uv, -1, axis=0)
        area = float((uv[:, 0] * after[:, 1] - uv[:, 1] * after[:, 0]).sum())
        return area > 0.0 if self.is_mirrored else area < 0.0

    def _is_ahead(self, places: np.ndarray) -> bool:
        phi = np.arctan2(places[:, 0], places[:, 1])
        return bool(np.abs(phi).max() < _BEHIND_RAD and np.hypot(places[:, 0], places[:, 1]).max() > _NEAREST_M)
