"""How good a trajectory is: files, errors in the vehicle frame, metrics, reports and the baseline gate."""

from semloc_jax.door import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "align": (
            "Alignment",
            "aligned",
        ),
        "way_drift": ("drift",),
        "held": (
            "held_directions",
            "held_text",
        ),
        "integrity": (
            "NeesReport",
            "StanfordCounts",
            "nees",
            "normalised_squares",
            "stanford_counts",
        ),
        "map_comparison": (
            "ClassComparison",
            "MapComparison",
            "MapTolerance",
            "compare_maps",
        ),
        "metrics": (
            "ErrorLimit",
            "Metric",
            "evaluate",
            "metrics_of_errors",
            "pose_errors",
            "within",
        ),
        "report": (
            "Outcome",
            "Verdict",
            "compare",
            "format_metrics",
            "format_verdicts",
            "is_passed",
            "read_metrics",
            "write_metrics",
        ),
        "surveyed": (
            "SurveyedDistance",
            "SurveyedEnd",
            "surveyed_distances",
            "surveyed_metrics",
        ),
        "trajectory": (
            "Trajectory",
            "associate",
            "read_trajectory",
            "write_tum",
        ),
    },
)
