"""A made-up town of any size, and a command that writes it: `python -m tests.maps.io.town 1000 town.gpkg`."""

import sys

import numpy as np

from semloc_jax.maps import GeoOrigin, MapElement, SemanticMap
from semloc_jax.maps.io.geopackage import write_geopackage
from semloc_jax.structs import ElementClass

ORIGIN = GeoOrigin(48.1, 11.6, 520.0)


def town(num_km: int) -> SemanticMap:
    """Roads of 1 km, 400 m apart: two edge lines in pieces of 100 m, dashes of 3 m every 12 m, a pole every 50 m."""
    along = np.arange(0.0, 1000.1, 10.0)
    elements = []
    for road in range(num_km):
        x, y = 1000.0 * (road % 32), 400.0 * (road // 32)
        line = np.stack([x + along, y + 3.0 * np.sin(along / 80.0), 30.0 * np.sin((x + along) / 700.0)], axis=1)
        for side in (-3.5, 3.5):
            for k in range(0, 100, 10):
                points = line[k : k + 11] + [0.0, side, 0.0]
                name = f"r{road}_{side}_{k}"
                elements.append(MapElement(name, ElementClass.LANE_MARKING, points, width_m=0.15, style="solid"))
        for k in range(83):
            bar = np.stack([np.interp([12.0 * k, 12.0 * k + 3.0], along, axis) for axis in line.T], axis=1)
            elements.append(MapElement(f"r{road}_d{k}", ElementClass.LANE_MARKING, bar, width_m=0.15, style="dashed"))
        for k in range(20):
            axis = line[5 * k] + np.array([[0.0, 6.0, 0.0], [0.0, 6.0, 6.0]])
            elements.append(MapElement(f"r{road}_p{k}", ElementClass.POLE, axis, radius_m=0.1, radius_top_m=0.1))
    return SemanticMap(tuple(elements), ORIGIN, f"{num_km} km")


if __name__ == "__main__":
    write_geopackage(town(int(sys.argv[1])), sys.argv[2])
