"""One frame: masks and a map become poses with a verdict (room)."""

from semloc_jax.door import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "frame_localizer": (
            "FrameLocalizer",
            "LocalizeConfig",
        ),
        "single_frame": (
            "SingleFrameConfig",
            "evidence_from",
            "polish",
        ),
        "scene": (
            "ViewLimits",
            "SceneConfig",
        ),
        "pose_prior": (
            "PosePrior",
            "RoadSigmas",
        ),
        "proposals": (
            "propose",
            "displaced",
        ),
        "hypotheses": (
            "cull",
            "refine_and_score",
        ),
        "pose": (
            "AlignConfig",
            "Evidence",
            "Prior",
            "in_chunks",
            "level_problem",
            "total_weight",
            "visible_views",
        ),
        "problem": (
            "pose_of",
            "quadratic_model",
            "residual",
        ),
        "along_road": ("weighed_along_road",),
        "modes": ("modes_in_map",),
        "same_pose": ("ONE_TRACK",),
        "result": ("LocalizationResult",),
    },
)
