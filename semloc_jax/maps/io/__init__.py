"""Readers and writers of vector maps (room: maps; host).

In: a path. Out: SemanticMap, whatever the format (table in formats.py).
"""

from semloc_jax.door import door

__getattr__, __dir__, __all__ = door(
    __name__,
    {
        "formats": (
            "FORMATS",
            "WRITTEN_SUFFIXES",
            "read_map",
            "write_map",
        ),
        "apollo": (
            "ApolloStyle",
            "read_apollo",
        ),
        "argoverse2": ("Argoverse2Style",),
        "compact": (
            "read_compact",
            "write_compact",
        ),
        "drive_geojson": ("write_drive_geojson",),
        "geojson": ("write_geojson",),
        "geopackage": (
            "StoredMap",
            "read_geopackage",
            "write_geopackage",
        ),
        "lanelet2": ("read_lanelet2",),
        "lanelet2_ways": ("Lanelet2Style",),
        "lanelet2_writer": ("write_lanelet2",),
        "lanes": ("read_lane_centers",),
        "ngii": (
            "NgiiStyle",
            "read_ngii",
        ),
        "nuscenes": ("NuScenesStyle",),
        "opendrive": (
            "OpenDriveStyle",
            "read_opendrive",
        ),
    },
)
