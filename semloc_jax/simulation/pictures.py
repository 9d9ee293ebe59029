"""Masks and images of a simulated drive on disk (room: simulation; host).

In: a Scene, the motion through it, cameras. Out: sem/, sem_net/ and rgb/ of the drive layout.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from semloc_jax.cameras import Camera, Rig
from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.errors import SemlocError
from semloc_jax.simulation.degrade import Degradation, degrade
from semloc_jax.simulation.looks.look import AnyLook, random_picture
from semloc_jax.simulation.motion import TrueMotion
from semloc_jax.simulation.render import PixelRays, RenderedView, render
from semloc_jax.simulation.render_classes import MaskRenderer
from semloc_jax.simulation.scene import Scene
from semloc_jax.simulation.shade import LIGHTINGS, Lighting, shade
from semloc_jax.simulation.solids import Box
from semloc_jax.simulation.variation import PictureRandom
from semloc_jax.storage import writing

LOOKS: dict[str, Lighting | AnyLook] = {**LIGHTINGS, AnyLook().name: AnyLook()}
"""Variants of the pictures of a drive."""


@dataclass(frozen=True)
class PictureSettings:
    """What is drawn of each frame.

    Args:
        has_images: whether colour images are drawn too.
        degradation: how bad the network's masks are.
        random: random numbers of a frame and a camera.
        keeps: whether pictures that are there already stay; they come from the same recipe.
    """

    has_images: bool
    degradation: Degradation
    random: PictureRandom
    keeps: bool


def write_pictures(
    out: Path,
    scene: Scene,
    motion: TrueMotion,
    rig: Rig,
    time_s: Float[np.ndarray, " n"],
    lightings: Sequence[Lighting | AnyLook],
    settings: PictureSettings,
) -> None:
    """Draw all frames into `out`, each picture whole or not at all."""
    rays = [PixelRays(camera) for camera in rig.cameras]
    sources = ("sem", "sem_net", *(("rgb",) if settings.has_images else ()))
    for source in sources:
        for name in rig.names:
            (out / source / name).mkdir(parents=True, exist_ok=True)
    T_base_cams = np.asarray(rig.T_base_cam)
    masks = (
        []
        if settings.has_images
        else [MaskRenderer(scene, *of_camera) for of_camera in zip(rays, T_base_cams, strict=True)]
    )
    for index, (time, lighting) in enumerate(zip(time_s.tolist(), lightings, strict=True)):
        T_map_base = motion.pose(time)
        for number, (name, T_base_cam) in enumerate(zip(rig.names, T_base_cams, strict=True)):
            places = {source: out / source / name / f"{index:06d}{_SUFFIX[source]}" for source in sources}
            if settings.keeps and all(place.is_file() for place in places.values()):
                continue
            rng, T_map_cam = settings.random(index, number), T_map_base @ T_base_cam
            if settings.has_images:
                ego = [carried(box, T_map_base) for box in scene.ego]
                view = render(scene, rays[number], T_map_cam, ego, time)
                class_id = view.class_id
            else:
                class_id = masks[number].classes(T_map_cam, time)
            _write_picture(places["sem"], class_id)
            _write_picture(places["sem_net"], degrade(class_id, rng, settings.degradation))
            if settings.has_images:
                image = _image(view, T_map_cam, rig.cameras[number], scene, lighting, rng)
                _write_picture(places["rgb"], image, [cv2.IMWRITE_JPEG_QUALITY, 90])


def _image(
    view: RenderedView,
    T_map_cam: np.ndarray,
    camera: Camera,
    scene: Scene,
    lighting: Lighting | AnyLook,
    rng: np.random.Generator,
) -> np.ndarray:
    """The colour image of a view."""
    if isinstance(lighting, Lighting):
        return shade(view, T_map_cam[:3, 3], lighting, rng)
    indoors = scene.solids if scene.backdrop == CLASS_IDS["wall"] else None
    return random_picture(view, T_map_cam, camera, scene.surface, rng, indoors=indoors)


_SUFFIX = {"sem": ".png", "sem_net": ".png", "rgb": ".jpg"}


def _write_picture(path: Path, picture: np.ndarray, parameters: Sequence[int] = ()) -> None:
    with writing(path) as partial:
        if not cv2.imwrite(str(partial), picture, list(parameters)):
            raise SemlocError(f"picture {path}: cannot be written; is the disk full?")


def carried(box: Box, T_map_base: np.ndarray) -> Box:
    """A box of the base frame in the map frame."""
    R = T_map_base[:3, :3]
    return replace(box, center=R @ box.center + T_map_base[:3, 3], R_map_box=R @ box.R_map_box)
