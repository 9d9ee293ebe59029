"""Focal lengths told by the way: the pose moves against the wheels as contours come near and leave the view."""

import numpy as np
import pytest

from semloc_jax.localization import lens_way
from semloc_jax.localization.lens_way import LensWay
from semloc_jax.localization.other_calibrations import STEPS

GAIN = 0.2


def driven(lens_steps: float, change_m: float, ruggedness_m: float = 0.01, looks: int = 48) -> LensWay:
    """A drive with a lens that is so many steps longer than stated. What a step moves the pose by changes from look to
    look; masks are 0.06 m off, and solves with other lenses by a ruggedness of their own."""
    rng, way, fused_m = np.random.default_rng(5), LensWay(), 0.25 * lens_steps
    for k in range(looks):
        ahead_m = -0.25 + change_m * np.sin(0.9 * k)
        measured_m = -lens_steps * ahead_m + 0.06 * rng.normal()
        moved = STEPS * ahead_m + ruggedness_m * rng.normal(size=len(STEPS))
        way = lens_way.learned(way, moved, measured_m - fused_m, 0.08, GAIN)
        fused_m += GAIN * (measured_m - fused_m)
    return way


@pytest.mark.parametrize("lens_steps", [0.0, -0.8, -2.0])
def test_the_way_tells_a_lens_that_no_frame_tells(lens_steps):
    """2.5 % are a step. As on a real drive of 400 x 120 px, it moves the pose back by 0.25 m, some centimetres more or
    less."""
    at, variance = lens_way.told(driven(lens_steps, 0.06))
    assert abs(at - lens_steps) < 2.5 * np.sqrt(variance) and np.sqrt(variance) < 0.65
    if lens_steps < -1.0:
        assert at < -1.2


def test_a_view_that_does_not_change_tells_nothing():
    assert lens_way.told(driven(-2.0, 0.0)) is None or lens_way.told(driven(-2.0, 0.0))[1] > 1.0


def test_solves_that_only_scatter_tell_nothing():
    assert lens_way.told(driven(-2.0, 0.0, ruggedness_m=0.1)) is None


def test_looks_that_did_not_ask_every_step_leave_the_sums_alone():
    before = driven(0.0, 0.06, looks=4)
    assert lens_way.told(before) is None
    assert lens_way.learned(before, np.array([-0.2, 0.3, np.nan, np.nan]), 0.1, 0.08, GAIN) is before
