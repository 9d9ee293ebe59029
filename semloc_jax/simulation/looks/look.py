"""One look of a view: materials, light, weather, lens (room: simulation; host).

In: a rendered view. Out: the picture of it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from semloc_jax.cameras import Camera
from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.simulation.looks import light as lights
from semloc_jax.simulation.looks.floor import polished
from semloc_jax.simulation.looks.lens import photographed
from semloc_jax.simulation.looks.materials import CLASS_BITS, CLASS_MASK, GLOWING, PAINT, Materials, Pixels, plain_ids
from semloc_jax.simulation.render import RenderedView
from semloc_jax.simulation.solids import Solid
from semloc_jax.simulation.surface import Surface


class AnyLook(NamedTuple):
    """In place of a lighting: every picture has a look of its own, by its random numbers."""

    name: str = "wild"


_GROUND = ("road", "sidewalk", "terrain", "curb", "speed_bump")
_RETRO = ("sign", "pole", "vehicle")


def random_picture(
    view: RenderedView,
    T_map_cam: Float[np.ndarray, "4 4"],
    camera: Camera,
    surface: Surface,
    rng: np.random.Generator,
    finer: int = 1,
    indoors: Sequence[Solid] | None = None,
) -> UInt8[np.ndarray, "h w 3"]:
    """The view as some camera may show it.

    Args:
        view: what is seen; its class ids may carry variants.
        T_map_cam: from where.
        camera: with which camera.
        surface: the ground, which tells how high a place is above it.
        rng: all that is random.
        finer: pixels of the view along a side of one of the picture.
        indoors: what stands on a floor that mirrors it, below a ceiling with lamps; None for the open.
    """
    is_indoors = indoors is not None
    materials, light = Materials(rng, is_indoors), lights.drawn_light(rng, lights.INDOORS if is_indoors else None)
    radiance = _radiance(view, T_map_cam, camera, surface, materials, light, indoors or (), rng)
    if finer > 1:
        size = radiance.shape[1] // finer, radiance.shape[0] // finer
        radiance = cv2.resize(radiance, size, interpolation=cv2.INTER_AREA)
    is_dark = light.time == lights.NIGHT
    is_rainy = light.wet > 0.0 and not is_indoors and rng.random() < 0.6
    return photographed(radiance, rng, is_dark, is_rainy)


def _radiance(
    view: RenderedView,
    T_map_cam: np.ndarray,
    camera: Camera,
    surface: Surface,
    materials: Materials,
    light: lights.Light,
    solids: Sequence[Solid],
    rng: np.random.Generator,
) -> Float[np.ndarray, "h w 3"]:
    """Radiance of every pixel, 0 beyond the field of view."""
    shape, origin = view.class_id.shape, T_map_cam[:3, 3]
    ray = view.ray_map.reshape(-1, 3).astype(np.float32)
    range_m, ids = view.range_m.ravel(), view.class_id.ravel()
    out = np.zeros((len(ray), 3), np.float32)
    hit = np.isfinite(range_m)
    free = np.flatnonzero(~hit & view.in_view.ravel())
    out[free] = lights.ceiling(light, ray[free]) if light.time == lights.INDOORS else lights.sky(light, ray[free], rng)
    away = np.where(hit, range_m, 0.0).astype(np.float32)[:, None] * ray
    normal, color = view.normal_map.reshape(-1, 3).astype(np.float32), view.color.reshape(-1, 3).astype(np.float32)
    order = np.flatnonzero(hit)
    order = order[np.argsort(ids[order], kind="stable")]
    kinds, starts = np.unique(ids[order], return_index=True)
    ends = np.append(starts, len(order))[1:]
    for kind, own in zip(kinds.tolist(), map(order.__getitem__, map(slice, starts, ends)), strict=True):
        class_id, variant = kind & CLASS_MASK, kind >> CLASS_BITS
        place = away[own] + origin
        is_ground = np.isnan(color[own[0], 0])
        above = np.zeros(len(own)) if is_ground else place[:, 2] - surface.height(place[:, 0], place[:, 1])
        place = (place - np.round(origin, -1)).astype(np.float32)  # small numbers keep their decimals
        albedo = materials.albedo(class_id, Pixels(place, normal[own], above, color[own], variant))
        if variant == GLOWING:
            out[own] = albedo * 3.0
            continue
        is_retro = class_id in PAINT or class_id in tuple(CLASS_IDS[name] for name in _RETRO)
        shone = lights.lit(light, away[own], normal[own], np.full(len(own), is_retro))
        out[own] = np.clip(albedo, 0.0, 1.0) * shone
    clear = np.exp(-np.where(hit, range_m, 0.0) / light.haze_m)[:, None].astype(np.float32)
    out = clear * out + (1.0 - clear) * (light.ambient_bgr + 0.3 * light.sun_bgr).astype(np.float32)
    picture = out.reshape(*shape, 3).astype(np.float32)
    is_ground = hit & np.isnan(color[:, 0]) & np.isin(plain_ids(ids), [CLASS_IDS[n] for n in (*_GROUND,)] + list(PAINT))
    if light.time == lights.INDOORS:
        spots = is_ground.reshape(shape), view.ray_map, away.reshape(*shape, 3)
        return polished(picture, *spots, origin, solids, light, rng)
    if light.wet > 0.0:
        is_wet = (is_ground & (plain_ids(ids) != CLASS_IDS["terrain"])).reshape(shape)
        picture[is_wet] *= 1.0 - 0.5 * light.wet
        place = away.reshape(*shape, 3)
        picture = lights.mirrored(light, picture, is_wet, view.ray_map, place, camera, T_map_cam[:3, :3])
    return picture
