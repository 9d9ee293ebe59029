"""Pieces of a number painted in a slot are one number; an arrow in the aisle stays a mark."""

import numpy as np
import pytest

from semloc_jax.evaluation import compare_maps
from semloc_jax.mapping.evidence_grid import EvidenceGrid
from semloc_jax.mapping.slot_numbers import numbered, outside_of_rows
from semloc_jax.mapping.slot_rows import MappedRow, RowPlace
from semloc_jax.maps import Belief, MapElement, SemanticMap, read_map, write_map
from semloc_jax.maps.io.drive_geojson import write_drive_geojson
from semloc_jax.structs import ElementClass

TURN = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])


def outline(low, high):
    (x0, y0), (x1, y1) = low, high
    xy = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]) @ TURN.T
    return np.column_stack([xy, np.full(4, 0.2)])


def known(name, label, low, high, logit=1.0):
    return MapElement(name, label, outline(low, high), closed=True), Belief(0.05, 0.05, logit, 5, 0)


SLOT = known("s", ElementClass.PARKING_SLOT, (0.0, 0.0), (2.5, 5.2))
PIECES = [
    known("m0", ElementClass.ROAD_MARK, (0.7, 0.35), (1.1, 0.85), 2.0),
    known("m1", ElementClass.ROAD_MARK, (1.4, 0.40), (1.8, 0.87), 4.0),
]
ARROW = known("a", ElementClass.ROAD_MARK, (1.0, -3.0), (1.4, -1.0))


def test_pieces_in_a_slot_are_its_number(tmp_path):
    marks, numbers = numbered([*PIECES, ARROW], [SLOT])
    assert [mark.id for mark, _ in marks] == ["a"]
    ((number, belief),) = numbers
    np.testing.assert_allclose(number.points, outline((0.7, 0.35), (1.8, 0.87)), atol=1e-9)
    assert belief.existence_logit == 4.0
    assert number.is_logical and not number.is_painted, "no camera is laid by its border"
    for write, name in ((write_map, "m.gpkg"), (write_drive_geojson, "m.geojson")):
        write(SemanticMap((number, ARROW[0]), None, "numbers"), tmp_path / name)
        back = read_map(tmp_path / name).elements
        assert back[0].attributes.get("class") == "slot_number"
        assert back[0].is_logical and not back[1].is_logical
        classes = compare_maps(back, [number, ARROW[0]]).classes
        assert classes["slot_number"].f1 == pytest.approx(1.0) == classes["road_mark"].f1


def test_a_long_mark_in_a_slot_is_no_number():
    long = known("l", ElementClass.ROAD_MARK, (1.0, 0.5), (1.3, 4.5))
    assert numbered([long], [SLOT]) == ([long], [])
    assert numbered([ARROW], []) == ([ARROW], [])


def test_one_stencil_tells_where_numbers_stand_in_slots_of_one_type():
    """Faint looks that make no mark, one in six at strokes over half of the box: five of six slots have a number, its
    middle within 5 cm, its size but for the smear, the sixth has none; pieces that are marks belong to it."""
    rng = np.random.default_rng(5)
    grid = EvidenceGrid(0.04)
    y, x = np.mgrid[0.02:5.2:0.04, 0.02:15.0:0.04]
    u, slot = np.mod(x, 2.5) - 1.25, np.floor(x / 2.5)
    strokes = (np.abs(u) < 0.56) & (np.abs(y - 0.61) < 0.26) & (np.mod(u, 0.16) < 0.08) & (slot != 3)
    xy = np.stack([x.ravel(), y.ravel()], axis=1)
    for _ in range(12):
        shows = rng.random(x.shape) < np.where(strokes, 0.17, 0.002)
        grid.add(xy, np.ones(len(xy)), shows.ravel().astype(int) - 1, np.ones(len(xy), bool))
    slots = []
    for k in range(6):
        corners = np.array([[2.5 * k, 0, 0], [2.5 * k + 2.5, 0, 0], [2.5 * k + 2.5, 5.2, 0], [2.5 * k, 5.2, 0]])
        words = {"kind": "perpendicular"}
        slot = MapElement(f"s{k}", ElementClass.PARKING_SLOT, corners, closed=True, attributes=words)
        slots.append((slot, Belief(0.05, 0.05, 1.0, 5, 0)))
    piece = MapElement("m", ElementClass.ROAD_MARK, [[0.8, 0.4, 0], [1.0, 0.4, 0], [1.0, 0.8, 0]], closed=True)
    marks, numbers = numbered([(piece, slots[0][1])], slots, lambda xy: grid.sums(xy, 0))
    assert marks == []
    assert [number.attributes["slot"] for number, _ in numbers] == ["s0", "s1", "s2", "s4", "s5"]
    for number, _ in numbers:
        low, high = number.points[:, :2].min(axis=0), number.points[:, :2].max(axis=0)
        middle_m = 2.5 * int(number.attributes["slot"][1:]) + 1.25
        np.testing.assert_allclose(0.5 * (low + high), [middle_m, 0.61], atol=0.05)
        np.testing.assert_allclose(high - low, [1.12, 0.52], atol=0.12)


def test_pieces_in_a_row_without_their_slot_are_no_marks():
    """Beside the dividers of a row, too; what is before its entrance, behind its back or long stays a mark."""
    places = tuple(RowPlace(2.5 * k, (f"d{k}",), 0.2) for k in range(3))
    row = MappedRow(np.zeros(2), TURN[:, 0], TURN[:, 1], 0.12, 5.2, places)
    within = [known(f"in{k}", ElementClass.ROAD_MARK, (x, 0.4), (x + 0.3, 0.8)) for k, x in enumerate((-1.4, 0.8, 6.0))]
    outside = [
        known("before", ElementClass.ROAD_MARK, (0.8, -0.6), (1.1, -0.2)),
        known("far", ElementClass.ROAD_MARK, (8.0, 0.4), (8.3, 0.8)),
        known("behind", ElementClass.ROAD_MARK, (0.8, 5.4), (1.1, 5.8)),
        known("long", ElementClass.ROAD_MARK, (0.8, 0.5), (1.1, 4.5)),
    ]
    assert outside_of_rows([*within, *outside, ARROW], [row]) == [*outside, ARROW]
