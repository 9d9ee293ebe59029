"""What a map says of the errors that all elements around a place share."""

import numpy as np
import pytest

from semloc_jax.geometry import rigid
from semloc_jax.mapping.way_sigmas import WaySigmas, places_apart, way_sigmas, with_size
from semloc_jax.maps import Belief, BeliefMap, MapElement, SemanticMap, SharedSigmas
from semloc_jax.structs import ElementClass


def way(num=21, every_m=5.0):
    """A bend of 90 degrees, with its headings."""
    turn = np.linspace(0.0, np.pi / 2, num)
    radius_m = every_m * (num - 1) / (np.pi / 2)
    return np.array(
        [rigid.planar_pose(radius_m * np.sin(a), radius_m * (1.0 - np.cos(a)), float(a), 0.0) for a in turn]
    )


def tangents_of(motion, Ts):
    """Right tangents of poses that all move with a map that is turned and shifted a little: x, y [m], turn [rad]."""
    x, y, a = motion
    T = rigid.planar_pose(x, y, a, 0.0)
    return rigid.log(rigid.inverse(Ts) @ T @ Ts).ravel()


def test_the_frame_of_a_map_is_no_error_of_it():
    """Errors that are one motion of the whole map: none are left."""
    Ts = way()
    J = np.stack([tangents_of(1e-6 * np.eye(3)[k], Ts) / 1e-6 for k in range(3)], axis=1)
    found = way_sigmas(Ts, J @ np.diag([1.0, 4.0, 0.01]) @ J.T)
    assert found.place_m.max() < 1e-4
    assert found.turn_rad.max() < 1e-6


def test_errors_of_each_place_and_of_the_scale_are_what_they_are():
    """Places so far apart that none sees what another one sees."""
    Ts = way(every_m=60.0)
    num = len(Ts)
    own = np.tile([0.02, 0.02, 0.1, 0.0, 0.0, 0.001], num)
    alone = way_sigmas(Ts, np.diag(own**2))
    # Three unknowns are taken from 42 numbers.
    assert np.sqrt(np.mean(alone.place_m**2)) == pytest.approx(0.02 * np.sqrt(39 / 42), rel=1e-3)
    assert alone.turn_rad == pytest.approx(np.full(num, 0.001), rel=0.05)
    outwards = np.zeros((num, 6))
    outwards[:, :2] = np.einsum("iba,ib->ia", Ts[:, :2, :2], Ts[:, :2, 3])
    scaled = way_sigmas(Ts, 1e-6 * np.outer(outwards, outwards))
    off_m = 1e-3 * np.linalg.norm(Ts[:, :2, 3] - Ts[:, :2, 3].mean(axis=0), axis=1)
    np.testing.assert_allclose(scaled.place_m, off_m / np.sqrt(2.0), atol=1e-6)


@pytest.mark.parametrize(("share", "sigma"), [(0.8, 0.008), (0.05, 0.001)])
def test_a_size_is_known_no_better_than_a_share_of_what_the_sensors_know(share, sigma):
    """Images claim 0.1 %, sensors know 1 %; where the share is less than images claim, nothing is changed."""
    Ts = way(every_m=60.0)
    outwards = np.zeros((len(Ts), 6))
    outwards[:, :2] = np.einsum("iba,ib->ia", Ts[:, :2, :2], Ts[:, :2, 3] - Ts[:, :2, 3].mean(axis=0))
    size, own = np.outer(outwards, outwards), np.diag(np.tile([1e-6, 1e-6, 0.0, 0.0, 0.0, 1e-12], len(Ts)))
    found = way_sigmas(Ts, with_size(Ts, own + 0.001**2 * size, 0.01**2 * size, share))
    off_m = sigma * np.linalg.norm(Ts[:, :2, 3] - Ts[:, :2, 3].mean(axis=0), axis=1) / np.sqrt(2.0)
    np.testing.assert_allclose(found.place_m, off_m, rtol=0.05, atol=2e-3)


def test_an_element_is_laid_by_all_that_look_at_it():
    """Headings that are all off alike shear the map along a straight way, which turns it by half of that; those that
    are off each on its own outvote each other."""
    Ts = np.array([rigid.planar_pose(5.0 * k, 0.0, 0.0, 0.0) for k in range(21)])
    alike, alone = np.zeros((len(Ts), 6)), np.tile([0, 0, 0, 0, 0, 0.001], len(Ts))
    alike[:, 5] = 0.001
    of_all = way_sigmas(Ts, np.outer(alike, alike)).turn_rad[3:-3]
    assert of_all == pytest.approx(np.full(15, 0.0005), rel=0.25)
    assert way_sigmas(Ts, np.diag(alone**2)).turn_rad.max() < 0.0006


def test_places_are_metres_apart_and_not_many():
    way_m = np.arange(0.0, 2000.0, 0.5)
    rows = places_apart(way_m, list(range(0, 4000, 2)))
    assert len(rows) <= 151
    assert np.diff(way_m[rows]).min() > 10.0
    assert len(places_apart(way_m[:41], list(range(41)))) == 5


def test_a_map_states_them_and_tells_them_at_a_pose():
    lines = [
        MapElement(f"line {k}", ElementClass.SLOT_LINE, [[x, 0.0, 0.0], [x, 5.0, 0.0]]) for k, x in enumerate((0, 60))
    ]
    made = BeliefMap(SemanticMap(tuple(lines)), {line.id: Belief(0.02, 0.05, 4.0) for line in lines})
    sigmas = WaySigmas(np.array([[0.0, 0.0], [60.0, 0.0]]), np.array([0.03, 0.04]), np.array([0.001, 0.002]))
    stated = sigmas.stated(made)
    assert BeliefMap.of(stated.as_map()).beliefs == stated.beliefs
    only = SharedSigmas(stated.as_map().elements[1:], everywhere=(0.03, 0.0))
    assert only.at(np.array([50.0, 3.0])) == pytest.approx((0.05, 0.002))
    both = SharedSigmas(stated.as_map().elements)
    assert both.at(np.zeros(2)) == pytest.approx(
        (np.hypot(0.03, 0.04) / np.sqrt(2.0), np.hypot(0.001, 0.002) / np.sqrt(2.0))
    )
    assert SharedSigmas(made.as_map().elements, everywhere=(0.01, 0.0)).at(np.zeros(2)) == (0.01, 0.0)
