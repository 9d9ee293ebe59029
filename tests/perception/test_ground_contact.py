"""Covariance of places on the road and the range of a foot: against sampled errors and another solver."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from semloc_jax.perception.ground_contact import SightErrors, contact_range, ground_covariance

FOCAL_PX, HEIGHT_M, CONE_M = 200.0, 1.0, (0.72, 0.1)
ERRORS = SightErrors()


def test_the_covariance_of_a_place_is_that_of_sampled_errors():
    C, rng = ground_covariance(np.array([4.0, 0.0]), HEIGHT_M, FOCAL_PX, ERRORS), np.random.default_rng(0)
    angle = np.arctan2(1.0, 4.0) + rng.normal(size=200_000) * np.hypot(2.0 / FOCAL_PX, np.deg2rad(0.3))
    reach = (1.0 + 0.05 * rng.normal(size=angle.size)) / np.tan(angle)
    assert np.sqrt(C[0, 0]) == pytest.approx(np.std(np.clip(reach, 2, 8)), rel=0.1)
    assert np.sqrt(C[1, 1]) == pytest.approx(np.sqrt(17.0) * 0.01, rel=0.01)
    assert abs(C[0, 1]) < 1e-12


def sampled(range_m, num=4000, seed=0, errors=ERRORS, size_m=CONE_M):
    """Tangents of foot and top of cones of several heights, with all errors."""
    rng = np.random.default_rng(seed)
    height_m = HEIGHT_M + errors.height_m * rng.normal(size=num)
    pitch = np.deg2rad(errors.pitch_deg) * rng.normal(size=num)
    tangents = []
    for below_m in (height_m, height_m - size_m[0] - size_m[1] * rng.normal(size=num)):
        angle = np.arctan2(below_m, range_m) + pitch + errors.pixel_px / FOCAL_PX * rng.normal(size=num)
        tangents.append(np.tan(angle))
    return np.array(tangents)


@pytest.mark.parametrize("range_m", [1.5, 3.0, 5.0])
def test_a_foot_and_a_top_tell_the_range_as_well_as_they_say(range_m):
    errors = SightErrors(pixel_px=1.0)  # small enough for the spread to be near normal
    for with_top in (False, True):
        found = [
            contact_range(foot, HEIGHT_M, FOCAL_PX, errors, top if with_top else None, CONE_M)
            for foot, top in sampled(range_m, 2000, errors=errors).T
        ]
        off = np.array([contact.range_m for contact in found]) - range_m
        sigma = np.array([contact.sigma_m for contact in found])
        assert np.std(off / sigma) == pytest.approx(1.0, abs=0.1)
        assert abs(np.median(off)) < 0.15 * np.median(sigma)


def test_the_height_of_the_class_helps_where_pitch_and_road_are_unsure():
    foot, top = 1.0 / 6.0, 0.28 / 6.0
    loose, known = SightErrors(0.5, 1.0, 0.1), (0.72, 0.03)
    alone = contact_range(foot, HEIGHT_M, FOCAL_PX, loose)
    both = contact_range(foot, HEIGHT_M, FOCAL_PX, loose, top, known)
    assert alone.range_m == pytest.approx(6.0) and both.range_m == pytest.approx(6.0)
    assert both.sigma_m < 0.4 * alone.sigma_m
    unknown = contact_range(foot, HEIGHT_M, FOCAL_PX, loose, top, (0.72, 50.0))
    assert unknown.sigma_m == pytest.approx(alone.sigma_m, rel=0.03)


def test_the_range_is_that_of_a_least_squares_over_every_error():
    """The same model with each error as an unknown of its own, by another solver; errors small enough to be linear."""
    errors, size_m = SightErrors(0.3, 0.05, 0.01), (0.72, 0.01)
    for one, other in sampled(4.0, 20, seed=3, errors=errors, size_m=size_m).T:

        def residuals(x, one=one, other=other):
            q, height, pitch, size = x
            told = [(HEIGHT_M + height) * q, (HEIGHT_M + height - size) * q]
            off = [
                (np.arctan(seen) - np.arctan(t) - pitch) * FOCAL_PX / errors.pixel_px
                for seen, t in zip((one, other), told, strict=True)
            ]
            prior = [height / errors.height_m, pitch / np.deg2rad(errors.pitch_deg), (size - size_m[0]) / size_m[1]]
            return np.array([*off, *prior])

        q = least_squares(residuals, [one / HEIGHT_M, 0.0, 0.0, size_m[0]], xtol=1e-12, ftol=1e-12).x[0]
        found = contact_range(one, HEIGHT_M, FOCAL_PX, errors, other, size_m)
        assert found.range_m == pytest.approx(1.0 / q, abs=0.05 * found.sigma_m)


def test_a_foot_above_the_horizon_is_nowhere():
    assert contact_range(-0.1, HEIGHT_M, FOCAL_PX, ERRORS) == (np.inf, np.inf, 0.0)


@pytest.mark.parametrize("tan_top", [None, 0.07])
def test_the_part_of_the_height_is_how_far_the_foot_moves_with_the_road(tan_top):
    """The range that is found is of a road at its plane; the sights are of one a sigma higher: seen under less."""
    q, size_m = 0.25, (0.72, 0.1)
    errors = SightErrors(1.0, 0.3, 0.01)
    below = np.array([HEIGHT_M, HEIGHT_M - size_m[0]])
    ranges = []
    for rise_m in (0.0, errors.height_m):
        foot, top = (below - rise_m) * q
        ranges.append(contact_range(foot, HEIGHT_M, FOCAL_PX, errors, None if tan_top is None else top, size_m))
    moved = ranges[1].range_m - ranges[0].range_m
    assert moved == pytest.approx(ranges[0].by_height_m, rel=0.03)
    assert 0.0 < ranges[0].by_height_m < ranges[0].sigma_m
