"""The light of one look: sun with shadows, dusk, headlights and lamps at night, haze, wet ground that mirrors (room:
simulation; host).

In: places, normals, albedo. Out: radiance of every pixel, 1 is what a camera would show as white at its usual exposure.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from semloc_jax.cameras import Camera
from semloc_jax.simulation.looks.noise import noise

DAY, DUSK, NIGHT, INDOORS = "day", "dusk", "night", "indoors"
_TIMES = (DAY, DUSK, NIGHT)
CEILING_M = 2.9


class Light(NamedTuple):
    """What shines, and through what; all of it is drawn by a seed."""

    time: str
    sun: Float[np.ndarray, "3"]
    """Unit direction towards it."""
    sun_bgr: Float[np.ndarray, "3"]
    ambient_bgr: Float[np.ndarray, "3"]
    headlight: float
    retro: float
    """How much more signs, posts and paint throw back to the headlights."""
    haze_m: float
    wet: float
    """Share of the light that wet ground mirrors at a flat angle."""
    leafy: float
    """Strength of the shadows of leaves."""
    bands: tuple[tuple[float, float, float], ...]
    """Shadows across the ground: direction [rad], place and half width [m]."""
    offset: Float[np.ndarray, "2"]


def drawn_light(rng: np.random.Generator, time: str | None = None) -> Light:
    """A light; `time` is one of day, dusk, night, indoors, None draws one of the first three."""
    time = time or str(rng.choice(_TIMES, p=(0.6, 0.15, 0.25)))
    azimuth, rise = rng.uniform(0.0, 2.0 * np.pi), np.radians(rng.uniform(8.0, 75.0))
    sun = np.array([np.cos(rise) * np.cos(azimuth), np.cos(rise) * np.sin(azimuth), np.sin(rise)])
    warm = 1.0 + rng.uniform(-0.15, 0.15) * np.array([-1.0, 0.0, 1.0])
    strength = {DAY: rng.uniform(0.0, 1.2), DUSK: rng.uniform(0.0, 0.5), NIGHT: 0.0, INDOORS: 0.0}[time]
    ambient = {DAY: rng.uniform(0.25, 0.8), DUSK: rng.uniform(0.15, 0.4), NIGHT: rng.uniform(0.01, 0.1), INDOORS: 0.6}
    shadows = tuple(
        (rng.uniform(0.0, np.pi), rng.uniform(-40.0, 40.0), np.exp(rng.uniform(np.log(0.05), np.log(6.0))))
        for _ in range(int(rng.integers(0, 7)))
    )
    return Light(
        time=time,
        sun=sun,
        sun_bgr=strength * warm,
        ambient_bgr=ambient[time] * (2.0 - warm) * (1.0 + rng.normal(0.0, 0.03, 3)),
        headlight=rng.uniform(0.4, 2.5) * (time == NIGHT or (time == DUSK and rng.random() < 0.5)),
        retro=rng.uniform(0.5, 5.0),
        haze_m=float(np.exp(rng.uniform(np.log(60.0), np.log(2000.0)))),
        wet=rng.uniform(0.2, 1.0) * (rng.random() < (0.5 if time == NIGHT else 0.25)),
        leafy=rng.uniform(0.0, 1.0) * (rng.random() < 0.4),
        bands=shadows,
        offset=rng.uniform(0.0, 500.0, 2),
    )


def lit(light: Light, place: np.ndarray, normal: np.ndarray, is_retro: np.ndarray) -> Float[np.ndarray, "n 3"]:
    """Light that falls on surfaces.

    Args:
        light: the light.
        place: from the camera, axes of the map [m], [n 3].
        normal: unit normals [n 3].
        is_retro: whether a surface throws light back to where it comes from, [n].
    """
    out = np.tile(light.ambient_bgr.astype(np.float32), (len(place), 1))
    if light.time == INDOORS:
        return out * (1.0 + 0.5 * _lamps(light, place[:, 0], place[:, 1], 2.5))[:, None]
    if light.sun_bgr.max() > 0.0:
        share = np.maximum(normal @ light.sun, 0.0) * _shone_on(light, place)
        out += share[:, None] * light.sun_bgr
    if light.headlight > 0.0:
        out += _headlights(light, place, normal, is_retro)[:, None] * np.array([0.85, 0.97, 1.0])
        if light.time == NIGHT:
            pools = np.clip(
                noise("cloud", place[:, 0] / 0.4 + light.offset[0], place[:, 1] / 0.4 + light.offset[1]), 0, 3
            )
            out += 0.05 * pools[:, None] * np.array([0.6, 0.9, 1.0])
    return out


def _shone_on(light: Light, place: np.ndarray) -> np.ndarray:
    """Share of the sun that reaches places: shadows lie along its direction."""
    x, y = (place[:, k] - light.sun[k] / light.sun[2] * place[:, 2] for k in (0, 1))
    share = np.ones(len(place), np.float32)
    if light.leafy > 0.0:
        cover = noise("cloud", x / 0.12 + light.offset[0], y / 0.12 + light.offset[1])
        cover += 0.6 * noise("rough", x / 0.05 + light.offset[1], y / 0.05)
        share *= 1.0 - light.leafy * np.clip(0.5 + 1.5 * cover, 0.0, 1.0)
    for turn, at_m, half_m in light.bands:
        away = np.abs(x * np.cos(turn) + y * np.sin(turn) - at_m) - half_m
        share *= 1.0 - 0.85 * np.clip(0.5 - away / 0.06, 0.0, 1.0)
    return share


def _headlights(light: Light, place: np.ndarray, normal: np.ndarray, is_retro: np.ndarray) -> np.ndarray:
    """Of the own vehicle, whose camera looks where it drives: two beams that widen."""
    away = np.maximum(np.linalg.norm(place, axis=1), 1.0)
    facing = np.abs((place * normal).sum(axis=1)) / away
    beam = light.headlight * 60.0 / (away + 3.0) ** 2 * (0.15 + facing)
    return beam * np.where(is_retro, light.retro, 1.0)


def _lamps(light: Light, x: np.ndarray, y: np.ndarray, soft_m: float) -> np.ndarray:
    """Light of lamps in rows below a ceiling, at places of it."""
    turn = light.offset[0]
    u, v = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    across, along = np.abs((u + light.offset[1]) % 5.0 - 2.5), np.abs(v % 4.0 - 2.0)
    return np.clip(1.0 - np.maximum(across - 0.15, 0.0) / soft_m, 0.0, 1.0) * np.clip(
        1.0 - np.maximum(along - 0.7, 0.0) / soft_m, 0.0, 1.0
    )


def ceiling(light: Light, ray: Float[np.ndarray, "n 3"], lamp: float = 2.5) -> Float[np.ndarray, "n 3"]:
    """What is seen of a ceiling with lamps along rays that rise.

    Args:
        light: of a garage.
        ray: unit rays [n 3].
        lamp: radiance of a lamp over that of a white floor; by default just more than any camera shows.
    """
    t = CEILING_M / np.maximum(ray[:, 2], 1e-2)
    lamps = _lamps(light, ray[:, 0] * t, ray[:, 1] * t, 0.15)
    beams = 0.25 + 0.1 * (np.abs((ray[:, 0] * t) % 4.0 - 2.0) < 0.3)
    return (beams + lamp * lamps)[:, None] * light.ambient_bgr


def sky(light: Light, ray: Float[np.ndarray, "n 3"], rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Sky with clouds, and what stands far away before it: woods, hills, towns."""
    azimuth, rise = np.arctan2(ray[:, 1], ray[:, 0]), np.arcsin(np.clip(ray[:, 2], -1.0, 1.0))
    blue, cloud = np.array([1.0, 0.75, 0.55]), rng.uniform(0.0, 1.0)
    bright = {DAY: rng.uniform(0.6, 2.0), DUSK: rng.uniform(0.3, 1.0), NIGHT: rng.uniform(0.0, 0.08)}.get(
        light.time, 0.3
    )
    cover = np.clip(cloud + 0.5 * noise("cloud", azimuth * 80.0 + light.offset[0], rise * 200.0), 0.0, 1.0)[:, None]
    up = (1.0 - 0.5 * np.clip(rise, 0.0, 1.0))[:, None]
    out = bright * up * (cover * np.array([0.95, 0.95, 0.95]) + (1.0 - cover) * blue)
    if rng.random() < 0.75:
        far, tall = rng.uniform(0.02, 0.25, 3), np.radians(rng.choice([1.0, 3.0, 8.0, 25.0]) * rng.uniform(0.5, 1.5))
        top = tall * (1.0 + 0.4 * noise("cloud", azimuth * 60.0, np.full_like(azimuth, light.offset[0])))
        top += 0.2 * tall * noise("rough", azimuth * 300.0, rise * 300.0)
        texture = 1.0 + 0.5 * noise("rough", azimuth * 150.0, rise * 150.0)
        trunks = noise("grain", azimuth * rng.uniform(30.0, 120.0), np.zeros_like(azimuth)) * rng.uniform(0.0, 0.6)
        far = far * (light.ambient_bgr + 0.4 * light.sun_bgr)
        out = np.where((rise < top)[:, None], far * np.clip(texture + trunks, 0.05, 4.0)[:, None], out)
    return out


