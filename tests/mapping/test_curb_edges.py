"""A curb lies where its foot meets the road, whatever of the rest was seen."""

import numpy as np
import pytest

from semloc_jax.mapping.curb_edges import edges_of
from semloc_jax.maps import MapElement
from semloc_jax.structs import ElementClass

WAY = np.column_stack([np.arange(0.0, 60.0), np.full(60, 4.0)])
"""The vehicle drives to the left of the curb, whose foot is at y = 0."""


def curb(start_m, end_m, side_m, height_m=0.0):
    xs = np.arange(start_m, end_m + 1e-9, 1.0)
    points = np.column_stack([xs, np.full(len(xs), side_m), np.full(len(xs), height_m)])
    return MapElement("drawn", ElementClass.CURB, points, width_m=0.3)


def looks_at(foot_m, behind_m, looked_from):
    """Looks at a curb that is smeared over `behind_m` behind its foot; what they reach changes along the road."""

    def at(xy):
        x, y = xy.T
        edge = foot_m(x)
        shows = (y <= edge) & (y > edge - behind_m)
        return np.ones(len(xy)), shows.astype(float), y >= looked_from(x)

    return at


def straight(x):
    return np.zeros_like(x)


@pytest.mark.parametrize("behind_m", [0.15, 0.45, 0.9])
def test_lanes_that_smear_a_curb_differently_lay_it_alike(behind_m):
    looks = looks_at(straight, behind_m, lambda x: np.full_like(x, -2.0))
    (edge,) = edges_of([curb(5, 40, -0.5 * behind_m)], WAY, looks)
    np.testing.assert_allclose(edge.points[:, 1], 0.0, atol=0.015)
    assert edge.width_m == 0.0 and edge.id == "curb_0"
    assert (edge.points[0, 0], edge.points[-1, 0]) == pytest.approx((5.0, 40.0))


def test_the_border_of_what_was_looked_at_moves_no_curb():
    """Frames two metres apart leave teeth: the curb is seen whole in half of them and followed through their middle."""
    teeth = looks_at(straight, 0.5, lambda x: -0.4 + 0.7 * (x % 2.0))
    (edge,) = edges_of([curb(5, 40, -0.2)], WAY, teeth)
    np.testing.assert_allclose(edge.points[:, 1], 0.0, atol=0.015)
    assert edge.length_m == pytest.approx(35.0, abs=0.1)


def test_a_bend_is_followed_and_heights_stay():
    looks = looks_at(lambda x: 0.002 * (x - 20.0) ** 2, 0.5, lambda x: np.full_like(x, -2.0))
    (edge,) = edges_of([curb(5, 35, 0.1, height_m=1.5)], WAY, looks)
    np.testing.assert_allclose(edge.points[:, 1], 0.002 * (edge.points[:, 0] - 20.0) ** 2, atol=0.025)
    np.testing.assert_allclose(edge.points[:, 2], 1.5)


def test_what_was_not_seen_from_the_road_is_no_curb():
    unseen = looks_at(straight, 0.5, lambda x: np.where(x < 20.0, -2.0, 0.02))
    (edge,) = edges_of([curb(5, 40, -0.2)], WAY, unseen)
    assert edge.points[-1, 0] == pytest.approx(20.0, abs=0.6)
    assert edges_of([curb(25, 40, -0.2)], WAY, unseen) == []


def test_a_way_on_the_other_side_sees_the_other_edge():
    looks = looks_at(straight, 0.3, lambda x: np.full_like(x, -2.0))
    (edge,) = edges_of([curb(5, 40, -0.15)], WAY * [1.0, -1.0], looks)
    np.testing.assert_allclose(edge.points[:, 1], -0.3, atol=0.015)


def test_nothing_of_a_crumb_and_nothing_of_nothing():
    looks = looks_at(straight, 0.3, lambda x: np.full_like(x, -2.0))
    assert edges_of([curb(5, 6, -0.15)], WAY, looks) == [] == edges_of([], WAY, looks)
