"""`semloc survey`: places, weak stretches, a small map, where a camera should look."""

import csv
from pathlib import Path

import numpy as np
import pytest

from semloc_jax.cameras.io import read_calibration
from semloc_jax.cli.main import FAILED, OK, main
from semloc_jax.maps.io import write_drive_geojson
from semloc_jax.maps.io.formats import format_of
from semloc_jax.reports import survey


@pytest.mark.parametrize(
    ("name", "written"), [("m.osm", ".osm"), ("m.xml", ".osm"), ("m.smap", ".smap"), ("m.gpkg", None), ("m.xodr", None)]
)
def test_a_small_map_has_the_format_of_the_whole_one(name, written):
    """Where that can be written and has no size of its own; else it is GeoJSON in metres."""
    write, suffix = survey._format(Path(name))
    assert suffix == (written or ".geojson")
    assert write is (format_of(Path(name)).write if written else write_drive_geojson)


def test_a_camera_that_is_not_there_is_told_before_the_work(simulated_road, capsys):
    road = str(simulated_road / "map.geojson"), "--camera", str(simulated_road / "calib.yaml")
    assert main(["survey", *road, "--place", "nose"]) == FAILED
    assert "camera 'nose': not in the calibration; expected one of front" in capsys.readouterr().err


@pytest.mark.slow
def test_a_way_is_surveyed_its_map_thinned_and_its_camera_placed(simulated_road, tmp_path, capsys):
    """The files say what the text says, and the placed calibration is the given one but for what may change."""
    out = tmp_path / "out"
    road = [str(simulated_road / "map.geojson"), "--camera", str(simulated_road / "calib.yaml")]
    way = ["--path", str(simulated_road / "poses_body.tum"), "--spacing-m", "10", "--keep", "0.3"]
    held = ["--place-rise-m", "0", "0", "--place-zoom", "1", "1", "--place-count", "2"]
    assert main(["survey", *road, *way, "--place", "front", *held, "--out", str(out)]) == OK
    said = capsys.readouterr().out
    assert "camera front placed for 2 places: " in said and "+0.00 m higher, focal length x 1.00" in said
    names = {"places.csv", "places.geojson", "weak.csv", "survey.png", "small_map.geojson", "placement.csv"}
    assert names | {"placement.png", "placed", "config.yaml"} <= {path.name for path in out.iterdir()}
    rows = list(csv.DictReader((out / "placement.csv").open()))
    assert len(rows) == 2
    log_gain = [
        np.log(float(row[f"sigma_{what}_before"]) / float(row[f"sigma_{what}_after"]))
        for row in rows
        for what in ("longitudinal_m", "lateral_m", "heading_deg")
    ]
    assert np.mean(log_gain) > 0.02
    given, placed = (read_calibration(folder / "calib.yaml") for folder in (simulated_road, out / "placed"))
    before, after = np.asarray(given.T_base_cam[0]), np.asarray(placed.T_base_cam[0])
    np.testing.assert_allclose(after[:3, 3], before[:3, 3], atol=1e-5)
    np.testing.assert_allclose(after[:3, 0], before[:3, 0], atol=1e-5)  # turned about its own horizontal axis
    turned_deg = np.rad2deg(np.arccos(after[:3, 2] @ before[:3, 2]))
    assert 0.1 < turned_deg < 25.0 and f"{turned_deg:.1f} deg down" in said
    assert float(placed.cameras[0].fx) == pytest.approx(float(given.cameras[0].fx), rel=1e-6)