def mirrored(
    light: Light,
    radiance: Float[np.ndarray, "h w 3"],
    is_ground: np.ndarray,
    ray: np.ndarray,
    place: np.ndarray,
    camera: Camera,
    R_map_cam: np.ndarray,
) -> Float[np.ndarray, "h w 3"]:
    """The radiance with what wet or polished ground mirrors; only what the picture shows is mirrored.

    Args:
        light: the light.
        radiance: without mirrors.
        is_ground: bool[h w].
        ray: unit rays in the map frame [h w 3].
        place: hit points from the camera [h w 3].
        camera: the camera.
        R_map_cam: its axes.
    """
    rows, columns = np.nonzero(is_ground)
    if len(rows) == 0:
        return radiance
    own, spot = ray[rows, columns], place[rows, columns]
    height, width = is_ground.shape
    bent = (ray.reshape(-1, 3) * [1.0, 1.0, -1.0]) @ R_map_cam
    # Of the whole picture at once: JAX compiles anew for every other number of places.
    uv, valid = (np.asarray(a).reshape(height, width, -1) for a in camera.project(bent.astype(np.float32)))
    ripple = camera.height * 0.01 * noise("rough", spot[:, 0] / 0.08, spot[:, 1] / 0.08)
    at = np.where(valid[rows, columns], uv[rows, columns], -10.0) + np.column_stack([np.zeros(len(rows)), ripple])
    smeared = cv2.GaussianBlur(radiance, (0, 0), sigmaX=2.0, sigmaY=24.0).astype(np.float32)
    seen = _looked_up(smeared, at.astype(np.float32))
    puddles = np.clip(0.6 + 0.5 * noise("cloud", spot[:, 0] / 0.3 + light.offset[1], spot[:, 1] / 0.3), 0.0, 1.0)
    share = light.wet * puddles * (0.04 + 0.96 * (1.0 - np.abs(own[:, 2])) ** 5)
    out = radiance.copy()
    out[rows, columns] = (1.0 - share[:, None]) * out[rows, columns] + share[:, None] * seen
    return out


def _looked_up(picture: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The picture at places [n 2]; OpenCV takes no more than 32,767 of them in a row."""
    side = int(np.ceil(np.sqrt(len(at))))
    grid = np.resize(at, (side * side, 2)).reshape(side, side, 2)
    found = cv2.remap(picture, grid[..., 0], grid[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return found.reshape(-1, 3)[: len(at)]
