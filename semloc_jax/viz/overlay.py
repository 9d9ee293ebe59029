"""The map as a camera sees it, drawn on the image or the mask, before and after (room: viz).

In: map samples, a vehicle pose, a camera, an image. Out: contours in pixels, image arrays, a before/after Figure.
What is drawn are the very contours that the solver compares with the masks, silhouettes of poles included.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from semloc_jax.cameras import Camera
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.perception.class_table import ClassTable
from semloc_jax.residuals.view import contour_points
from semloc_jax.structs import ElementClass, MapSamples
from semloc_jax.viz.style import COLOURS, SHIFT, class_name, new_figure, rgb

_MAX_SEGMENT_PX = 400.0
"""A longer piece comes from a contour that passes right by the lens: it would only smear."""


@dataclass(frozen=True)
class Contours:
    """Map contours in one image: short pieces with their class.

    Args:
        uv: ends of each piece [px], `float[n 2 2]`.
        label: ElementClass of each piece.
        element: its place in the local map, where that is known.
    """

    uv: np.ndarray
    label: np.ndarray
    element: np.ndarray | None = None

    @classmethod
    def none(cls) -> "Contours":
        """Nothing in view."""
        return cls(np.zeros((0, 2, 2)), np.zeros(0, int))

    def where(self, chosen: Bool[np.ndarray, " n"]) -> "Contours":
        """Some of the pieces."""
        element = None if self.element is None else self.element[chosen]
        return Contours(self.uv[chosen], self.label[chosen], element)

    @property
    def classes(self) -> tuple[ElementClass, ...]:
        """Classes in view."""
        return tuple(ElementClass(value) for value in np.unique(self.label))


@dataclass(frozen=True)
class Panel:
    """One camera of a before/after picture: its image and the contours on the left and on the right."""

    name: str
    image: np.ndarray
    before: Contours
    after: Contours


def project_contours(
    samples: MapSamples,
    local: LocalFrame,
    T_map_base: np.ndarray,
    camera: Camera,
    T_base_cam: np.ndarray,
    max_range_m: float = 60.0,
) -> Contours:
    """Contours of the map in an image, as seen from a vehicle pose.

    Args:
        samples: From `maps.sample`, in that local frame.
        local: Frame of the samples; `LocalMap.frame`.
        T_map_base: Vehicle pose in the map frame.
        camera: The camera.
        T_base_cam: Where it sits on the vehicle.
        max_range_m: Contours farther from the camera are left out.
    """
    T_map_cam = np.asarray(T_map_base, dtype=np.float64) @ np.asarray(T_base_cam, dtype=np.float64)
    T_local_cam = local.from_map(T_map_cam, np.float64)
    dtype = jnp.asarray(samples.p_map).dtype
    uv, shown = (np.asarray(a) for a in _seen(samples, jnp.asarray(T_local_cam, dtype), camera, max_range_m))
    return Contours(uv[shown].astype(np.float64), *(np.asarray(a)[shown] for a in (samples.label, samples.element)))


@eqx.filter_jit
def _seen(
    samples: MapSamples, T_local_cam: Array, camera: Camera, max_range_m: float
) -> tuple[Float[Array, "n 2 2"], Bool[Array, " n"]]:
    """Both ends of the piece of contour around each sample [px], and whether it is seen; all samples, so that the shape
    is that of the bucket and few programs are compiled."""
    center = T_local_cam[:3, 3]
    p_map, is_contour = contour_points(samples, center)
    half = 0.5 * samples.length_m[:, None] * samples.tangent_map
    ends = jnp.stack([p_map - half, p_map + half], axis=1)
    uv, valid = camera.project((ends - center) @ T_local_cam[:3, :3])
    near = jnp.linalg.norm(p_map - center, axis=1) < max_range_m
    inside = camera.in_image(uv[..., 0], uv[..., 1], -0.05 * camera.width).any(axis=1)
    short = jnp.linalg.norm(uv[:, 1] - uv[:, 0], axis=1) < _MAX_SEGMENT_PX
    return uv, samples.valid & is_contour & near & valid.all(axis=1) & inside & short


def draw_contours(
    image: np.ndarray, contours: Contours, thickness_px: int = 2, colour: str | None = None
) -> np.ndarray:
    """A copy of an RGB image with the contours in the colours of their classes, each with a dark rim.

    Args:
        image: uint8[h w 3], red green blue.
        contours: From `project_contours`.
        thickness_px: Width of the lines.
        colour: One colour `#rrggbb` for all classes.
    """
    picture = np.ascontiguousarray(image).copy()
    fixed = np.round(contours.uv * 2**SHIFT).astype(np.int32)
    cv2.polylines(picture, list(fixed), False, (8, 10, 14), thickness_px + 2, cv2.LINE_AA, SHIFT)
    for label in contours.classes:
        pieces = list(fixed[contours.label == label])
        cv2.polylines(picture, pieces, False, rgb(colour or COLOURS[label]), thickness_px, cv2.LINE_AA, SHIFT)
    return picture


def at_width(image: np.ndarray, contours: Contours, width_px: int) -> tuple[np.ndarray, Contours]:
    """An image of another width with its contours: lines drawn in a small image hide the paint once it is enlarged.

    Args:
        image: uint8[h w 3].
        contours: Of the image.
        width_px: Width wanted; the height follows, to an even number.
    """
    height_px = 2 * round(0.5 * image.shape[0] * width_px / image.shape[1])
    how = cv2.INTER_CUBIC if width_px > image.shape[1] else cv2.INTER_AREA
    resized = cv2.resize(np.ascontiguousarray(image), (width_px, height_px), interpolation=how)
    scale = np.array([width_px / image.shape[1], height_px / image.shape[0]])
    return resized, replace(contours, uv=(contours.uv + 0.5) * scale - 0.5)


def mask_picture(mask: np.ndarray, table: ClassTable) -> np.ndarray:
    """A class-id mask as an RGB image: every channel in the colour of its first class, unusable pixels dark red."""
    lookup = np.full((256, 3), 58, dtype=np.uint8)
    for channel in table.channels:
        # Half as bright as the contours, so that these stay visible on top.
        lookup[list(channel.mask_ids)] = np.array(rgb(COLOURS[channel.classes[0]])) * 0.55
    lookup[list(table.unusable_ids)] = (70, 20, 24)
    return lookup[mask]


def dim(image: np.ndarray, brightness: float = 0.6) -> np.ndarray:
    """A darker copy of an image, so that lines stand out."""
    return (np.asarray(image, dtype=np.float32) * brightness).astype(np.uint8)


def before_after(panels: Sequence[Panel], before_text: str, after_text: str, width_px: int = 760) -> Figure:
    """Two columns, the start on the left and the result on the right, one row for each camera.

    Args:
        panels: RGB images with their contours.
        before_text: What the left column shows, e.g. `prior from GNSS`.
        after_text: Status and numbers of the result.
        width_px: Width of one image in the figure.
    """
    heights = [panel.image.shape[0] / panel.image.shape[1] for panel in panels]
    width_in, header_in, legend_in = width_px / 100.0, 0.35, 0.35
    figure = new_figure(2 * width_in, width_in * sum(heights) + header_in + legend_in, dark=True)
    grid = figure.subplots(len(panels), 2, squeeze=False, gridspec_kw={"height_ratios": heights})
    for row, panel in enumerate(panels):
        for axes, contours in zip(grid[row], (panel.before, panel.after), strict=True):
            drawn = at_width(panel.image, contours, max(width_px, panel.image.shape[1]))
            axes.imshow(draw_contours(*drawn), interpolation="antialiased")
            axes.set_axis_off()
            _write(axes, panel.name)
    for axes, text in zip(grid[0], (before_text, after_text), strict=True):
        axes.set_title(text, color="#e8edf4", fontsize=11, loc="left", pad=6)
    _legend(figure, panels)
    return figure


def _write(axes, text: str) -> None:
    box = {"facecolor": "#000000", "alpha": 0.45, "edgecolor": "none", "pad": 2.5}
    axes.text(0.01, 0.98, text, transform=axes.transAxes, color="#e8edf4", fontsize=9, va="top", bbox=box)


def _legend(figure: Figure, panels: Sequence[Panel]) -> None:
    seen = sorted({label for panel in panels for part in (panel.before, panel.after) for label in part.classes})
    if not seen:
        return
    handles = [Patch(color=COLOURS[label], label=class_name(label)) for label in seen]
    figure.legend(
        handles=handles,
        loc="outside lower left",
        ncols=len(handles),
        fontsize=9,
        frameon=False,
        labelcolor="#e8edf4",
        handlelength=0.9,
        handleheight=0.9,
        columnspacing=1.4,
    )
