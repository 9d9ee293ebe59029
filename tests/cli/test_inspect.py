"""`semloc inspect`: counts, defects, pictures; broken maps end with one line that says why."""

import json

import numpy as np
import pytest

from semloc_jax.cli.main import FAILED, LOST, OK, main
from semloc_jax.maps import MapElement, SemanticMap, write_drive_geojson
from semloc_jax.structs import ElementClass

FRAME = {"kind": "local ENU", "origin_lat_deg": 48.0, "origin_lon_deg": 11.0, "origin_alt_m": 500.0}


@pytest.fixture
def small_map(tmp_path):
    def write(*more):
        line = np.array([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0]])
        pole = np.array([[10.0, 4.0, 0.0], [10.0, 4.0, 5.0]])
        elements = (
            MapElement("line", ElementClass.LANE_MARKING, line, width_m=0.15, style="solid"),
            MapElement("pole", ElementClass.POLE, pole, radius_m=0.1, radius_top_m=0.1),
            *more,
        )
        path = tmp_path / "small.geojson"
        write_drive_geojson(SemanticMap(elements, name="small"), path)
        return str(path)

    return write


def test_a_sound_map_is_counted_and_drawn(small_map, tmp_path, capsys):
    picture = tmp_path / "map.png"
    assert main(["inspect", small_map(), "--strict", "--picture", str(picture)]) == OK
    said = capsys.readouterr().out
    assert "map small.geojson: 2 elements" in said  # the file that was given, whatever name the map has in it
    assert "lane_solid" in said
    assert "defects: none" in said
    assert picture.stat().st_size > 5000


def test_a_defect_is_exit_code_3_when_strict(small_map, capsys):
    twin = MapElement("twin", ElementClass.POLE, np.array([[10.0, 4.0, 0.0], [10.0, 4.0, 5.0]]), radius_m=0.1)
    path = small_map(twin)
    assert main(["inspect", path]) == OK
    assert main(["inspect", path, "--strict"]) == LOST
    assert "twin" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("empty.geojson", "", "not valid JSON"),
        ("cut.geojson", '{"type": "FeatureCollection", "features": [', "not valid JSON"),
        ("list.geojson", "[1, 2]", "expected a GeoJSON FeatureCollection"),
        ("none.geojson", json.dumps({"type": "FeatureCollection", "frame": FRAME, "features": []}), "no element"),
        ("map.doc", "x", "unknown type '.doc'"),
        ("map.txt", "x", "not an Apollo map in text form"),
        ("map.osm", "<osm><node", "map"),
    ],
)
def test_broken_maps_are_refused_in_one_line(tmp_path, capsys, name, text, message):
    (tmp_path / name).write_text(text)
    assert main(["inspect", str(tmp_path / name)]) == FAILED
    said = capsys.readouterr().err
    assert message in said
    assert name in said
    assert len(said.splitlines()) == 1
    assert "internal error" not in said


def test_a_missing_map_is_refused(capsys):
    assert main(["inspect", "nowhere.geojson"]) == FAILED
    assert capsys.readouterr().err == "semloc inspect: map nowhere.geojson: no such file\n"  # its suffix is right
    assert main(["inspect", "nowhere.doc"]) == FAILED
    assert "no such file; give a .geojson" in capsys.readouterr().err
