"""Pictures of maps, poses and costs (room: viz); the only place with matplotlib, every picture a Figure or an array."""

from semloc_jax.door import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "style": ("ESTIMATE", "PRIOR", "REFERENCE", "new_figure", "plain_axes", "save", "to_image"),
        "bev": ("draw_map", "draw_vehicle", "map_view"),
        "cost_slices": ("CostSlice", "Minimum", "find_minima", "landscape", "slices_of_frame"),
        "trajectory": ("errors_over_time", "odometry_picture"),
        "maps": ("maps_over_each_other", "sigmas_from_above", "changes_from_above", "existence_from_above"),
        "point_map": ("points_from_above",),
        "error_curves": ("error_against_drives",),
        "overlay": (
            "Contours",
            "Panel",
            "at_width",
            "before_after",
            "dim",
            "draw_contours",
            "mask_picture",
            "project_contours",
        ),
        "basin": ("basin_view",),
        "tracking": ("IntegrityErrors", "stanford_diagram", "tracking_over_time"),
        "self_calibration": ("observability_figure",),
        "survey": ("survey_view", "prediction_view", "placement_view"),
        "bench": ("roofline_figure",),
        "explain": ("explained_image", "explained_map"),
    },
)
