"""Paint of a country road without a network: an edge line beside grass in the sun, a seam behind a dash, trunks."""

import numpy as np
import pytest

from semloc_jax.cameras import PinholeCamera
from semloc_jax.perception import ClassicalPaintSegmenter
from semloc_jax.perception.paint_choice import _Numbers, _road_direction
from tests.perception.test_ground_view import pose

CAMERA = PinholeCamera(300.0, 300.0, 239.5, 119.5, 480, 240)
T_BASE_CAM = pose(0.0, 3.0, 1.6)
LINE_M, DASH_M, SEAM_M = (-1.87, -1.73), (1.73, 1.87), (1.785, 1.815)
"""Left and right of the vehicle (y) at which each is painted."""
DASH_X_M, SEAM_X_M = (7.0, 11.0), (11.5, 17.0)
ROAD, WHITE, GRASS = (85.0, 85.0, 85.0), (225.0, 225.0, 225.0), (70.0, 215.0, 215.0)
SEAM_SHARE = 0.25
"""Of the brightness of paint."""


def ground_points(du, dv):
    """Point (x, y) [m] of the road that each pixel sees, and whether it sees any within 30 m; [240 480]."""
    v, u = np.mgrid[:240, :480].astype(float)
    ray = np.asarray(CAMERA.unproject(np.stack([u + du, v + dv], axis=-1))[0]) @ T_BASE_CAM[:3, :3].T
    reach = T_BASE_CAM[2, 3] / np.maximum(-ray[..., 2], 1e-6)
    return T_BASE_CAM[0, 3] + reach * ray[..., 0], T_BASE_CAM[1, 3] + reach * ray[..., 1], reach < 30.0


@pytest.fixture(scope="module")
def shares():
    """Share of each pixel that shows grass, line, dash and seam, float[240 480] each."""
    total = np.zeros((4, 240, 480))
    offsets = (np.arange(6) - 2.5) / 6
    for du in offsets:
        for dv in offsets:
            x, y, near = ground_points(du, dv)
            line = (y > LINE_M[0]) & (y < LINE_M[1])
            dash = (y > DASH_M[0]) & (y < DASH_M[1]) & (x > DASH_X_M[0]) & (x < DASH_X_M[1])
            seam = (y > SEAM_M[0]) & (y < SEAM_M[1]) & (x > SEAM_X_M[0]) & (x < SEAM_X_M[1])
            total += np.stack([y < LINE_M[0], line, dash, seam]) & near
    return total / len(offsets) ** 2


@pytest.fixture(scope="module")
def mask(shares):
    grass, *paint = shares
    image = np.array(ROAD) + grass[..., None] * (np.array(GRASS) - ROAD)
    image += (paint[0] + paint[1] + SEAM_SHARE * paint[2])[..., None] * (np.array(WHITE) - ROAD)
    image += np.random.default_rng(0).normal(0, 2.5, image.shape)
    return ClassicalPaintSegmenter(CAMERA, T_BASE_CAM)(np.clip(image, 0, 255).astype(np.uint8)) == 1


def test_an_edge_line_is_found_beside_grass_that_is_as_bright(mask, shares):
    line = shares[1] > 0.5
    assert line.sum() > 300
    assert mask[line].mean() > 0.8


def test_a_dash_is_found_and_the_seam_behind_it_is_none(mask, shares):
    assert mask[shares[2] > 0.5].mean() > 0.8
    assert mask[shares[3] > 0.15].mean() < 0.1


def test_strokes_along_their_rays_have_no_say_in_where_the_road_goes():
    """Six trunks in the sun, longer and brighter than the two lines, at 122 deg; the lines run at 89 deg."""
    trunk = np.arange(8) < 6
    nothing = np.zeros(8)
    numbers = _Numbers(
        length_m=np.where(trunk, 10.0, 8.0),
        scatter_m=nothing,
        width_scatter=nothing,
        contrast=np.where(trunk, 1.5, 0.6),
        width_m=nothing,
        rise_m=nothing,
        middle=np.zeros((8, 2)),
        angle=np.deg2rad(np.where(trunk, 122.0, 89.0)),
        across_px_m=nothing,
        along_px_m=nothing,
    )
    distance_m = np.full(8, 15.0)
    alone = np.zeros(8, bool)
    assert np.degrees(_road_direction(numbers, distance_m, np.ones(8, bool), trunk)) == pytest.approx(89.0)
    assert np.degrees(_road_direction(numbers, distance_m, np.ones(8, bool), ~alone)) == pytest.approx(122.0)
    assert _road_direction(numbers, distance_m, alone, trunk) is None
