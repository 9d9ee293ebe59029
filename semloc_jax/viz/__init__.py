"""Pictures of maps, poses and costs (room: viz); the only place with matplotlib, every picture a Figure or an array."""

from semloc_jax.viz.bev import map_view
from semloc_jax.viz.landscape import CostSlice, Minimum, find_minima, landscape
from semloc_jax.viz.overlay import Contours, Panel, before_after, draw_contours, mask_picture, project_contours
from semloc_jax.viz.style import save, to_image
from semloc_jax.viz.trajectory import errors_over_time

__all__ = [
    "Contours",
    "CostSlice",
    "Minimum",
    "Panel",
    "before_after",
    "draw_contours",
    "errors_over_time",
    "find_minima",
    "landscape",
    "map_view",
    "mask_picture",
    "project_contours",
    "save",
    "to_image",
]
