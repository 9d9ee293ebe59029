"""The vector map: elements, query by radius, contour sampling, readers (room: maps; host).

In: map files. Out: SemanticMap -> LocalMap -> MapSamples.
"""

from semloc_jax.door import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "elements": (
            "GeoOrigin",
            "MapElement",
        ),
        "semantic_map": (
            "LocalMap",
            "SemanticMap",
        ),
        "ground": (
            "GroundModel",
            "RoadPlane",
            "RoadSpread",
        ),
        "sampling": ("sample",),
        "from_arrays": ("map_from_arrays",),
        "beliefs": (
            "Belief",
            "BeliefMap",
        ),
        "shared_sigmas": (
            "SharedSigmas",
            "with_map_accuracy",
        ),
        "io.formats": (
            "read_map",
            "write_map",
        ),
        "io.drive_geojson": ("write_drive_geojson",),
        "io.geojson": ("write_geojson",),
        "io.lanelet2_ways": ("Lanelet2Style",),
        "io.opendrive": ("OpenDriveStyle",),
        "io.lanes": ("read_lane_centers",),
        "io.packed_drive": (
            "PackedDrive",
            "read_packed",
            "write_packed",
        ),
        "inspect": (
            "MapReport",
            "inspect_map",
        ),
        "losses": (
            "Losses",
            "compare",
        ),
    },
)
