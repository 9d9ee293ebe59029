"""The colour of surfaces: asphalt, paint, grass, fronts with windows, leaves, cars, striped posts (room: simulation;
host).

In: what a view shows, places in the map frame. Out: albedo and own light of every pixel.
The class id of a pixel may carry a variant in its upper three bits: yellow paint, a patch in the road, a banded post.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.simulation.looks.noise import noise

CLASS_BITS = 5
CLASS_MASK = 2**CLASS_BITS - 1
WHITE, YELLOW, ORANGE, BLUE, RED = range(5)
"""Variants of paint."""
PLAIN, DARK_PATCH, LIGHT_PATCH, TAR, GHOST, HOLE, GRAVEL = range(7)
"""Variants of the road: none of them is paint."""
BANDED, STRIPED = 1, 2
"""Variants of posts and pillars: a black band below the top; warning stripes below."""
GLOWING = 7
"""Variant of whatever shines itself."""
PAINT = tuple(CLASS_IDS[n] for n in ("lane_solid", "lane_dashed", "stop_line", "crosswalk", "arrow", "slot_line"))
_PAINT_BGR = ((1.0, 1.0, 1.0), (0.18, 0.72, 1.0), (0.15, 0.45, 1.0), (0.9, 0.45, 0.15), (0.25, 0.2, 0.85))


def variant_id(name: str, variant: int) -> int:
    """The id of a class with a variant."""
    return CLASS_IDS[name] | variant << CLASS_BITS


class Pixels(NamedTuple):
    """Some pixels of one class and variant; n of them."""

    place_m: Float[np.ndarray, "n 3"]
    """In the map frame."""
    normal: Float[np.ndarray, "n 3"]
    above_m: Float[np.ndarray, " n"]
    """Height above the ground."""
    color: Float[np.ndarray, "n 3"]
    """Of solids, blue green red; NaN on the ground."""
    variant: int


class Materials:
    """The materials of one look; everything random is drawn once."""

    def __init__(self, rng: np.random.Generator, is_smooth: bool = False) -> None:
        """Draw them; `is_smooth` for a floor of concrete or paint in place of asphalt."""
        self._rng = rng
        self.road = np.exp(rng.uniform(np.log(0.05), np.log(0.42))) * (1.0 + rng.normal(0.0, 0.04, 3))
        self.contrast = rng.uniform(0.25, 0.9)
        """How much brighter than the road paint is, of what white paint could be."""
        self.wear = rng.uniform(0.0, 0.55) * (rng.random() < 0.6)
        self.grass = _drawn(rng, ((0.05, 0.2, 0.12), (0.15, 0.4, 0.3), (0.25, 0.42, 0.5), (0.06, 0.12, 0.12)))
        self.leaves = _drawn(rng, ((0.03, 0.14, 0.06), (0.1, 0.35, 0.2), (0.08, 0.25, 0.35)))
        self.stone = rng.uniform(0.15, 0.7) * (1.0 + rng.normal(0.0, 0.06, 3))
        self.grain = rng.uniform(0.02, 0.22)
        self.blotches = rng.uniform(0.02, 0.2)
        self.window_m = rng.uniform(1.2, 4.0), rng.uniform(2.2, 4.0)
        self.offset = rng.uniform(0.0, 500.0, 2)
        if is_smooth and rng.random() < 0.85:
            self.road = np.exp(rng.uniform(np.log(0.12), np.log(0.6))) * (1.0 + rng.normal(0.0, 0.04, 3))
            if rng.random() < 0.2:  # painted
                self.road = self.road * rng.uniform(0.4, 1.2, 3)
            self.grain *= rng.uniform(0.0, 0.3)

    def albedo(self, class_id: int, pixels: Pixels) -> Float[np.ndarray, "n 3"]:
        """What share of the light the pixels of a class throw back."""
        if class_id in PAINT or class_id == CLASS_IDS["speed_bump"]:
            return self._paint(class_id, pixels)
        if class_id == CLASS_IDS["road"]:
            return self._road(pixels)
        if class_id == CLASS_IDS["terrain"]:
            return self._speckled(pixels, self.grass, 0.35, 0.1)
        if class_id == CLASS_IDS["vegetation"]:
            return self._leaves(pixels)
        if class_id in (CLASS_IDS["sidewalk"], CLASS_IDS["curb"]):
            return self._slabs(pixels, 0.9 if class_id == CLASS_IDS["sidewalk"] else 1.3)
        if class_id in (CLASS_IDS["building"], CLASS_IDS["wall"]):
            return self._front(pixels)
        if class_id in (CLASS_IDS["pole"], CLASS_IDS["pillar"]) and pixels.variant:
            return self._banded(pixels)
        plain = np.where(np.isnan(pixels.color), self.stone, pixels.color)
        return plain * (1.0 + 0.06 * self._noise("rough", pixels, 0.05))[:, None]

    def _noise(self, kind: str, pixels: Pixels, cell_m: float) -> np.ndarray:
        x, y, z = pixels.place_m.T
        return noise(kind, (x + 0.37 * z) / cell_m + self.offset[0], (y - 0.53 * z) / cell_m + self.offset[1])

    def _speckled(self, pixels: Pixels, tone: np.ndarray, coarse: float, fine: float) -> np.ndarray:
        light = 1.0 + coarse * self._noise("rough", pixels, 0.15) + fine * self._noise("grain", pixels, 0.03)
        return tone * np.maximum(light, 0.05)[:, None]

    def _road(self, pixels: Pixels) -> np.ndarray:
        light = (
            1.0
            + self.grain * self._noise("grain", pixels, 0.015)
            + 0.5 * self.grain * self._noise("rough", pixels, 0.06)
        )
        light += self.blotches * self._noise("cloud", pixels, 0.15)
        change = {
            DARK_PATCH: 0.7,
            LIGHT_PATCH: 1.3,
            TAR: 0.35,
            GHOST: 1.0 + 0.35 * self.contrast,
            HOLE: 0.5,
            GRAVEL: 1.5,
        }
        return self.road * (change.get(pixels.variant, 1.0) * np.maximum(light, 0.1))[:, None]

    def _paint(self, class_id: int, pixels: Pixels) -> np.ndarray:
        road = self._road(pixels._replace(variant=PLAIN))
        white = self.road.mean() + self.contrast * (0.9 - self.road.mean())
        tone = white * np.asarray(_PAINT_BGR[pixels.variant if pixels.variant < len(_PAINT_BGR) else WHITE])
        if class_id == CLASS_IDS["speed_bump"]:
            stripe = np.floor((pixels.place_m[:, 0] + pixels.place_m[:, 1]) / 0.5) % 2
            tone = np.where(stripe[:, None] > 0, white * np.asarray(_PAINT_BGR[YELLOW]), 0.05)
        gone = np.clip(0.5 + 0.6 * self._noise("rough", pixels, 0.04), 0.0, 1.0) * self.wear
        gone = np.clip(gone + 0.08 * self._noise("cloud", pixels, 0.2), 0.0, 0.75)[:, None]
        return gone * road + (1.0 - gone) * tone

    def _leaves(self, pixels: Pixels) -> np.ndarray:
        if pixels.variant or np.nanmax(pixels.color[:, 1], initial=0.0) < 0.3:  # a trunk
            return pixels.color * (1.0 + 0.25 * self._noise("rough", pixels, 0.04))[:, None]
        light = 1.0 + 0.6 * self._noise("rough", pixels, 0.12) + 0.3 * self._noise("grain", pixels, 0.05)
        return self.leaves * np.clip(light, 0.05, 3.0)[:, None]

    def _slabs(self, pixels: Pixels, share: float) -> np.ndarray:
        x, y, _ = pixels.place_m.T
        joint = (np.minimum(x % 0.6, y % 0.4) < 0.02).astype(np.float32)
        light = 1.0 + 0.1 * self._noise("rough", pixels, 0.05) - 0.25 * joint
        return np.clip(share * self.stone, 0.03, 0.95) * light[:, None]

    def _front(self, pixels: Pixels) -> np.ndarray:
        """Walls with rows of windows; what lies flat has none."""
        along = pixels.place_m[:, 1] * pixels.normal[:, 0] - pixels.place_m[:, 0] * pixels.normal[:, 1]
        wall = np.where(np.isnan(pixels.color), self.stone, pixels.color)
        wall = wall * (1.0 + 0.12 * self._noise("rough", pixels, 0.1))[:, None]
        u, v = along / self.window_m[0], pixels.above_m / self.window_m[1]
        is_glass = (u % 1.0 > 0.35) & (v % 1.0 > 0.4) & (np.abs(pixels.normal[:, 2]) < 0.5) & (pixels.variant == 0)
        shine = noise("grain", np.floor(u) * 7.1, np.floor(v) * 13.3)
        glass = np.array([0.16, 0.14, 0.12]) * np.exp(0.7 * shine)[:, None]
        return np.where(is_glass[:, None], np.clip(glass, 0.0, 0.8), wall)

    def _banded(self, pixels: Pixels) -> np.ndarray:
        """Delineators with a slanted black band, and what warns by stripes."""
        x, y, _ = pixels.place_m.T
        if pixels.variant == BANDED:
            is_dark = (pixels.above_m > 0.68) & (pixels.above_m < 0.86)
            return np.where(is_dark[:, None], 0.04, pixels.color)
        if pixels.variant == STRIPED:
            stripe = np.floor((pixels.above_m + 0.7 * (x + y)) / 0.22) % 2
            dressed = np.where(stripe[:, None] > 0, np.array([0.08, 0.6, 0.85]), 0.05)
            return np.where((pixels.above_m < 1.2)[:, None], dressed, pixels.color)
        return pixels.color


def _drawn(rng: np.random.Generator, tones: tuple[tuple[float, float, float], ...]) -> np.ndarray:
    """Somewhere between two of the tones, brighter or darker."""
    one, other = (np.array(tones[int(rng.integers(len(tones)))]) for _ in range(2))
    return (one + rng.random() * (other - one)) * np.exp(rng.normal(0.0, 0.3)) * (1.0 + rng.normal(0.0, 0.08, 3))


def plain_ids(ids: UInt8[np.ndarray, "*s"]) -> UInt8[np.ndarray, "*s"]:
    """Class ids without their variants."""
    return ids & np.uint8(CLASS_MASK)
