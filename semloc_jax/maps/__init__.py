"""The vector map: elements, query by radius, contour sampling, readers (room: maps; host).

In: map files. Out: SemanticMap -> LocalMap -> MapSamples.
"""

from semloc_jax.maps.beliefs import Belief, BeliefMap
from semloc_jax.maps.elements import GeoOrigin, MapElement
from semloc_jax.maps.from_arrays import map_from_arrays
from semloc_jax.maps.ground import GroundModel, RoadPlane, RoadSpread
from semloc_jax.maps.inspect import MapReport, inspect_map
from semloc_jax.maps.io import (
    Lanelet2Style,
    OpenDriveStyle,
    read_lane_centers,
    read_map,
    write_drive_geojson,
    write_geojson,
    write_map,
)
from semloc_jax.maps.io.packed_drive import PackedDrive, read_packed, write_packed
from semloc_jax.maps.losses import Losses, compare
from semloc_jax.maps.sampling import sample
from semloc_jax.maps.semantic_map import LocalMap, SemanticMap
from semloc_jax.maps.shared_sigmas import SharedSigmas, with_map_accuracy

__all__ = [
    "Belief",
    "BeliefMap",
    "GeoOrigin",
    "GroundModel",
    "Lanelet2Style",
    "LocalMap",
    "Losses",
    "MapElement",
    "MapReport",
    "OpenDriveStyle",
    "PackedDrive",
    "RoadPlane",
    "RoadSpread",
    "SemanticMap",
    "SharedSigmas",
    "with_map_accuracy",
    "compare",
    "inspect_map",
    "map_from_arrays",
    "read_lane_centers",
    "read_map",
    "read_packed",
    "sample",
    "write_drive_geojson",
    "write_geojson",
    "write_map",
    "write_packed",
]
