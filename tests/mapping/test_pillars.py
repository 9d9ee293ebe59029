"""Pillars out of masks drawn along a straight drive: place, sides and direction, with cars before their feet."""

import cv2
import numpy as np
import pytest

from semloc_jax.cameras import PinholeCamera
from semloc_jax.mapping.pillars import corners_of
from semloc_jax.mapping.sightings import RayTable, Sightings
from semloc_jax.mapping.uprights import UprightCounting, uprights_of
from semloc_jax.perception import load_class_table
from semloc_jax.structs import ElementClass

TABLE = load_class_table("drive")
CAMERA = PinholeCamera(300.0, 300.0, 239.5, 149.5, 480, 300)
T_BASE_CAM = np.array([[0, 0, 1, 1.5], [-1, 0, 0, 0], [0, -1, 0, 1.4], [0, 0, 0, 1.0]])
BOXES = (np.array([20.0, 5.0, np.deg2rad(20.0), 0.8, 0.5]), np.array([26.0, -4.5, 0.0, 0.5, 0.5]))
"""Middle x, y [m], direction [rad], length and width [m]."""
HEIGHT_M = 2.6
PILLAR_ID, CAR_ID, ROAD_ID = 23, 7, 1


def pose(x_m):
    T = np.eye(4)
    T[0, 3] = x_m
    return T


def drawn(x_m, with_cars):
    """The mask from a place: what box and car are seen of, the farther first."""
    mask = np.full((300, 480), ROAD_ID, np.uint8)
    for box in sorted(BOXES, key=lambda one: -one[0]):
        fill(mask, corners_of(box), x_m, HEIGHT_M, PILLAR_ID)
        if with_cars:
            towards_way = np.array([0.0, -np.sign(box[1]) * 1.2])
            fill(mask, corners_of(np.array([*(box[:2] + towards_way), 0.0, 4.0, 1.2])), x_m, 1.1, CAR_ID)
    return mask


def fill(mask, corners, x_m, height_m, number):
    p = np.array([[*xy, z] for xy in corners for z in (0.0, height_m)]) - [x_m, 0.0, 0.0] - T_BASE_CAM[:3, 3]
    p = p @ T_BASE_CAM[:3, :3]
    if p[:, 2].min() > 0.5:
        uv = np.rint(p[:, :2] / p[:, 2:] * 300.0 + [239.5, 149.5]).astype(np.int32)
        cv2.fillConvexPoly(mask, cv2.convexHull(uv), number)


@pytest.fixture(scope="module")
def table():
    return RayTable.of(CAMERA, T_BASE_CAM)


def pillars(table, with_cars):
    found = Sightings(TABLE)
    for frame, x_m in enumerate(np.arange(0.0, 24.0, 0.75)):
        found.add(drawn(x_m, with_cars), table, frame, pose(x_m))
    return uprights_of(found.all(), lambda xy: np.zeros(len(xy)))


@pytest.mark.parametrize("with_cars", [False, True])
def test_a_pillar_has_its_corners(table, with_cars):
    """Edges of a pixel at 6 m are 2 cm. Of a face that is turned away both of its ends are seen, if late."""
    made = pillars(table, with_cars)
    assert [u.element.label for u in made] == [ElementClass.PILLAR] * len(BOXES)
    for box in BOXES:
        (upright,) = [u for u in made if np.hypot(*(u.element.points[:, :2].mean(axis=0) - box[:2])) < 0.08]
        points = upright.element.points
        away_m = np.linalg.norm(corners_of(box)[:, None] - points[None, :, :2], axis=2).min(axis=1)
        assert away_m.max() < 0.12
        assert np.abs(points[:, 2]).max() < 0.1
        assert upright.element.height_m == pytest.approx(HEIGHT_M, abs=0.2)


def test_a_pillar_that_is_gone_is_missed_and_one_behind_a_car_is_not(table):
    made = pillars(table, False)

    def counted(mask):
        counting = UprightCounting(made, TABLE)
        counting.add([mask], [table], pose(10.0), 0.0)
        return [(b.num_seen, b.num_missed) for b in counting.beliefs("drive")]

    assert counted(drawn(10.0, False)) == [(1, 0), (1, 0)]
    assert counted(np.full((300, 480), ROAD_ID, np.uint8)) == [(0, 1), (0, 1)]
    assert counted(np.full((300, 480), CAR_ID, np.uint8)) == [(0, 0), (0, 0)]
