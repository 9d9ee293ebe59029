"""Vision-based semantic localization in a map, on JAX.

The whole flow, from files to a pose with a verdict:

    import semloc_jax as sj

    drive = sj.open_sequence("drives/town")                       # frames, masks, calibration, GNSS
    semantic_map = sj.read_map("drives/town/map.geojson")         # world river: elements ...
    local = semantic_map.query(center_map, radius_m=60.0)         # ... near the vehicle ...
    samples = sj.sample(local, spacing_m=0.3)                     # ... as points on the contours
    evidence = sj.cost_maps(masks, sj.class_table("drive"), sj.CostMapConfig())   # image river: smooth ramps
    results = sj.localize_drive(drive, semantic_map)              # bridge and road: poses, covariance, status
    metrics = sj.evaluate(estimate, reference)                    # against the truth, each with its unit

Names are loaded on first use, so `import semloc_jax` costs nothing; drawing lives in `semloc_jax.viz`.
"""

import importlib
from typing import Any

__version__ = "0.1.0"

_HOME = {
    "SemlocError": "errors",
    "ElementClass": "structs",
    "MapSamples": "structs",
    "CostMaps": "structs",
    "PoseEstimate": "structs",
    "SolveStatus": "structs",
}

__all__ = ["CostMaps", "ElementClass", "MapSamples", "PoseEstimate", "SemlocError", "SolveStatus", "__version__"]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'semloc_jax' has no attribute {name!r}; its names are {', '.join(__all__)}")
    value = getattr(importlib.import_module(f"semloc_jax.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
