"""Contours of painted and upright things: where they must lie, and where there must be none."""

import numpy as np
import pytest
import shapely

from semloc_jax.errors import SemlocError
from semloc_jax.maps import MapElement, SemanticMap, sample
from semloc_jax.maps.contours import painted_polygon
from semloc_jax.structs import ElementClass, SampleKind

ORIGIN_XY = (0.0, 0.0)


def _line(points, width=0.2, name="line", label=ElementClass.LANE_MARKING, **values) -> MapElement:
    return MapElement(name, label, np.array(points, dtype=float), width_m=width, **values)


def _area(x0, y0, x1, y1, name="area", label=ElementClass.SLOT_LINE, z=0.0) -> MapElement:
    points = [[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]
    return MapElement(name, label, np.array(points, dtype=float), closed=True)


def _sampled(elements, spacing=0.05):
    """Positions in the map frame and the rows of the samples of a few elements."""
    local = SemanticMap(tuple(elements)).whole()
    samples = sample(local, spacing)
    rows = np.flatnonzero(samples.valid)
    position = np.asarray(samples.p_map, dtype=np.float64)[rows] + local.origin_map
    return position, {name: np.asarray(getattr(samples, name))[rows] for name in ("element", "kind", "offset_m")} | {
        "length_m": np.asarray(samples.length_m, dtype=np.float64)[rows],
        "tangent_map": np.asarray(samples.tangent_map)[rows],
        "center_map": np.asarray(samples.center_map, dtype=np.float64)[rows] + local.origin_map,
        "label": np.asarray(samples.label)[rows],
    }


def _assert_on_union_outline(elements, spacing=0.02, tolerance_m=0.001):
    """All samples lie on the outline of the union of the paint, and all of that outline is sampled."""
    position, columns = _sampled(elements, spacing)
    outline = shapely.unary_union([painted_polygon(element).buffer(1e-4) for element in elements]).boundary
    distance = shapely.distance(outline, shapely.points(position[:, :2]))
    assert distance.max() < tolerance_m
    assert columns["length_m"].sum() == pytest.approx(outline.length, abs=4 * spacing * len(elements))
    return position


def test_both_edges_of_a_line_lie_half_its_width_aside():
    curve = [[x, 0.02 * x**2, 0.01 * x] for x in np.linspace(0, 20, 40)]
    position, columns = _sampled([_line(curve, width=0.3)])
    distance = shapely.distance(shapely.LineString(np.array(curve)[:, :2]), shapely.points(position[:, :2]))
    is_cap = np.abs(distance - 0.15) > 1e-3
    assert columns["length_m"][is_cap].sum() <= 2 * 0.3 + 0.1
    assert columns["length_m"].sum() == pytest.approx(2 * shapely.LineString(curve).length + 2 * 0.3, rel=2e-3)
    np.testing.assert_allclose(position[:, 2], 0.01 * position[:, 0], atol=0.003)


def test_a_dash_has_caps_and_its_outline_is_closed():
    _assert_on_union_outline([_line([[0, 0, 0], [4, 0, 0]], width=0.15)], 0.01)


def test_an_end_cut_by_the_query_has_no_cap():
    road = SemanticMap((_line([[-100, 0, 0], [100, 0, 0]], width=0.2),))
    local = road.query((0.0, 0.0), 30.0)
    samples = sample(local, 0.1)
    across = np.abs(np.asarray(samples.tangent_map)[np.asarray(samples.valid), 1]) > 0.5
    assert not across.any()
    assert float(np.asarray(samples.length_m).sum()) == pytest.approx(2 * 60.0, rel=1e-6)


def test_pieces_of_one_line_have_no_caps_where_they_join():
    one = _line([[0, 0, 0], [5, 0, 0]], name="one")
    two = _line([[5.03, 0, 0], [9, 0.2, 0]], name="two")
    position, columns = _sampled([one, two], 0.02)
    across = np.abs(columns["tangent_map"][:, 1]) > 0.7
    assert position[across, 0].min() == pytest.approx(0.0, abs=1e-6)
    assert set(np.round(position[across, 0])) == {0.0, 9.0}


def test_pieces_of_different_width_keep_their_caps():
    one = _line([[0, 0, 0], [5, 0, 0]], width=0.1, name="one")
    two = _line([[5, 0, 0], [9, 0, 0]], width=0.3, name="two")
    _assert_on_union_outline([one, two])


def test_t_junction_of_touching_bars_is_open():
    back, divider = _area(0, 5, 10, 5.12, "back"), _area(4, 0, 4.12, 5, "divider")
    position = _assert_on_union_outline([back, divider])
    inside_joint = (np.abs(position[:, 1] - 5) < 1e-3) & (position[:, 0] > 4.01) & (position[:, 0] < 4.11)
    assert not inside_joint.any()


def test_overlapping_parts_of_an_arrow_have_one_outline():
    shaft = _area(0, -0.1, 3, 0.1, "shaft", ElementClass.ROAD_MARK)
    head = MapElement("head", ElementClass.ROAD_MARK, np.array([[2.5, -0.5, 0], [4, 0, 0], [2.5, 0.5, 0]]), closed=True)
    _assert_on_union_outline([shaft, head], 0.01)


def test_crossing_lines_of_one_class_have_the_outline_of_a_cross():
    _assert_on_union_outline([_line([[-3, 0, 0], [3, 0, 0]]), _line([[0, -3, 0], [0.5, 3, 0]], name="other")])


def test_another_class_hides_nothing():
    line = _line([[0, 0, 0], [10, 0, 0]])
    stop = _area(9.8, -2, 10.2, 2, "stop", ElementClass.STOP_LINE)
    alone, together = _sampled([line])[1]["length_m"].sum(), _sampled([line, stop])[1]
    assert together["length_m"][together["label"] == ElementClass.LANE_MARKING].sum() == pytest.approx(alone, rel=1e-6)


def test_an_element_entered_twice_is_sampled_once():
    once = _sampled([_area(0, 0, 4, 1)])[1]["length_m"].sum()
    twice = _sampled([_area(0, 0, 4, 1), _area(0, 0, 4, 1, "again")])[1]["length_m"].sum()
    assert twice == pytest.approx(once, rel=1e-6)


def test_paint_on_a_bridge_hides_nothing_below():
    below = _line([[-50, 0, 0.0], [50, 0, 0.0]])
    above = _line([[0, -50, 5.5], [0, 50, 5.5]], name="above")
    lengths = _sampled([below, above])[1]["length_m"].sum()
    assert lengths == pytest.approx(2 * 2 * 100 + 4 * 0.2, rel=1e-6)


def test_the_direction_of_an_outline_does_not_matter():
    bar = _area(0, 0, 3, 0.5)
    turned = MapElement("turned", bar.label, bar.points[::-1], closed=True)
    side = _area(3, 0, 6, 0.5, "side")
    assert _sampled([bar, side])[1]["length_m"].sum() == pytest.approx(_sampled([turned, side])[1]["length_m"].sum())


def test_a_pole_has_two_sides_that_taper_and_no_caps():
    pole = MapElement("pole", ElementClass.POLE, np.array([[3, 4, 1], [3, 4, 9.0]]), radius_m=0.1, radius_top_m=0.06)
    position, columns = _sampled([pole], 0.2)
    assert (columns["kind"] == SampleKind.ROUND).all()
    np.testing.assert_allclose(position[:, :2], [[3, 4]] * len(position), atol=1e-6)
    expected = 0.1 - 0.04 * (position[:, 2] - 1) / 8
    np.testing.assert_allclose(np.abs(columns["offset_m"]), expected, atol=1e-6)
    assert (columns["offset_m"] > 0).sum() == (columns["offset_m"] < 0).sum() == 40
    np.testing.assert_allclose(columns["tangent_map"], [[0, 0, 1]] * len(position), atol=1e-6)


def test_a_pillar_has_four_vertical_edges_with_their_bisectors():
    base = np.array([[1, 1, 0.1], [1.6, 1, 0.1], [1.6, 1.8, 0.1], [1, 1.8, 0.1]])
    pillar = MapElement("pillar", ElementClass.PILLAR, base, closed=True, height_m=2.5)
    position, columns = _sampled([pillar], 0.25)
    assert (columns["kind"] == SampleKind.CORNER).all()
    assert len(position) == 4 * 10
    inward = columns["center_map"] - position
    np.testing.assert_allclose(np.abs(inward[:, :2]), 0.5 * np.sqrt(0.5), atol=1e-6)  # 45 deg to both faces
    assert (inward[:, :2] * ([1.3, 1.4] - position[:, :2]) > 0).all()
    np.testing.assert_allclose(inward[:, 2], 0.0, atol=1e-6)
    np.testing.assert_allclose(columns["offset_m"], 0.5 * np.sqrt(0.5), atol=1e-6)
    assert position[:, 2].min() > 0.1 and position[:, 2].max() < 2.6


def test_signs_lights_cones_guardrails_and_curbs():
    sign = MapElement("s", ElementClass.SIGN, np.array([[0, 0, 2], [0, 1, 2], [0, 0.5, 3.0]]), closed=True)
    light = MapElement("l", ElementClass.TRAFFIC_LIGHT, np.array([[5, 0, 2], [5, 0, 3.0]]), width_m=0.3)
    cone = MapElement("c", ElementClass.CONE, np.array([[9, 0, 0], [9, 0, 0.7]]), radius_m=0.15, radius_top_m=0.03)
    rail = MapElement("r", ElementClass.GUARDRAIL, np.array([[0, 9, 0.6], [10, 9, 0.6]]), height_m=0.75)
    curb = MapElement("k", ElementClass.CURB, np.array([[0, -9, 0], [10, -9, 0.0]]))
    position, columns = _sampled([sign, light, cone, rail, curb], 0.1)
    of = [columns["element"] == index for index in range(5)]
    assert columns["length_m"][of[0]].sum() == pytest.approx(1 + 2 * np.hypot(0.5, 1), rel=1e-6)
    assert (np.abs(columns["offset_m"][of[1]]) == np.float32(0.15)).all()
    assert np.abs(columns["offset_m"][of[2]]).max() < 0.15 and position[of[2], 2].min() > 0.05
    assert set(np.round(position[of[3], 2] - 0.6, 3)) == {-0.175, 0.175}
    assert columns["length_m"][of[4]].sum() == pytest.approx(10.0)
    assert [int(columns["kind"][rows][0]) for rows in of] == [0, 1, 1, 0, 0]


def test_logical_elements_have_no_contour():
    lane = _line([[0, 0, 0], [9, 0, 0]], style="virtual")
    slot = _area(0, 0, 3, 5, "slot", ElementClass.PARKING_SLOT)
    assert len(_sampled([lane, slot])[0]) == 0


def test_padding_is_marked_and_capacity_is_kept():
    local = SemanticMap((_line([[0, 0, 0], [10, 0, 0]]),)).whole()
    samples = sample(local, 0.5)
    count = int(np.asarray(samples.valid).sum())
    assert samples.p_map.shape == (256, 3) and count == 42
    assert (np.asarray(samples.element)[count:] == -1).all()
    assert float(np.abs(np.asarray(samples.length_m)[count:]).sum()) == 0.0
    assert sample(local, 0.5, capacity=64).p_map.shape == (64, 3)
    with pytest.raises(SemlocError, match="42 map samples do not fit a capacity of 8"):
        sample(local, 0.5, capacity=8)
    with pytest.raises(SemlocError, match="expected a positive number"):
        sample(local, 0.0)


def test_positions_are_exact_far_from_the_map_origin():
    far = np.array([412345.0, 5412345.0, 300.0])
    line = _line(np.array([[0, 0, 0], [10.0, 3, 0.2]]) + far)
    local = SemanticMap((line,)).query(far, 30.0)
    samples = sample(local, 0.25)
    position = np.asarray(samples.p_map, dtype=np.float64)[np.asarray(samples.valid)] + local.origin_map
    outline = painted_polygon(line).boundary
    assert shapely.distance(outline, shapely.points(position[:, :2])).max() < 1e-5


def test_the_part_of_a_pole_behind_its_sign_is_left_out():
    pole = MapElement("p", ElementClass.POLE, np.array([[0, 0, 0], [0, 0, 3.0]]), radius_m=0.04, radius_top_m=0.04)
    far = MapElement("q", ElementClass.POLE, np.array([[2, 0, 0], [2, 0, 3.0]]), radius_m=0.04, radius_top_m=0.04)
    plate = np.array([[0.06, -0.35, 2.0], [0.06, 0.35, 2.0], [0.06, 0.35, 2.7], [0.06, -0.35, 2.7]])
    sign = MapElement("s", ElementClass.SIGN, plate, closed=True)
    position, columns = _sampled([pole, far, sign], 0.1)
    height = position[columns["element"] == 0, 2]
    assert not ((height > 2.0) & (height < 2.7)).any() and len(height) == 2 * 23
    assert (columns["element"] == 1).sum() == 60
