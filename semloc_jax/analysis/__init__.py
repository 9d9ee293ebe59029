"""What a map, a camera and a frame can and cannot tell about the pose (room: analysis).

In: maps, cameras, evidence, estimates. Out: expected accuracy, ambiguity, certificates, explanations, uncertainty.
"""

from semloc_jax.door import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "basin": (
            "PLAIN",
            "BasinConfig",
            "basins_of",
            "basin_table",
        ),
        "expected": (
            "ExpectedConfig",
            "TANGENT_OF_DIRECTION",
        ),
        "survey": (
            "Way",
            "SurveyConfig",
            "survey_ways",
        ),
        "placement": (
            "PlacementConfig",
            "place_camera",
        ),
        "selection": ("small_map",),
        "explain": (
            "ExplainConfig",
            "explain_frame",
        ),
        "uncertainty": (
            "pose_residuals",
            "sandwich_covariance",
        ),
        "pose_mixture": ("laplace_mixture",),
        "seed_errors": (
            "noisy_solves",
            "errors_by_seed",
        ),
    },
)
