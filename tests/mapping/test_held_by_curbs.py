"""Curbs hold a drive only where no paint does."""

import numpy as np

from semloc_jax.mapping.element_pulls import pieces_of
from semloc_jax.mapping.refining import holding
from semloc_jax.maps import MapElement


def along(name, label, start_m, end_m, aside_m):
    x = np.arange(start_m, end_m + 0.5, 1.0)
    return MapElement(name, label, np.column_stack([x, np.full(len(x), aside_m), np.zeros(len(x))]))


def held_m(*elements):
    """From where to where curbs hold, and what else does."""
    held = holding([piece for element in elements for piece in pieces_of(element)])
    x = np.concatenate([np.zeros(0), *(piece.points[:, 0] for piece in held if piece.label.name == "CURB")])
    return (x.min(), x.max()) if len(x) else None, sum(piece.label.name != "CURB" for piece in held)


CURB, LINE = along("curb", "curb", 0.0, 80.0, 5.0), along("line", "lane_marking", 0.0, 40.0, 1.5)
POLE = MapElement("pole", "pole", np.array([[60.0, 7.0, 0.0], [60.0, 7.0, 4.0]]))


def test_a_curb_beside_paint_holds_nothing_and_beyond_its_end_it_does():
    (first_m, last_m), num = held_m(CURB, LINE, POLE)
    assert 48.0 <= first_m <= 56.0 and last_m == 80.0 and num == 11


def test_where_there_is_no_paint_at_all_curbs_hold():
    assert held_m(CURB, POLE) == ((0.0, 80.0), 1)
    assert held_m(CURB) == ((0.0, 80.0), 0)


def test_nothing_holds_nothing():
    assert holding([]) == []
