"""Two maps of one place: what is found, what moved, what is missing, whatever their frames."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.evaluation import MapTolerance, compare_maps
from semloc_jax.geometry.rigid import planar_pose
from semloc_jax.maps import MapElement
from semloc_jax.structs import ElementClass


def bar(name, x, y, length=3.0, width=0.5, label=ElementClass.CROSSWALK):
    corners = [[x, y, 0], [x + length, y, 0], [x + length, y + width, 0], [x, y + width, 0]]
    return MapElement(name, label, corners, closed=True)


def dash(name, x, y, length=4.0):
    return MapElement(name, "lane_marking", [[x, y, 0], [x + length, y, 0]], width_m=0.15, style="dashed")


S_M = np.linspace(0.0, 60.0, 121)
LINE = MapElement(
    "line", "lane_marking", np.stack([S_M, -3.0 + 0.002 * S_M**2, 0 * S_M], axis=1), width_m=0.15, style="solid"
)
POLE = MapElement("pole", "pole", [[30, 6, 0], [30, 6, 5]])
SLOT = MapElement(
    "slot", "parking_slot", [[0, 8, 0], [2.5, 8, 0], [2.5, 13, 0], [0, 13, 0]], True, attributes={"occupied": True}
)
TOWN = [*(dash(f"dash{k}", 10.0 * k, 0.0) for k in range(6)), *(bar(f"bar{k}", 62.0, k) for k in range(5))]
TOWN += [LINE, POLE, SLOT]


def moved(elements, T):
    return [element.with_points(element.points @ T[:3, :3].T + T[:3, 3]) for element in elements]


def test_a_map_agrees_with_itself():
    comparison = compare_maps(TOWN, TOWN)
    assert {name: item.f1 for name, item in comparison.classes.items()} == dict.fromkeys(
        ("crosswalk", "dash", "line", "parking_slot", "pole"), 1.0
    )
    assert comparison.classes["parking_slot"].right_words == 1.0
    assert comparison.classes["line"].num_reference == pytest.approx(60.0 / 0.25, abs=2)


def test_errors_are_those_of_the_element():
    shifted = [replace(e, points=e.points + [0.04, 0.03, 0.0]) for e in TOWN]
    classes = compare_maps(shifted, TOWN).classes
    np.testing.assert_allclose(classes["dash"].across_m, 0.03, atol=1e-9)
    np.testing.assert_allclose(classes["dash"].along_m, 0.04, atol=1e-9)
    np.testing.assert_allclose(classes["parking_slot"].across_m, 0.05, atol=1e-9)
    np.testing.assert_allclose(classes["pole"].along_m, 0.05, atol=1e-9)
    # The line turns from 0 to 13.5 deg: across it the shift is 3 cm at its start, 2 cm at its end.
    assert classes["line"].across_m.min() == pytest.approx(0.0195, abs=2e-3)
    assert classes["line"].across_m.max() == pytest.approx(0.03, abs=2e-3)


def test_what_moved_is_missing_or_was_added():
    made = [e for e in TOWN if e.id not in ("dash1", "bar2")] + [bar("ghost", 20.0, -8.0)]
    made = [replace(e, points=e.points + [0.0, 0.4, 0.0]) if e.id == "dash4" else e for e in made]
    classes = compare_maps(made, TOWN).classes
    assert (classes["dash"].missing, classes["dash"].moved) == (("dash1",), (("dash4", "dash4"),))
    assert (classes["crosswalk"].missing, classes["crosswalk"].added) == (("bar2",), ("ghost",))
    assert classes["dash"].recall == pytest.approx(4 / 6)
    assert classes["dash"].precision == pytest.approx(4 / 5)
    assert classes["crosswalk"].f1 == pytest.approx(0.8)


def test_tolerances_are_limits():
    shifted = [replace(e, points=e.points + [0.0, 0.09, 0.0]) for e in TOWN if e.id.startswith("dash")]
    assert compare_maps(shifted, TOWN).classes["dash"].f1 == 1.0
    assert compare_maps(shifted, TOWN, tolerance=MapTolerance(across_m=0.08)).classes["dash"].f1 == 0.0


def test_one_motion_in_the_plane_is_taken_out():
    """One wrong element in a map that is 1.2 m and 1.5 deg off does not pull the others along."""
    T = np.asarray(planar_pose(0.9, -0.8, np.deg2rad(1.5)))
    made = moved([replace(e, points=e.points + [0.0, 0.6, 0.0]) if e.id == "bar4" else e for e in TOWN], T)
    assert compare_maps(made, TOWN).classes["dash"].f1 == 0.0
    comparison = compare_maps(made, TOWN, "se2")
    np.testing.assert_allclose(comparison.T_reference_made @ T, np.eye(4), atol=0.03)
    assert comparison.classes["dash"].f1 == 1.0
    assert comparison.classes["crosswalk"].num_made - comparison.classes["crosswalk"].found_made == 1


def test_a_guess_bridges_frames_far_apart():
    T = np.asarray(planar_pose(500.0, -80.0, 2.0))
    guess = np.asarray(planar_pose(0.3, 0.2, 0.01)) @ np.linalg.inv(T)
    assert compare_maps(moved(TOWN, T), TOWN, "se2", T_reference_made=guess).classes["dash"].f1 == 1.0


def test_what_was_not_looked_at_is_not_missing():
    made = [element for element in TOWN if element.points[:, 0].max() < 35.0]
    half = compare_maps(made, TOWN, seen=lambda points: points[:, 0] < 35.0).classes
    assert half["dash"].recall == 1.0
    assert "crosswalk" not in half
    assert compare_maps(made, TOWN).classes["dash"].recall == pytest.approx(4 / 6)


def test_metrics_name_class_and_unit():
    metrics = {m.key: m for m in compare_maps(TOWN, TOWN).metrics()}
    assert metrics["map.dash.f1"].unit == "share"
    assert metrics["map.line.rms_across"].value == pytest.approx(0.0, abs=1e-9)
    assert metrics["map.parking_slot.occupancy"].value == 1.0


def test_a_class_that_only_one_map_has_scores_nothing():
    classes = compare_maps([POLE], [LINE, POLE]).classes
    assert classes["line"].f1 == 0.0
    assert np.isnan(classes["line"].precision)


def test_an_end_that_nobody_saw_is_not_judged():
    part = replace(dash("dash0", 0.0, 0.0, length=3.4), true_ends=(True, False))
    classes = compare_maps([part], TOWN[:1]).classes
    assert classes["dash"].f1 == 1.0
    np.testing.assert_allclose(classes["dash"].along_m, [0.0], atol=1e-9)
    assert compare_maps([replace(part, true_ends=(True, True))], TOWN[:1]).classes["dash"].f1 == 0.0
