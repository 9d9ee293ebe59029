"""The bridge: map samples seen by cameras, compared with the evidence (room: residuals; pure JAX).

In: the containers of structs. Out: residuals, their fused normal equations, robust costs. It knows neither river.
"""

from semloc_jax.door import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "view": ("ViewConfig",),
        "alignment": (
            "alignment_residual",
            "points_in_camera",
        ),
        "texture": (
            "locate",
            "pack",
        ),
        "robust": ("LOSSES",),
    },
)
