"""Simple shaded colour images of a rendered view (room: simulation; host).

In: RenderedView, lighting. Out: uint8 image: no photograph, but enough contrast and texture for classical segmenters.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.simulation.render import RenderedView

_ALBEDO = {
    "road": (0.24, 0.24, 0.24),
    "sidewalk": (0.46, 0.48, 0.5),
    "terrain": (0.18, 0.36, 0.28),
    "sky": (0.95, 0.85, 0.75),
    "wall": (0.5, 0.52, 0.52),
    "lane_solid": (0.82, 0.84, 0.84),
    "lane_dashed": (0.82, 0.84, 0.84),
    "stop_line": (0.82, 0.84, 0.84),
    "crosswalk": (0.82, 0.84, 0.84),
    "arrow": (0.82, 0.84, 0.84),
    "slot_line": (0.8, 0.8, 0.8),
    "speed_bump": (0.1, 0.6, 0.7),
}


@dataclass(frozen=True)
class Lighting:
    """Light of one weather.

    Args:
        name: variant in frames.csv.
        sun_map: unit direction towards the light.
        sun: strength of the direct light.
        ambient: strength of the light from everywhere.
        haze_m: distance at which haze takes over.
        noise: standard deviation of the sensor noise, of full scale.
    """

    name: str
    sun_map: tuple[float, float, float]
    sun: float
    ambient: float
    haze_m: float
    noise: float


LIGHTINGS = {
    "noon": Lighting("noon", (0.3, 0.2, 0.93), 0.75, 0.4, 600.0, 0.01),
    "lowsun": Lighting("lowsun", (0.85, 0.4, 0.35), 0.6, 0.3, 400.0, 0.015),
    "night": Lighting("night", (0.1, 0.1, 0.98), 0.12, 0.12, 80.0, 0.025),
    "garage": Lighting("garage", (0.0, 0.2, 0.98), 0.45, 0.6, 120.0, 0.02),
}


def shade(
    view: RenderedView, origin_map: Float[np.ndarray, "3"], lighting: Lighting, rng: np.random.Generator
) -> UInt8[np.ndarray, "h w 3"]:
    """Blue-green-red image of a view from `origin_map`."""
    table = np.full((256, 3), 0.3)
    for name, albedo in _ALBEDO.items():
        table[CLASS_IDS[name]] = albedo
    albedo = np.where(np.isnan(view.color), table[view.class_id], view.color)
    is_hit = np.isfinite(view.range_m)
    place = origin_map + np.where(is_hit, view.range_m, 0.0)[..., None] * view.ray_map
    grain = _grain(place) * np.where(np.isnan(view.color[..., 0]) & is_hit, 1.0, 0.3)
    light = lighting.ambient + lighting.sun * np.maximum(view.normal_map @ np.asarray(lighting.sun_map), 0.0)
    image = np.where(is_hit[..., None], albedo * (light * (1.0 + grain))[..., None], _backdrop(view, lighting, table))
    clear = np.where(is_hit, np.exp(-np.where(is_hit, view.range_m, 0.0) / lighting.haze_m), 1.0)[..., None]
    image = clear * image + (1.0 - clear) * 0.6 * (lighting.sun + lighting.ambient) * np.array([0.95, 0.9, 0.88])
    image[~view.in_view] = 0.0
    image = cv2.GaussianBlur(image, (0, 0), 0.6)
    image += rng.normal(scale=lighting.noise, size=image.shape)
    return np.round(255.0 * np.clip(image, 0.0, 1.0) ** 0.8).astype(np.uint8)


def _backdrop(view: RenderedView, lighting: Lighting, table: np.ndarray) -> np.ndarray:
    """Sky or ceiling: brighter towards the horizon."""
    rise = np.clip(view.ray_map[..., 2:3], 0.0, 1.0)
    return table[view.class_id] * (lighting.sun + lighting.ambient) * (1.0 - 0.35 * rise)


def _grain(place: np.ndarray) -> np.ndarray:
    """Texture fixed to the ground: hashed noise in cells of 2 cm and 30 cm, zero mean."""
    grain = np.zeros(place.shape[:2])
    for cell_m, strength in ((0.02, 0.08), (0.3, 0.05)):
        x, y = np.floor(place[..., 0] / cell_m), np.floor(place[..., 1] / cell_m)
        hashed = np.sin(x * 12.9898 + y * 78.233) * 43758.5453
        grain += strength * (2.0 * (hashed - np.floor(hashed)) - 1.0)
    return grain
