"""What a smooth floor mirrors: lamps, pillars, cars, walls (room: simulation; host).

In: rays that meet the floor, the solids that stand on it. Out: the radiance that comes back along each.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float

from semloc_jax.simulation.looks import light as lights
from semloc_jax.simulation.solids import Solid

_COARSE = 4
"""Pixels along a side of one that is mirrored: a floor is no glass, and what it mirrors is soft."""
_NEAR_M = 60.0
_LAMP = (2.5, 60.0)
"""Radiance of a lamp over that of a white floor. A tube has some hundred times as much as the floor that it lights; a
camera shows both as white, but the floor throws back a share of it: streaks as bright as paint where one looks down."""


def polished(
    picture: Float[np.ndarray, "h w 3"],
    is_ground: Bool[np.ndarray, "h w"],
    ray: Float[np.ndarray, "h w 3"],
    away: Float[np.ndarray, "h w 3"],
    origin: Float[np.ndarray, "3"],
    solids: Sequence[Solid],
    light: lights.Light,
    rng: np.random.Generator,
) -> Float[np.ndarray, "h w 3"]:
    """The picture with what its floor mirrors.

    Args:
        picture: radiance without.
        is_ground: where the floor is.
        ray: unit rays in the map frame.
        away: from the camera to what is hit [m].
        origin: the camera in the map frame.
        solids: what stands there.
        light: of a garage.
        rng: how smooth the floor is.
    """
    shine = rng.uniform(0.0, 0.7) * (rng.random() < 0.75)
    soft_px = float(np.exp(rng.uniform(np.log(1.0), np.log(20.0))))
    lamp = float(np.exp(rng.uniform(*np.log(_LAMP))))
    part = np.s_[_COARSE // 2 :: _COARSE, _COARSE // 2 :: _COARSE]
    rows, columns = np.nonzero(is_ground[part])
    if shine == 0.0 or len(rows) == 0:
        return picture
    small = np.zeros((*is_ground[part].shape, 3), np.float32)
    up = ray[part][rows, columns] * [1.0, 1.0, -1.0]
    spot = away[part][rows, columns]
    small[rows, columns] = _mirrored(up, spot, origin, solids, light, lamp)
    # A floor is no glass: what it mirrors is drawn out towards whoever looks. Beyond its border it mirrors the same.
    weight = np.zeros(small.shape[:2], np.float32)
    weight[rows, columns] = 1.0
    soft = max(soft_px / _COARSE, 0.5)
    blurred, total = (cv2.GaussianBlur(a, (0, 0), sigmaX=soft, sigmaY=3.0 * soft) for a in (small, weight))
    blurred = blurred / np.maximum(total, 1e-3)[..., None]
    whole = cv2.resize(blurred, picture.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    fresnel = shine * (0.08 + 0.92 * (1.0 - np.abs(ray[is_ground][:, 2:])) ** 4).astype(np.float32)
    out = picture.copy()
    out[is_ground] = (1.0 - 0.5 * fresnel) * out[is_ground] + fresnel * whole[is_ground]
    return out


def _mirrored(
    up: np.ndarray,
    spot: np.ndarray,
    origin: np.ndarray,
    solids: Sequence[Solid],
    light: lights.Light,
    lamp: float,
) -> Float[np.ndarray, "n 3"]:
    """Radiance along mirrored rays `up` from floor points `spot` (from the camera).

    Seen from the camera mirrored below the floor, all of these rays start in one place.
    """
    seen = lights.ceiling(light, _towards_ceiling(up, spot), lamp).astype(np.float32)
    below = origin + [0.0, 0.0, 2.0 * float(np.median(spot[:, 2]))]
    least = np.linalg.norm(spot, axis=1) - 0.02
    nearest = np.full(len(up), np.inf)
    for solid in solids:
        own = _toward(solid, below, up)
        t = solid.hit(below, up[own])
        hit = (t > least[own]) & (t < nearest[own])
        nearest[own[hit]] = t[hit]
        seen[own[hit]] = np.asarray(solid.color, np.float32) * light.ambient_bgr.astype(np.float32)
    return seen


def _toward(solid: Solid, origin: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """Which rays come near to a solid."""
    center, radius = solid.bounds
    way = center - origin
    distance = float(np.linalg.norm(way))
    if distance > _NEAR_M + radius:
        return np.zeros(0, int)
    if distance <= radius:
        return np.arange(len(ray))
    return np.flatnonzero(ray @ way >= np.sqrt(distance**2 - radius**2))


def _towards_ceiling(up: np.ndarray, away: np.ndarray) -> np.ndarray:
    """Rays from the camera to where mirrored rays meet the ceiling, which hangs a fixed height above it."""
    height = lights.CEILING_M
    t = (height - away[:, 2]) / np.maximum(up[:, 2], 1e-2)
    at = away[:, :2] + t[:, None] * up[:, :2]
    return np.column_stack([at, np.full(len(at), height)]) / height
