"""Small shapefiles of a Korean precise road map, which GDAL writes in Korea 2000."""

import numpy as np
import shapely

EAST, NORTH = 200_000.0, 550_000.0
"""A place on the central meridian of EPSG:5186, Seoul's grid, where its scale is 1."""


def write_layer(folder, layer: str, shapes, crs="EPSG:5186", **fields):
    """A layer; values of its fields are given by name."""
    import pyogrio  # an extra

    names, values = list(fields), [np.array(v, dtype=object) for v in fields.values()]
    kind = f"{shapes[0].geom_type} Z"
    blobs = shapely.to_wkb(np.array(shapes, dtype=object), output_dimension=3)
    pyogrio.raw.write(
        folder / f"{layer}.shp", blobs, values, names, driver="ESRI Shapefile", geometry_type=kind, crs=crs
    )


def line(x0, x1, y, z=30.0):
    return shapely.LineString([(EAST + x0, NORTH + y, z), (EAST + x1, NORTH + y, z)])


def box(x, y, z=30.0):
    corners = [(0, 0), (1, 0), (1, 3), (0, 3)]
    return shapely.Polygon([(EAST + x + dx, NORTH + y + dy, z) for dx, dy in corners])


def write_ngii(folder):
    """A street with four marks, a mark on the surface, a crosswalk and a post."""
    lines = [line(0, 40, 0), line(0, 40, 3), line(38, 38.1, 0), line(0, 40, 6)]
    values = {"ID": ["a", "b", "c", "d"], "Kind": ["501", "503", "530", "501"], "Type": ["121", "212", "211", "114"]}
    write_layer(folder, "B2_SURFACELINEMARK", lines, **values)
    write_layer(folder, "B3_SURFACEMARK", [box(10, 1), box(20, 1)], ID=["e", "f"], Kind=["5371", "5321"])
    write_layer(folder, "C6_POSTPOINT", [shapely.Point(EAST, NORTH, 30.0)], ID=["g"], Type=["1"])
    return folder
