"""Vision-based semantic localization in a map, on JAX.

The whole flow, from files to poses with a verdict:

    import semloc_jax as sj

    drive = sj.open_drive("drives/town")                    # frames, masks, calibration, GNSS
    semantic_map = sj.read_map("drives/town/map.geojson")      # world river: elements
    results = sj.localize_frames(drive, semantic_map, masks="sem_net", prior="gnss")
    results[0].T_map_base, results[0].localized, results[0].reasons, results[0].modes

and its parts: `semantic_map.query` and `sample` (map to contour points), `cost_maps` (masks to smooth ramps), `align`
(one pose), `FrameLocalizer` (one frame), `evaluate` (errors with their units).
Names are loaded on first use, so `import semloc_jax` costs nothing; drawing lives in `semloc_jax.viz`.
"""

import importlib
from typing import Any

from semloc_jax import host as _host

__version__ = "0.1.0"

_HOME = {
    "SemlocError": "errors",
    "ElementClass": "structs",
    "MapSamples": "structs",
    "CostMaps": "structs",
    "PoseEstimate": "structs",
    "SolveStatus": "structs",
    "PinholeCamera": "cameras",
    "BrownConradyCamera": "cameras",
    "KannalaBrandtCamera": "cameras",
    "CylindricalCamera": "cameras",
    "BevCamera": "cameras",
    "Rig": "cameras",
    "read_calibration": "cameras.io",
    "MapElement": "maps",
    "SemanticMap": "maps",
    "read_map": "maps",
    "inspect_map": "maps",
    "sample": "maps",
    "ClassTable": "perception",
    "load_class_table": "perception",
    "CostMapConfig": "perception",
    "cost_maps": "perception",
    "Drive": "datasets",
    "open_drive": "datasets",
    "simulate": "simulation",
    "Prior": "alignment.pose",
    "align": "alignment.pose",
    "align_differentiable": "alignment.implicit",
    "smooth_scene": "alignment.implicit",
    "FrameLocalizer": "alignment.frame_localizer",
    "LocalizationResult": "alignment.result",
    "LocalizeConfig": "alignment.frame_localizer",
    "PosePrior": "alignment.pose_prior",
    "localize_frames": "localization.frame_by_frame",
    "Trajectory": "evaluation",
    "read_trajectory": "evaluation",
    "write_tum": "evaluation",
    "pose_errors": "evaluation",
    "evaluate": "evaluation",
    "Metric": "evaluation",
}
"""Room of each public name, in the order of the data flow."""

__all__ = [
    "BevCamera",
    "BrownConradyCamera",
    "ClassTable",
    "CostMapConfig",
    "CostMaps",
    "CylindricalCamera",
    "ElementClass",
    "FrameLocalizer",
    "KannalaBrandtCamera",
    "LocalizationResult",
    "LocalizeConfig",
    "MapElement",
    "MapSamples",
    "Metric",
    "PinholeCamera",
    "PoseEstimate",
    "PosePrior",
    "Prior",
    "Rig",
    "SemanticMap",
    "SemlocError",
    "Drive",
    "SolveStatus",
    "Trajectory",
    "__version__",
    "align",
    "align_differentiable",
    "cost_maps",
    "evaluate",
    "inspect_map",
    "load_class_table",
    "localize_frames",
    "open_drive",
    "pose_errors",
    "read_calibration",
    "read_map",
    "read_trajectory",
    "sample",
    "simulate",
    "smooth_scene",
    "write_tum",
]


# Pure JAX rooms know no host: here they are told how kernels are built and where compiled programs are kept.
_host.offer(
    native=lambda: importlib.import_module("semloc_jax.native.build").status(),
    programs=lambda: importlib.import_module("semloc_jax.runtime.programs"),
)


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'semloc_jax' has no attribute {name!r}; its names are {', '.join(__all__)}")
    value = getattr(importlib.import_module(f"semloc_jax.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
