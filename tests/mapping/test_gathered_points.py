"""Marking points of several frames: paint stays where it is, what light and shape invent does not."""

import numpy as np

from semloc_jax.mapping.gathered_points import PointLook, agreed_points

THRESHOLD = 0.5
EVERYWHERE = lambda places: np.ones(len(places), bool)  # noqa: E731


def look(points, shows=EVERYWHERE):
    """A frame; each point is x, y [m], direction [deg], confidence."""
    x, y, deg, sure = np.array(points, float).reshape(-1, 4).T
    turn = np.deg2rad(deg)
    return PointLook(np.column_stack([x, y]), np.column_stack([np.cos(turn), np.sin(turn)]), sure, shows)


def test_one_look_alone_counts_by_the_threshold_of_the_network():
    places, _ = agreed_points([look([(0, 3, 90, 0.55), (5, 3, 90, 0.45)])], THRESHOLD)
    np.testing.assert_allclose(places, [[0.0, 3.0]])


def test_what_every_look_shows_faintly_counts_and_what_moves_does_not():
    """Paint has 0.45 in each of five frames; a mirrored lamp has 0.9, but half a metre farther on in each."""
    looks = [look([(0.02 * k, 3, 90, 0.45), (4 + 0.5 * k, 3, 90, 0.9)]) for k in range(5)]
    places, inward = agreed_points(looks, THRESHOLD)
    np.testing.assert_allclose(places, [[0.08, 3.0]])  # where the newest frame has it
    np.testing.assert_allclose(inward, [[0.0, 1.0]], atol=1e-12)


def test_a_frame_to_which_the_place_is_hidden_does_not_deny_it():
    nowhere = lambda places: np.zeros(len(places), bool)  # noqa: E731
    hidden, seen = [look([], nowhere)] * 4, look([(0, 3, 90, 0.55)])
    assert len(agreed_points([*hidden, seen], THRESHOLD)[0]) == 1
    assert len(agreed_points([*[look([])] * 4, seen], THRESHOLD)[0]) == 0


def test_directions_of_one_place_are_averaged_and_only_the_newest_frame_says_where():
    looks = [look([(0, 3, 60, 0.8)]), look([(0.1, 3, 120, 0.8)]), look([(0.2, 3, 90, 0.8)])]
    places, inward = agreed_points(looks, THRESHOLD)
    np.testing.assert_allclose(places, [[0.2, 3.0]])
    np.testing.assert_allclose(inward, [[0.0, 1.0]], atol=1e-12)
    assert len(agreed_points([*looks, look([])], THRESHOLD)[0]) == 0
