"""A pose as six numbers: they survive the way to a pose and back, and mean what they say."""

import numpy as np
import pytest

from semloc_jax.explorer import Placement
from semloc_jax.maps import MapElement, SemanticMap
from semloc_jax.structs import ElementClass

SLOPE_X, SLOPE_Y = 0.06, -0.02


@pytest.fixture(scope="module")
def hill() -> SemanticMap:
    """Lane lines on a plane that climbs 6 % to the east and falls 2 % to the north."""
    x = np.linspace(-40, 40, 81)
    lines = [np.stack([x, np.full_like(x, y), SLOPE_X * x + SLOPE_Y * y], axis=1) for y in (-4.0, 0.0, 4.0)]
    return SemanticMap(
        tuple(MapElement(f"line{i}", ElementClass.LANE_MARKING, p, width_m=0.12) for i, p in enumerate(lines))
    )


def test_six_numbers_survive_the_way_to_a_pose_and_back(hill):
    rng = np.random.default_rng(0)
    for _ in range(50):
        numbers = rng.uniform(-1, 1, 6) * (20, 3, 180, 0.3, 4, 4)
        placement = Placement(*map(float, numbers))
        again = Placement.of(placement.pose(hill), hill)
        np.testing.assert_allclose([*vars(again).values()], numbers, atol=1e-9)


def test_a_car_on_the_road_stands_on_the_plane(hill):
    T = Placement(10.0, 2.0, 90.0).pose(hill)
    assert T[2, 3] == pytest.approx(SLOPE_X * 10 + SLOPE_Y * 2, abs=1e-3)
    normal = np.array([-SLOPE_X, -SLOPE_Y, 1.0]) / np.linalg.norm([SLOPE_X, SLOPE_Y, 1.0])
    # The fit of the road leans a little to the horizontal, where the slope of 3.6 deg is seen over metres only.
    assert np.degrees(np.arccos(T[:3, 2] @ normal)) < 0.3


def test_signs_of_height_pitch_and_roll(hill):
    flat = Placement(0.0, 0.0, 30.0).pose(hill)
    moved = Placement(0.0, 0.0, 30.0, height_m=0.2, pitch_deg=2.0).pose(hill)
    assert moved[2, 3] - flat[2, 3] == pytest.approx(0.2, abs=1e-12)
    nose = (moved @ (3.0, 0, 0, 1))[2] - (flat @ (3.0, 0, 0, 1))[2]
    assert nose == pytest.approx(0.2 - 3.0 * np.sin(np.deg2rad(2.0)), abs=2e-3)
    rolled = Placement(0.0, 0.0, 30.0, roll_deg=2.0).pose(hill)
    left = (rolled @ (0, 1.0, 0, 1))[2] - (flat @ (0, 1.0, 0, 1))[2]
    assert left == pytest.approx(np.sin(np.deg2rad(2.0)), abs=2e-3)  # the left side rises, the right one sinks
