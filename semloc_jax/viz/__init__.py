"""Pictures of maps, poses and costs (room: viz); the only place with matplotlib, every picture a Figure or an array."""

from semloc_jax.door import door
from semloc_jax.viz.bev import map_view
from semloc_jax.viz.landscape import CostSlice, Minimum, find_minima, landscape
from semloc_jax.viz.overlay import Contours, Panel, before_after, draw_contours, mask_picture, project_contours
from semloc_jax.viz.style import save, to_image
from semloc_jax.viz.trajectory import errors_over_time

__getattr__, __dir__, _more = door(
    __name__,
    {
        "style": ("ESTIMATE", "PRIOR", "REFERENCE", "new_figure", "plain_axes"),
        "bev": ("draw_map", "draw_vehicle"),
        "maps": ("maps_over_each_other", "sigmas_from_above", "changes_from_above", "existence_from_above"),
        "point_map": ("points_from_above",),
        "crowd": ("error_against_drives",),
        "overlay": ("at_width", "dim"),
        "basin": ("basin_view",),
        "frame_slices": ("slices_of_frame",),
        "tracking": ("tracking_over_time",),
        "odometry": ("odometry_picture",),
        "self_calibration": ("observability_figure",),
        "integrity": ("IntegrityErrors", "stanford_diagram"),
        "survey": ("survey_view", "prediction_view", "placement_view"),
        "bench": ("roofline_figure",),
        "explain": ("explained_image", "explained_map"),
    },
)

__all__ = [
    *_more,
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
