"""Nothing of one class lies over another: what was drawn twice is once, neighbours stay."""

import numpy as np

from semloc_jax.mapping.twins import without_twins
from semloc_jax.maps import Belief, MapElement


def known(name, label, points, num_seen=5, **more):
    return MapElement(name, label, np.array(points, float), **more), Belief(0.05, 0.05, 1.0, num_seen, 0)


def line(name, start, end, num_seen=5):
    return known(name, "slot_line", [[*start, 0.0], [*end, 0.0]], num_seen, width_m=0.12)


def box(name, label, x, y, size, **more):
    corners = [[x, y, 0.0], [x + size, y, 0.0], [x + size, y + size, 0.0], [x, y + size, 0.0]]
    return known(name, label, corners, closed=True, **more)


def names(found):
    return [element.id for element, _ in found]


def test_a_line_followed_twice_is_one():
    """The longer of two that lie on each other, the one seen more often of two alike, not a piece askew across it."""
    long = line("long", (0.0, 0.0), (5.2, 0.0))
    assert names(without_twins([line("short", (0.4, 0.01), (1.0, 0.0)), long])) == ["long"]
    assert names(without_twins([line("seen", (0.0, 0.0), (0.6, 0.0), 8), line("less", (0.0, 0.02), (0.6, 0.02))])) == [
        "seen"
    ]
    assert names(without_twins([line("askew", (0.0, -0.05), (0.8, 0.08)), long])) == ["long"]


def test_what_meets_or_lies_beside_stays():
    """Dividers of rows back to back that overlap at the back, a bar at a mouth, a double line, other classes."""
    both = [line("a", (0.0, 0.0), (5.2, 0.0)), line("b", (10.0, 0.01), (4.0, 0.01))]
    bar, beside = line("bar", (0.0, -0.5), (0.0, 0.5)), line("double", (0.0, 0.25), (5.2, 0.25))
    on_both = [line("first", (0.0, 9.0), (40.0, 9.0)), line("goes on", (20.0, 9.02), (52.0, 9.02))]
    assert names(without_twins(on_both)) == ["first", "goes on"]
    stop = known("stop", "stop_line", both[0][0].points, width_m=0.3)
    assert names(without_twins([*both, bar, beside, stop])) == ["a", "b", "bar", "double", "stop"]
    assert without_twins([]) == []


def test_every_class_is_once_in_a_place():
    """Pillars and marks that overlap, posts in one place; boards above each other on one post are two."""
    for label, more in (("pillar", {"height_m": 2.5}), ("road_mark", {}), ("crosswalk", {})):
        found = without_twins([box("one", label, 0.0, 0.0, 0.7, **more), box("twin", label, 0.2, 0.05, 0.6, **more)])
        assert names(found) == ["one"], label
        assert (
            len(without_twins([box("one", label, 0.0, 0.0, 0.7, **more), box("b", label, 0.5, 0.0, 0.7, **more)])) == 2
        )
    pole = [[3.0, 1.0, 0.0], [3.0, 1.0, 3.0]]
    poles = [
        known("p", "pole", pole, 9, radius_m=0.05),
        known("q", "pole", np.array(pole) + [0.02, 0, 0], radius_m=0.05),
    ]
    assert names(without_twins(poles)) == ["p"]
    board = np.array([[0.0, 0.0, 2.0], [0.6, 0.0, 2.0], [0.6, 0.0, 2.6], [0.0, 0.0, 2.6]])
    hung = [
        known(name, "sign", board + [0.0, 0.0, up_m], closed=True, normal=np.array([0.0, 1.0, 0.0]), shape="rectangle")
        for name, up_m in (("low", 0.0), ("above", 0.7), ("twin", 0.1))
    ]
    assert names(without_twins(hung)) == ["low", "above"]
