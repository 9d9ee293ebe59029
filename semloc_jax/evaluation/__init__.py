"""How good a trajectory is: files, errors in the vehicle frame, metrics, reports and the baseline gate."""

from semloc_jax.evaluation.align import Alignment, aligned
from semloc_jax.evaluation.benchmark import Outcome, Verdict, compare, format_verdicts, is_passed
from semloc_jax.evaluation.held import held_directions, held_text
from semloc_jax.evaluation.integrity import NeesReport, StanfordCounts, nees, normalised_squares, stanford_counts
from semloc_jax.evaluation.map_comparison import ClassComparison, MapComparison, MapTolerance, compare_maps
from semloc_jax.evaluation.metrics import ErrorLimit, Metric, evaluate, metrics_of_errors, pose_errors, within
from semloc_jax.evaluation.report import format_metrics, read_metrics, write_metrics
from semloc_jax.evaluation.trajectory import Trajectory, associate, read_trajectory, write_tum

__all__ = [
    "Alignment",
    "ClassComparison",
    "ErrorLimit",
    "MapComparison",
    "Metric",
    "NeesReport",
    "Outcome",
    "StanfordCounts",
    "MapTolerance",
    "Trajectory",
    "Verdict",
    "aligned",
    "associate",
    "compare",
    "compare_maps",
    "evaluate",
    "format_metrics",
    "format_verdicts",
    "held_directions",
    "held_text",
    "is_passed",
    "metrics_of_errors",
    "nees",
    "normalised_squares",
    "pose_errors",
    "read_metrics",
    "read_trajectory",
    "stanford_counts",
    "within",
    "write_metrics",
    "write_tum",
]
