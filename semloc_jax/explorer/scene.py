"""What the page draws once for each frame: pictures of the cameras and the map from above (room: explorer; host).

In: a frame, its masks, the local map. Out: JPEG files, shapes of map elements, colours; as plain data.
"""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from semloc_jax.datasets import Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_source import MaskSource
from semloc_jax.inputs.mask_view import TopViewSource
from semloc_jax.maps.contours import painted_polygon
from semloc_jax.maps.elements import UPRIGHT_CLASSES, MapElement
from semloc_jax.perception import ClassTable
from semloc_jax.structs import ElementClass
from semloc_jax.viz.bev import VEHICLE_M
from semloc_jax.viz.overlay import mask_picture
from semloc_jax.viz.style import COLOURS, class_name

JPEG_QUALITY = 88


def channels(table: ClassTable) -> list[dict[str, Any]]:
    """Name, classes and colour of every mask channel."""
    return [
        {
            "name": channel.name,
            "title": channel.name.replace("_", " "),
            "classes": [class_name(label) for label in channel.classes],
            "colour": COLOURS[channel.classes[0]],
        }
        for channel in table.channels
    ]


def map_shapes(elements: Sequence[MapElement]) -> list[dict[str, Any]]:
    """Elements from above in the map frame [m], to the millimetre: `face` (paint), `dot` (upright things), `line`."""
    shapes = []
    for element in elements:
        if element.is_logical and element.label != ElementClass.PARKING_SLOT:
            continue
        polygon = painted_polygon(element) if element.is_painted else None
        if polygon is not None and not polygon.is_empty:
            kind, points = "face", np.asarray(polygon.exterior.coords)[:, :2]
        elif element.label in UPRIGHT_CLASSES:
            kind, points = "dot", element.points[:1, :2]
        else:
            ring = [element.points, element.points[:1]] if element.closed else [element.points]
            kind, points = "line", np.vstack(ring)[:, :2]
        shapes.append({"kind": kind, "colour": COLOURS[element.label], "points": np.round(points, 3)})
    return shapes


def vehicle_outline() -> np.ndarray:
    """Outline of a car in the base frame `[k 2]` [m]."""
    return VEHICLE_M


def camera_picture(kind: str, camera: str, frame: Frame, mask: np.ndarray, source: MaskSource) -> bytes:
    """JPEG file of what a camera sees: its `image`, or its `mask` in the colours of the classes.

    Its pixels are those of the mask, scaled: an image is moved by the offset of its masks.

    Raises:
        SemlocError: no such picture.
    """
    if kind == "mask":
        return _jpeg(mask_picture(mask, source.table))
    image = frame.image(camera)
    height, width = image.shape[:2]
    offset = source.offset_px.get(camera, (0.0, 0.0))
    moved_px = offset[0] * width / mask.shape[1], offset[1] * height / mask.shape[0]
    if any(moved_px):
        by = np.array([[1.0, 0.0, moved_px[0]], [0.0, 1.0, moved_px[1]]])
        image = cv2.warpAffine(image, by, (width, height), borderMode=cv2.BORDER_REPLICATE)
    return _jpeg(image[..., ::-1])


def picture_kinds(camera: str, frame: Frame, source: MaskSource) -> list[str]:
    """What can be shown of a camera, best first."""
    is_stitched = isinstance(source, TopViewSource)
    return ["image", "mask"] if not is_stitched and frame.has("rgb", camera) else ["mask"]


def _jpeg(picture: np.ndarray) -> bytes:
    """An RGB image as a JPEG file."""
    good, data = cv2.imencode(
        ".jpg", np.ascontiguousarray(picture[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    )
    if not good:
        raise SemlocError(f"picture of shape {picture.shape} cannot be written as JPEG; check the images of the drive")
    return data.tobytes()
