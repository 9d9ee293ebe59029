"""Poles, signs and traffic lights out of masks drawn along a straight drive, to a few centimetres, and no ghosts."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.cameras import PinholeCamera
from semloc_jax.mapping.sightings import RayTable, Sightings
from semloc_jax.mapping.uprights import UprightCounting, uprights_of
from semloc_jax.perception import load_class_table
from semloc_jax.structs import ElementClass

TABLE = load_class_table("drive")
CAMERA = PinholeCamera(400.0, 400.0, 239.5, 149.5, 480, 300)
T_BASE_CAM = np.array([[0, 0, 1, 1.5], [-1, 0, 0, 0], [0, -1, 0, 1.4], [0, 0, 0, 1.0]])
POLES = {"lamp": (30.0, 5.0, 0.2, 5.5, 0.1), "post": (41.0, -4.0, 0.0, 2.0, 0.05), "mast": (55.0, 6.0, 0.1, 6.0, 0.12)}
SIGN = (36.0, -5.0, 2.2, 0.7)
"""x, y, z of its middle and side of a square board that faces the drive [m]."""
POLE_ID, SIGN_ID, CAR_ID, ROAD_ID, PILLAR_ID = 20, 21, 7, 1, 23


def pose(x_m):
    T = np.eye(4)
    T[0, 3] = x_m
    return T


def drawn(x_m, rng=None):
    """The mask from a place on the road: every pole by its sides, row for row, and the board."""
    mask = np.full((300, 480), ROAD_ID, np.uint8)
    columns, rows = np.meshgrid(np.arange(480), np.arange(300))
    for x, y, low, high, radius in POLES.values():
        ahead = x - x_m - T_BASE_CAM[0, 3]
        if ahead < 1.0:
            continue
        u, half = 239.5 - 400.0 * y / ahead, 400.0 * radius / ahead
        if rng is not None:
            u += rng.normal(0.0, 0.5)
        top, foot = (149.5 + 400.0 * (1.4 - z) / ahead for z in (high, low))
        mask[(np.abs(columns - u) <= half + 0.3) & (rows >= top) & (rows <= foot)] = POLE_ID
    x, y, z, side = SIGN
    ahead = x - x_m - T_BASE_CAM[0, 3]
    if ahead > 1.0:
        u, v, half = 239.5 - 400.0 * y / ahead, 149.5 + 400.0 * (1.4 - z) / ahead, 200.0 * side / ahead
        mask[(np.abs(columns - u) <= half) & (np.abs(rows - v) <= half)] = SIGN_ID
    return mask


@pytest.fixture(scope="module")
def table():
    return RayTable.of(CAMERA, T_BASE_CAM)


@pytest.fixture(scope="module")
def sightings(table):
    rng, found = np.random.default_rng(1), Sightings(TABLE)
    for frame, x_m in enumerate(np.arange(0.0, 50.0, 1.0)):
        found.add(drawn(x_m, rng), table, frame, pose(x_m))
    return found


@pytest.fixture(scope="module")
def uprights(sightings):
    return uprights_of(sightings.all(), lambda xy: np.zeros(len(xy)))


def test_poles_stand_where_they_stand(uprights):
    made = [u for u in uprights if u.element.label == ElementClass.POLE]
    assert len(made) == len(POLES)
    for x, y, low, high, radius in POLES.values():
        upright = min(made, key=lambda u: np.hypot(*(u.element.points[0, :2] - (x, y))))
        off_m = np.hypot(*(upright.element.points[0, :2] - (x, y)))
        assert off_m < 0.06
        assert off_m < 3.5 * upright.sigma_m
        assert upright.element.points[0, 2] == pytest.approx(low, abs=0.1)
        assert upright.element.points[1, 2] == pytest.approx(high, abs=0.25)
        assert upright.element.radius_m == pytest.approx(radius, abs=0.02)


def test_a_board_has_its_place_size_shape_and_face(uprights):
    (sign,) = [u.element for u in uprights if u.element.label == ElementClass.SIGN]
    np.testing.assert_allclose(sign.points.mean(axis=0), SIGN[:3], atol=0.06)
    assert sign.shape == "rectangle"
    assert np.ptp(sign.points[:, 2]) == pytest.approx(SIGN[3], abs=0.06)
    assert sign.normal[0] < -0.9


def test_what_is_not_there_is_missed_and_what_is_hidden_is_not(table, uprights):
    """A car before everything says nothing; a second drive past a bare road says that all is gone."""
    counting = UprightCounting(uprights, TABLE)
    for x_m in np.arange(0.0, 34.0, 1.0):
        counting.add([drawn(x_m)], [table], pose(x_m), x_m)
    before = counting.beliefs("drive")
    assert all(b.existence > 0.99 and b.num_missed == 0 and b.num_seen >= 4 for b in before)
    counting.add([np.full((300, 480), CAR_ID, np.uint8)], [table], pose(20.0), 20.0)
    assert [b.num_missed for b in counting.beliefs("drive")] == [0] * len(before)
    for x_m in np.arange(0.0, 34.0, 1.0):
        counting.add([np.full((300, 480), ROAD_ID, np.uint8)], [table], pose(x_m), x_m)
    after = counting.beliefs("drive")
    assert all(b.num_missed >= b.num_seen for b in after)
    assert not counting.stays().any()


def test_a_board_from_aside_far_away_or_behind_a_pillar_is_not_missed(table, uprights):
    """Bare road at a board of 0.7 m is a miss from 14 m, none where it is seen along its face or is 2 px high; nor is a
    pillar."""
    (board,) = [u for u in uprights if u.element.label == ElementClass.SIGN]
    bare, pillar = (np.full((300, 480), number, np.uint8) for number in (ROAD_ID, PILLAR_ID))

    def missed(mask, T, element=board.element):
        counting = UprightCounting([replace(board, element=element)], TABLE)
        counting.add([mask], [table], T, 0.0)
        return counting.beliefs("drive")[0].num_missed

    small = replace(board.element, points=SIGN[:3] + 0.08 * (board.element.points - SIGN[:3]))
    aside = replace(board.element, normal=np.array([0.336, 0.942, 0.0]))
    assert missed(bare, pose(22.0)) == 1
    assert missed(bare, pose(22.0), small) == missed(bare, pose(22.0), aside) == missed(pillar, pose(22.0)) == 0


def test_bearings_to_different_things_are_no_thing(table):
    """Posts that stand up somewhere else in every frame: what few cross is not seen there again."""
    rng, found, masks = np.random.default_rng(4), Sightings(TABLE), []
    for frame, x_m in enumerate(np.arange(0.0, 40.0, 1.0)):
        mask = np.full((300, 480), ROAD_ID, np.uint8)
        for u in rng.integers(5, 475, 3):
            mask[120:200, u : u + 3] = POLE_ID
        masks.append((x_m, mask))
        found.add(mask, table, frame, pose(x_m))
    counting = UprightCounting(uprights_of(found.all(), lambda xy: np.zeros(len(xy))), TABLE)
    for x_m, mask in masks:
        counting.add([mask], [table], pose(x_m), x_m)
    assert not counting.stays().any()


def test_what_leaves_memory_is_still_seen(sightings, table, tmp_path):
    stored, again = Sightings(TABLE), Sightings(TABLE)
    for k, x_m in enumerate((10.0, 12.0)):
        stored.add(drawn(x_m), table, k, pose(x_m))
        stored.store(tmp_path / f"{k}.npz")
        again.attach(tmp_path / f"{k}.npz")
    assert len(again.all()) > 4
    assert len(stored.all()) == 0
    assert set(again.all()[:, 1]) == {0.0, 1.0}


def test_one_frame_alone_makes_no_thing(table):
    """No cell has votes of two frames: nothing stands anywhere."""
    seen = Sightings(TABLE)
    seen.add(drawn(0.0), table, 0, pose(0.0))
    assert len(seen.all()) > 0
    assert uprights_of(seen.all(), lambda xy: np.zeros(len(xy))) == []


@pytest.mark.parametrize("pole_m, num_boards", [(0.1, 1), (0.3, 2)])
def test_a_board_cut_by_its_own_pole_is_one(table, pole_m, num_boards):
    """Seen from behind; what is cut by more than is left to either side may be two boards."""
    x, y, z, side = SIGN
    found = Sightings(TABLE)
    for frame, x_m in enumerate(np.arange(0.0, 30.0, 1.0)):
        mask, ahead = drawn(x_m), x - x_m - T_BASE_CAM[0, 3]
        columns, rows = np.meshgrid(np.arange(480), np.arange(300))
        beside = np.abs(columns - (239.5 - 400.0 * y / ahead)) <= 200.0 * pole_m / ahead
        mask[beside & (rows >= 149.5 + 400.0 * (1.0 - z) / ahead) & (mask != CAR_ID)] = POLE_ID
        found.add(mask, table, frame, pose(x_m))
    boards = [u for u in uprights_of(found.all(), lambda xy: np.zeros(len(xy))) if u.element.label == ElementClass.SIGN]
    assert len(boards) == num_boards
    if num_boards == 1:
        points = boards[0].element.points
        assert np.hypot(*(points.mean(axis=0)[:2] - (x, y))) < 0.15
        assert np.linalg.norm(np.ptp(points[:, :2], axis=0)) == pytest.approx(side, abs=0.12)


def test_a_board_that_was_seen_from_both_sides_faces_them():
    """As many looks from either side, all of them from one side of the aisle: not across it, where it is an edge."""
    rows, height = [], lambda range_m: (np.arctan2(0.4, range_m), np.arctan2(1.0, range_m))
    for frame, x_m in enumerate([*np.arange(3.0, 12.0), *-np.arange(3.0, 12.0)]):
        range_m, bearing = np.hypot(x_m, 2.0), np.arctan2(-2.0, -x_m)
        width = 0.6 * abs(x_m) / range_m**2
        rows.append([ElementClass.SIGN, frame, x_m, 2.0, 1.5, bearing, 0.003, *height(range_m), width, 1.0, 1.0, 1.0])
    (board,) = uprights_of(np.array(rows, float), lambda xy: np.zeros(len(xy)))
    np.testing.assert_allclose(board.element.points.mean(axis=0), [0.0, 0.0, 2.2], atol=0.02)
    assert abs(board.element.normal[0]) > 0.99
    assert np.ptp(board.element.points[:, 1]) == pytest.approx(0.6, abs=0.06)
