"""The prior of a solve stands on the road where the search ended, not where the first guess was."""

import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.alignment.pose import Prior
from semloc_jax.alignment.pose_prior import RoadSigmas, levelled
from semloc_jax.geometry import rigid
from semloc_jax.geometry.local_frame import LocalFrame
from semloc_jax.maps import MapElement, RoadSpread, SemanticMap
from semloc_jax.structs import ElementClass

SLOPE = 0.03


def crowned_road() -> SemanticMap:
    x = np.linspace(-60.0, 60.0, 121)
    lines = [
        MapElement(
            f"line{y}",
            ElementClass.LANE_MARKING,
            np.column_stack([x, np.full_like(x, y), np.full_like(x, 50.0 - SLOPE * abs(y))]),
            width_m=0.12,
        )
        for y in (-3.5, 0.0, 3.5)
    ]
    return SemanticMap(tuple(lines))


def roll_deg(T: np.ndarray) -> float:
    return float(np.degrees(np.arctan2(T[2, 1], T[2, 2])))


def test_a_lane_aside_the_prior_leans_the_other_way_and_keeps_its_place():
    road, frame = crowned_road(), LocalFrame(np.array([0.0, 0.0, 50.0]))
    guess = road.road_pose(2.0, 1.75, 0.05)
    prior = Prior(jnp.asarray(frame.from_map(guess)), jnp.asarray([2.0, 2.0, 0.03, 0.01, 0.01, 0.05], jnp.float32))
    found = frame.from_map(road.road_pose(3.0, -1.75, 0.0))
    T, around = levelled(found, prior, road, frame, RoadSigmas())
    centre = np.asarray(around.T_local_base, np.float64)
    assert roll_deg(guess) == pytest.approx(-np.degrees(np.arctan(SLOPE)), abs=0.2)
    assert roll_deg(centre) == pytest.approx(np.degrees(np.arctan(SLOPE)), abs=0.2)
    np.testing.assert_allclose(centre[:2, 3], guess[:2, 3], atol=0.01)
    assert rigid.log(rigid.inverse(found) @ T)[3] == pytest.approx(0.0, abs=1e-3)
    # On a crowned road the roll is open by the crown, a locked direction stays locked.
    assert np.degrees(float(around.sigma[3])) > 1.0
    np.testing.assert_array_equal(around.sigma[jnp.array([0, 1, 5])], prior.sigma[jnp.array([0, 1, 5])])


def test_a_locked_direction_stays_locked_on_any_road():
    sigma = RoadSigmas(height_m=0.0, roll_pitch_deg=0.5).on(RoadSpread(0.05, 0.02, 0.0))
    assert sigma[0] == 0.0
    np.testing.assert_allclose(np.degrees(sigma[1:]), [np.hypot(0.5, np.degrees(0.02)), 0.5])


def test_without_road_at_the_pose_nothing_is_changed():
    road, frame = crowned_road(), LocalFrame(np.zeros(3))
    prior = Prior(jnp.eye(4), jnp.ones(6))
    far = np.eye(4, dtype=np.float32)
    far[0, 3] = 900.0
    T, around = levelled(far, prior, road, frame, RoadSigmas())
    assert T is far and around is prior
