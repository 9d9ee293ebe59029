"""Views of random streets and garages: a random camera at a random place, several looks (room: simulation; host).

In: a seed. Out: StreetView: pictures as a network of our make sees them, class ids on a finer grid.
"""

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import UInt8

from semloc_jax.cameras import BrownConradyCamera, Camera, KannalaBrandtCamera, mounted
from semloc_jax.simulation.looks.look import random_picture
from semloc_jax.simulation.looks.materials import plain_ids
from semloc_jax.simulation.pictures import carried
from semloc_jax.simulation.render import PixelRays, RenderedView, render
from semloc_jax.simulation.scene import Scene
from semloc_jax.simulation.streets import hall, street

FINER = 2
"""Pixels of the class ids along a side of one of the picture."""
_ASIDE = 0.3
"""Share of the cameras in a street that look anywhere, as those around a vehicle do; the others look ahead."""


class StreetView(NamedTuple):
    """What one camera sees at one place."""

    pictures: tuple[UInt8[np.ndarray, "h w 3"], ...]
    """Blue green red, one for each look."""
    class_id: UInt8[np.ndarray, "_h _w"]
    """`FINER` times as fine."""


def street_views(
    rng: np.random.Generator, num: int, size_px: tuple[int, int], num_looks: int, is_garage: bool = False
) -> list[StreetView]:
    """Views of one random scene.

    Args:
        rng: all that is random.
        num: views of it.
        size_px: width and height of the pictures, even numbers.
        num_looks: pictures of each view.
        is_garage: a garage seen by fisheyes, in place of a street seen by cameras without distortion.
    """
    scene = hall.random_hall(rng) if is_garage else street.random_street(rng)
    return [_view(scene, rng, size_px, num_looks, is_garage) for _ in range(num)]


def _view(
    scene: Scene, rng: np.random.Generator, size_px: tuple[int, int], num_looks: int, is_garage: bool
) -> StreetView:
    # A camera with few pixels needs fewer rays for the same picture; its ids are repeated then.
    coarser = 2 if is_garage else int(rng.choice([1, 2], p=(0.6, 0.4)))
    camera, T_base_cam = (_fisheye if is_garage else _pinhole)(rng, size_px, FINER // coarser)
    s = rng.uniform(0.0, hall.VIEWED_M if is_garage else street.VIEWED_M)
    d, turn = (rng.normal(0.0, 0.6), rng.normal(0.0, np.radians(4.0)))
    heading = scene.path.heading_at(np.array([s])) + turn + (np.pi * rng.integers(2) if is_garage else 0.0)
    T_map_base = scene.surface.stand(scene.path.at(np.array([s]), np.array([d])), heading)[0]
    T_map_cam = T_map_base @ T_base_cam
    ego = [carried(box, T_map_base) for box in scene.ego]
    view = render(scene, PixelRays(camera), T_map_cam, ego, 0.0)
    indoors = scene.solids if is_garage else None
    if is_garage and rng.random() < 0.75:
        view = _round(view, T_map_cam, np.radians(rng.uniform(82.0, 105.0)))
    pictures = tuple(
        _as_seen(random_picture(view, T_map_cam, camera, scene.surface, rng, FINER, indoors), coarser)
        for _ in range(num_looks)
    )
    ids = plain_ids(view.class_id)
    return StreetView(pictures, ids.repeat(coarser, axis=0).repeat(coarser, axis=1))


def _as_seen(picture: np.ndarray, coarser: int) -> np.ndarray:
    """The picture of a camera with few pixels, enlarged."""
    size = picture.shape[1] * coarser, picture.shape[0] * coarser
    return picture if coarser == 1 else cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR)


def _pinhole(rng: np.random.Generator, size_px: tuple[int, int], finer: int) -> tuple[Camera, np.ndarray]:
    """A window of the image of a camera that mostly looks ahead, and T_base_cam."""
    width, height = size_px
    focal = float(np.exp(rng.uniform(np.log(380.0), np.log(1500.0))))
    whole = rng.uniform(max(700.0, width), 1280.0), max(rng.uniform(0.3, 0.75) * 900.0, height)
    left, top = rng.uniform(0.0, whole[0] - width), rng.uniform(0.0, whole[1] - height)
    high = rng.random() < 0.07
    up_m = rng.uniform(5.5, 8.5) if high else rng.uniform(1.1, 1.9) if rng.random() < 0.85 else rng.uniform(1.9, 3.2)
    down = rng.uniform(6.0, 25.0) if high else rng.normal(2.0, 3.0)
    # Where a long lens looks little above or below the horizon: near it is where marks and posts are.
    center = 0.5 * whole[0] - left, np.clip(0.5 * whole[1] - top, -60.0, height + 40.0)
    camera = _finer(BrownConradyCamera, (focal, focal, *center), size_px, finer)
    side = np.radians(rng.uniform(-180.0, 180.0)) if rng.random() < _ASIDE else rng.normal(0.0, 0.03)
    return camera, mounted((1.6, 0.0, up_m), np.degrees(side), float(down), float(rng.normal(0.0, 1.5)))


def _fisheye(rng: np.random.Generator, size_px: tuple[int, int], finer: int) -> tuple[Camera, np.ndarray]:
    """A window of the image of one of four fisheyes around a vehicle, and T_base_cam."""
    width, height = size_px
    focal = rng.uniform(300.0, 480.0)
    down_deg = rng.uniform(10.0, 45.0)
    # Most windows about the horizon, where slots and pillars are; some below, where marks are wide.
    horizon = 480.0 - focal * np.radians(down_deg)
    top = horizon - rng.uniform(0.1, 0.8) * height if rng.random() < 0.65 else rng.uniform(150.0, 960.0 - height)
    left = rng.uniform(0.0, 1280.0 - width)
    k = rng.normal(0.0, 0.01, 4) * [1.0, 0.5, 0.1, 0.02]
    camera = _finer(KannalaBrandtCamera, (focal, focal, 640.0 - left, 480.0 - top), size_px, finer, *k)
    place, yaw = [
        ((3.8, 0.0, 0.65), 0.0),
        ((1.95, 1.02, 1.0), 90.0),
        ((-0.95, 0.0, 0.85), 180.0),
        ((1.95, -1.02, 1.0), -90.0),
    ][int(rng.integers(4))]
    return camera, mounted(
        tuple(place + rng.normal(0.0, 0.05, 3)),
        yaw + rng.normal(0.0, 2.0),
        down_deg,
        rng.normal(0.0, 1.0),
    )


def _finer(
    make: type, intrinsics: tuple[float, float, float, float], size_px: tuple[int, int], finer: int, *more: float
) -> Camera:
    """A camera with `finer` times as many pixels on each side."""
    fx, fy, cx, cy = intrinsics
    shift = 0.5 * (finer - 1)
    size = finer * size_px[0], finer * size_px[1]
    return make(finer * fx, finer * fy, finer * cx + shift, finer * cy + shift, *size, *more)


def _round(view: RenderedView, T_map_cam: np.ndarray, angle_rad: float) -> RenderedView:
    """The view of a lens that shows nothing farther than this from its axis: black, and no class."""
    shown = view.ray_map @ T_map_cam[:3, 2] > np.cos(angle_rad)
    return replace(
        view,
        class_id=np.where(shown, view.class_id, np.uint8(0)),
        range_m=np.where(shown, view.range_m, np.inf),
        in_view=view.in_view & shown,
    )
