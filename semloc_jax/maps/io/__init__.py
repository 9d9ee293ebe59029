"""Readers and writers of vector maps (room: maps; host).

In: a path. Out: SemanticMap, whatever the format (table in formats.py).
"""

from semloc_jax.maps.io.apollo import ApolloStyle, read_apollo
from semloc_jax.maps.io.argoverse2 import Argoverse2Style
from semloc_jax.maps.io.compact import read_compact, write_compact
from semloc_jax.maps.io.drive_geojson import write_drive_geojson
from semloc_jax.maps.io.formats import FORMATS, WRITTEN_SUFFIXES, read_map, write_map
from semloc_jax.maps.io.geojson import write_geojson
from semloc_jax.maps.io.geopackage import StoredMap, read_geopackage, write_geopackage
from semloc_jax.maps.io.lanelet2 import read_lanelet2
from semloc_jax.maps.io.lanelet2_ways import Lanelet2Style
from semloc_jax.maps.io.lanelet2_writer import write_lanelet2
from semloc_jax.maps.io.lanes import read_lane_centers
from semloc_jax.maps.io.left_out import left_out
from semloc_jax.maps.io.ngii import NgiiStyle, read_ngii
from semloc_jax.maps.io.nuscenes import NuScenesStyle
from semloc_jax.maps.io.opendrive import OpenDriveStyle, read_opendrive

__all__ = [
    "ApolloStyle",
    "Argoverse2Style",
    "FORMATS",
    "Lanelet2Style",
    "NgiiStyle",
    "NuScenesStyle",
    "OpenDriveStyle",
    "StoredMap",
    "WRITTEN_SUFFIXES",
    "left_out",
    "read_apollo",
    "read_compact",
    "read_geopackage",
    "read_lane_centers",
    "read_lanelet2",
    "read_map",
    "read_ngii",
    "read_opendrive",
    "write_compact",
    "write_drive_geojson",
    "write_geojson",
    "write_geopackage",
    "write_lanelet2",
    "write_map",
]
