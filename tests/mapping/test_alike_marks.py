"""Worn arrows are made whole by others of their stencil, and by none that is not theirs."""

import numpy as np
import pytest
import shapely

from semloc_jax.mapping.alike_marks import painted_alike
from semloc_jax.maps import MapElement
from semloc_jax.structs import ElementClass

_STRAIGHT = np.array([[0.0, 0.1], [1.9, 0.1], [1.9, 0.4], [3.0, 0.0], [1.9, -0.4], [1.9, -0.1], [0.0, -0.1]])
_BRANCH = np.array([[1.0, -0.1], [1.0, -0.5], [1.3, -0.5], [0.9, -1.0], [0.5, -0.5], [0.8, -0.5], [0.8, -0.1]])
_FORKED = np.concatenate([_STRAIGHT[:-1], _BRANCH, _STRAIGHT[-1:]])
"""Straight on and to the right."""


def _mark(xy: np.ndarray, number: int, rng: np.random.Generator, noise_m: float = 0.01) -> MapElement:
    """An arrow somewhere on a road that rises by 2 %."""
    turn, middle = 0.3 + 0.9 * number, np.array([20.0 * number, 5.0 * (number % 3)])
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    xy = xy @ R.T + middle + rng.normal(0.0, noise_m, xy.shape)
    return MapElement(f"m{number}", ElementClass.ROAD_MARK, np.column_stack([xy, 0.02 * xy[:, 0]]), closed=True)


def _true(xy: np.ndarray, number: int) -> np.ndarray:
    return _mark(xy, number, np.random.default_rng(0), 0.0).points


def _overlap(one: np.ndarray, other: np.ndarray) -> float:
    a, b = (shapely.Polygon(xy[:, :2]) for xy in (one, other))
    return a.intersection(b).area / a.union(b).area


def _cut(xy: np.ndarray, part: shapely.Geometry) -> np.ndarray:
    left = shapely.Polygon(xy).difference(part)
    left = max(getattr(left, "geoms", [left]), key=lambda g: g.area)
    return np.array(left.exterior.coords)[:-1]


@pytest.mark.parametrize("worn", ["tail", "tip", "side"])
def test_a_worn_arrow_is_as_long_as_the_others(worn: str) -> None:
    part = {
        "tail": shapely.box(-1.0, -1.0, 0.6, 1.0),
        "tip": shapely.box(2.7, -1.0, 4.0, 1.0),
        "side": shapely.box(1.8, 0.15, 2.6, 1.0),
    }[worn]
    rng = np.random.default_rng(3)
    marks = [_mark(_STRAIGHT, k, rng) for k in range(4)] + [_mark(_cut(_STRAIGHT, part), 4, rng)]
    before = _overlap(marks[4].points, _true(_STRAIGHT, 4))
    found = painted_alike(marks)
    after = found[4].points
    assert _overlap(after, _true(_STRAIGHT, 4)) > max(0.9, before + 0.02)
    true = _true(_STRAIGHT, 4)
    off_m = np.linalg.norm(after[:, None, :2] - true[None, :, :2], axis=2).min(axis=0)
    assert off_m.max() < 0.04
    np.testing.assert_allclose(after[:, 2], 0.02 * after[:, 0], atol=0.03)
    assert found[4].id == "m4"
    assert all(a is b for a, b in zip(found[:4], marks[:4], strict=True))


def test_arrows_that_all_lack_a_little_are_as_long_as_the_longest() -> None:
    """Each of them fits the first one, whose shaft is the shortest; the larger ones show how long they were painted."""
    rng = np.random.default_rng(4)
    long = _STRAIGHT - [[2.0, 0.0]] * (_STRAIGHT[:, :1] == 0.0)
    lacking_m = [0.18, 0.0, 0.2, 0.15, 0.0, 0.17, 0.19]
    marks = [_mark(_cut(long, shapely.box(-3.0, -1.0, lost - 2.0, 1.0)), k, rng) for k, lost in enumerate(lacking_m)]
    for k, mark in enumerate(painted_alike(marks)):
        tail = _true(long, k)[[0, -1], :2]
        off_m = np.linalg.norm(mark.points[:, None, :2] - tail, axis=2).min(axis=0)
        assert off_m.max() < 0.06, lacking_m[k]
        assert (mark is marks[k]) == (lacking_m[k] == 0.0), lacking_m[k]


def test_arrows_that_lack_the_same_are_no_other_kind() -> None:
    """Three without their tips fit each other: a stencil of their own was made of them."""
    rng = np.random.default_rng(5)
    blunt = _cut(_STRAIGHT, shapely.box(2.5, -1.0, 4.0, 1.0))
    marks = [_mark(_STRAIGHT, k, rng) for k in range(5)] + [_mark(blunt, k, rng) for k in range(5, 8)]
    found = painted_alike(marks)
    for k in range(5, 8):
        assert _overlap(found[k].points, _true(_STRAIGHT, k)) > 0.94 > _overlap(marks[k].points, _true(_STRAIGHT, k))


def test_an_arrow_of_another_kind_stays_as_it_is() -> None:
    rng = np.random.default_rng(5)
    marks = [_mark(_FORKED, k, rng) for k in range(4)] + [_mark(_STRAIGHT, 4, rng)]
    assert painted_alike(marks)[4] is marks[4]


def test_a_mirrored_arrow_is_none_of_the_stencil() -> None:
    rng = np.random.default_rng(6)
    mirrored = _FORKED[::-1] * [1.0, -1.0]
    marks = [_mark(_FORKED, k, rng) for k in range(4)] + [_mark(mirrored, 4, rng)]
    assert painted_alike(marks)[4] is marks[4]


def test_two_stencils_that_explain_a_piece_leave_it() -> None:
    """A long stem without its head may be of a straight arrow or of one that turns; with one stencil it is whole."""
    rng = np.random.default_rng(7)
    stem = np.array([[0.0, 0.15], [4.0, 0.15], [4.0, -0.15], [0.0, -0.15]])
    straight = np.concatenate([stem[:2], [[4.0, 0.3], [4.5, 0.0], [4.0, -0.3]], stem[2:]])
    turning = np.concatenate([stem[:3], [[3.9, -0.15], [3.9, -0.5], [3.6, -0.5], [3.6, -0.15]], stem[3:]])
    marks = [_mark(straight, k, rng) for k in range(3)] + [_mark(stem, 6, rng)]
    assert painted_alike(marks)[-1] is not marks[-1]
    marks = [_mark(turning, k, rng) for k in range(3, 6)] + marks
    assert painted_alike(marks)[-1] is marks[-1]


def test_two_marks_show_no_stencil() -> None:
    rng = np.random.default_rng(8)
    worn = _cut(_STRAIGHT, shapely.box(-1.0, -1.0, 0.7, 1.0))
    marks = [_mark(_STRAIGHT, k, rng) for k in range(2)] + [_mark(worn, 2, rng)]
    assert painted_alike(marks)[2] is marks[2]


def test_what_is_no_outline_is_returned_as_it_is() -> None:
    line = MapElement("l", ElementClass.ROAD_MARK, np.zeros((2, 3)) + [[0.0], [1.0]])
    assert painted_alike([line]) == [line]
    assert painted_alike([]) == []
