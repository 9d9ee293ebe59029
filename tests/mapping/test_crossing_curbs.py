"""Curbs that cross are of what stands on the road."""

import numpy as np
import pytest

from semloc_jax.mapping.crossing_curbs import uncrossed
from semloc_jax.maps import MapElement
from semloc_jax.structs import ElementClass


def curb(name, *xy):
    return MapElement(name, ElementClass.CURB, np.array([(x, y, 0.0) for x, y in xy]), width_m=0.3)


def star(middle, num=3, length_m=1.8):
    """What masks show of a wheel stop from `num` places, drawn on the road behind it."""
    angles = np.linspace(0.3, 2.2, num)
    ends = [0.5 * length_m * np.array([np.cos(a), np.sin(a)]) for a in angles]
    return [curb(f"star{k}", tuple(middle - e), tuple(middle + e)) for k, e in enumerate(ends)]


def test_a_star_of_lines_goes_and_curbs_beside_it_stay():
    straight = curb("street", (0, 3), (15, 3))
    corner = [curb("along", (0, -3), (20, -3)), curb("across", (20.1, -3.1), (20.1, 10))]
    kept = uncrossed([straight, *star(np.array([5.0, 0.0])), *corner])
    assert [c.id for c in kept] == ["street", "along", "across"]


def test_a_long_curb_is_not_lost_for_a_short_one_that_crosses_it():
    kept = uncrossed([curb("street", (0, 0), (30, 0)), curb("false", (9, -1), (11, 1))])
    assert [c.id for c in kept] == ["street"]


def test_a_border_that_was_drawn_twice_stays_although_both_cross():
    twice = [curb("one", (0, 0), (10, 0.3), (20, 0)), curb("two", (0, 0.2), (10, 0), (20, 0.3))]
    assert uncrossed(twice) == twice


@pytest.mark.parametrize("curbs", [[], [curb("alone", (0, 0), (4, 0))]])
def test_few_curbs(curbs):
    assert uncrossed(curbs) == curbs
