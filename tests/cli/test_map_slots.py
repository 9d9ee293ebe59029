"""`semloc slots MAP`: the slots of a map as a table, a map of their own and a picture."""

import csv
import json

import numpy as np
import pytest

from semloc_jax.cli.main import main
from semloc_jax.maps import Belief, BeliefMap, MapElement, SemanticMap, write_map
from semloc_jax.structs import ElementClass

SLOT = np.array([[2.5, 3.0, 0.0], [5.0, 3.0, 0.0], [5.0, 8.0, 0.0], [2.5, 8.0, 0.0]])


def element(name, points, label=ElementClass.PARKING_SLOT, **words):
    return MapElement(name, label, points, closed=True, attributes=words)


@pytest.fixture
def path(tmp_path):
    """Two slots, of which one was seen by a drive, and an arrow."""
    elements = [
        element("one", SLOT, kind="perpendicular", occupied=True, number="A07"),
        element("other", SLOT + [2.5, 0.0, 0.0]),
        element("arrow", SLOT[:3] - [0.0, 9.0, 0.0], ElementClass.ROAD_MARK),
    ]
    beliefs = {"one": Belief(0.012, 0.02, 3.0, 14, 2), "other": Belief(0.1, 0.1, 6.0), "arrow": Belief(0.1, 0.1, 6.0)}
    path = tmp_path / "yard.gpkg"
    write_map(BeliefMap(SemanticMap(tuple(elements), None, "yard"), beliefs).as_map(), path)
    return path


def test_slots_of_a_map_are_listed(path, tmp_path, capsys):
    assert main(["slots", str(path), "--out", str(tmp_path / "out")]) == 0
    assert "2 parking slots: 0 free, 1 taken, 1 not told" in capsys.readouterr().out
    one, other = csv.DictReader((tmp_path / "out" / "slots_final.csv").open())
    assert [float(one[key]) for key in ("x_m", "y_m", "width_m", "depth_m")] == [3.75, 3.0, 2.5, 5.0]
    assert float(one["yaw_rad"]) == pytest.approx(0.5 * np.pi, abs=1e-4)
    assert (one["type"], one["occupied"], one["number"], one["num_seen"]) == ("perpendicular", "1", "A07", "14")
    assert float(one["sigma_across_m"]) == 0.012 and float(one["existence"]) == pytest.approx(0.9526, abs=1e-4)
    # Nobody has seen the other one: that the map states it is no figure of a drive.
    assert (other["occupied"], other["sigma_across_m"], other["existence"]) == ("", "", "")
    features = json.loads((tmp_path / "out" / "slots.geojson").read_text())["features"]
    assert [feature["properties"]["class"] for feature in features] == ["parking_slot"] * 2
    assert (tmp_path / "out" / "slots.png").stat().st_size > 5_000


def test_a_map_without_slots_is_refused_in_one_line(tmp_path, capsys):
    line = element("line", SLOT, ElementClass.SLOT_LINE)
    path = tmp_path / "yard.geojson"
    write_map(SemanticMap((line,), None, "yard"), path)
    assert main(["slots", str(path)]) == 1
    assert "no parking slots but 1 slot lines" in capsys.readouterr().err
