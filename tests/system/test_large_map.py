"""A drive through a map of 1,000 km in a GeoPackage: tracked as in its own small map, and never read whole."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.cli.main import OK, main
from semloc_jax.evaluation import read_trajectory
from semloc_jax.maps import SemanticMap, read_map
from semloc_jax.maps.io.geopackage import StoredMap, write_geopackage
from tests.maps.io.town import town

AWAY_M = np.array([0.0, 5000.0, 0.0])
WORDS = ["--masks", "sem_net", "--fusion", "kalman", "--frames", ":15", "--overlays", "1", "--min-tracking-share", "0"]
WORDS += ["--search.num-hypotheses", "256"]


def write_among_others(small: SemanticMap, path, num_km: int) -> None:
    """Writes a map with a whole country beside it."""
    others = (replace(e, id=f"far {e.id}", points=e.points + AWAY_M) for e in town(num_km).elements)
    write_geopackage(small.with_elements([*others, *small.elements]), path)


@pytest.mark.slow
@pytest.mark.data
def test_a_drive_in_a_thousand_kilometres(road_dir, tmp_path, monkeypatch):
    write_among_others(read_map(road_dir / "map.geojson"), tmp_path / "large.gpkg", 1000)

    def refuse(self):
        raise AssertionError("the whole map is read")

    monkeypatch.setattr(StoredMap, "elements", property(refuse))
    found = {}
    for name, path in {"small": road_dir / "map.geojson", "large": tmp_path / "large.gpkg"}.items():
        assert main(["track", str(road_dir), "--map", str(path), *WORDS, "--out", str(tmp_path / name)]) == OK
        found[name] = read_trajectory(tmp_path / name / "trajectory.tum")
    assert len(found["large"]) == len(found["small"]) >= 14
    apart_m = np.linalg.norm(found["large"].T_map_base[:, :3, 3] - found["small"].T_map_base[:, :3, 3], axis=1)
    assert apart_m.max() < 0.002, apart_m
