"""A map judged by worlds that changed: what came and went is known or not, what was invented, what was lost."""

from dataclasses import replace

import numpy as np

from semloc_jax.evaluation.changed_worlds import WorldThings, change_figures, known, pairs_of
from semloc_jax.maps import MapElement


def pole(name, x, y=0.0):
    return MapElement(name, "pole", np.array([[x, y, 0.0], [x, y, 4.0]]), radius_m=0.05)


BEFORE = [pole("stays", 0.0), pole("goes", 10.0), pole("moves", 20.0), pole("trembles", 30.0)]
AFTER = [pole("stays", 0.0), pole("moves", 20.8), pole("trembles", 30.1), pole("comes", 40.0)]
WORLDS = [BEFORE, BEFORE, AFTER, AFTER, AFTER]


def figures(made, removed=(), looked=None, T=None):
    things = WorldThings.of(WORLDS)
    looked = np.ones(things.there.shape, dtype=bool) if looked is None else looked
    return change_figures(made, removed, things, looked, np.eye(4) if T is None else T)


def test_each_thing_is_known_once_and_when_it_was_there():
    things = WorldThings.of(WORLDS)
    assert [e.points[0, 0] for e in things.elements] == [0.0, 10.0, 20.0, 30.0, 20.8, 40.0]
    assert things.there.sum(axis=1).tolist() == [5, 2, 2, 5, 3, 3]


def test_a_right_map_is_right_wherever_it_lies():
    T = np.eye(4)
    T[:2, 3] = [0.0, -5.0]
    found = figures([replace(e, points=e.points + [0.0, 5.0, 0.0]) for e in AFTER], T=T)
    assert (known(found.came, 3), known(found.gone, 3)) == ((2, 2), (2, 2))
    assert known(found.came, 4) == (0, 0)  # nobody has looked so often since
    assert (found.num_invented, found.deleted, found.num_there) == (0, 0, 2)


def test_an_old_map_knows_nothing_and_keeps_what_has_gone():
    found = figures(BEFORE)
    assert (known(found.came, 3), known(found.gone, 3)) == ((0, 2), (0, 2))
    assert (found.num_invented, found.num_old) == (2, 2)


def test_what_was_invented_and_what_was_removed_wrongly_is_counted():
    found = figures([*AFTER[1:], pole("ghost", 70.0)], removed=[pole("stays", 0.1), pole("goes", 10.0)])
    assert (found.num_invented, found.num_old, found.deleted, found.num_there) == (1, 0, 1, 2)
    assert "1 (10 per km), 0 of them were there once; removed and still there: 1 of 2" in found.to_text(100.0)
    unseen = figures(AFTER[1:], removed=[pole("stays", 0.0)], looked=np.zeros((6, 5), dtype=bool))
    assert (unseen.deleted, unseen.num_there) == (0, 0)


def test_pairs_are_one_to_one_of_a_kind_and_near():
    assert pairs_of([pole("a", 0.0), pole("b", 0.2)], [pole("c", 0.15)], 0.4) == [(1, 0)]
    assert pairs_of([pole("a", 0.0)], [replace(pole("c", 0.0), label="sign")], 0.4) == []
