"""A drive lies where it belongs however it is turned and bent against the others, or it lies nowhere."""

from dataclasses import replace

import numpy as np
import pytest

from semloc_jax.geometry.umeyama import umeyama
from semloc_jax.mapping.crowd.correction import Correction
from semloc_jax.mapping.crowd.fusion import fused
from semloc_jax.mapping.crowd.placing import MOST_STRAIN, place
from semloc_jax.mapping.crowd.sights import sights_of
from semloc_jax.mapping.crowd.world import CrowdWorld
from tests.mapping.crowd_world import DriveNoise, Road, drive, middle_of

ROAD, LONG = Road.of(300.0), Road.of(1000.0)
USUAL = 3e-4
"""What headings go by in ten metres: 0.5 deg over 300 m; drives of crowd_seed3 have half of it to thrice as much."""


def turned(packed, turn_rad, road):
    """The drive turned about the middle of its way."""
    middle = middle_of(road).mean(axis=0)
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    x, y = np.array([[c, -s], [s, c]]) @ (packed.place[:2] - middle) + middle
    return replace(packed, place=np.array([x, y, packed.place[2], packed.place[3] + turn_rad]))


def laid(packed, other):
    """Both in the frame of the first; whether the second fits."""
    first, second = (Correction(sights_of(each, None)) for each in (packed, other))
    world = CrowdWorld()
    world.take(0, first, 0.5)
    return first, second, place(world, second)


def off_m(first, second):
    """How far the way of the second lies off: both went the same way."""
    return np.linalg.norm(second.moved(second.sights.way) - first.moved(first.sights.way), axis=1)


@pytest.mark.parametrize("turn_deg", [-2.5, -1.5, 0.0, 1.5, 2.5])
@pytest.mark.parametrize("seed", range(4))
def test_a_drive_that_is_turned_lies_on_its_own_lane(turn_deg, seed):
    """A degree is 2.6 m at the ends, where the next line is 3.5 m aside and the next dash 9 m ahead."""
    first, second = (drive(ROAD, k, DriveNoise(curl_rad=c), seed) for k, c in enumerate((USUAL, -USUAL)))
    first, second, fits = laid(first, turned(second, np.radians(turn_deg), ROAD))
    assert fits and off_m(first, second).max() < 0.8 and second.strain < 0.25 * MOST_STRAIN


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_a_long_way_is_laid_from_one_stretch_of_it_on(seed):
    """Over a kilometre two ways bend by 7 m against each other: no one motion brings both ends onto their lanes."""
    first, second = (drive(LONG, k, DriveNoise(curl_rad=c), seed) for k, c in enumerate((USUAL, -USUAL)))
    first, second, fits = laid(first, second)
    assert fits and off_m(first, second).max() < 0.8


def test_the_map_is_bent_by_the_mean_of_its_ways_though_one_is_turned():
    """Nothing else is known of how the road runs: the drives themselves agree on any common bend."""
    curls = 1e-4 * np.array([-4.1, 1.0, 2.7, 1.9, -3.4, 4.0])
    packed = [drive(ROAD, k, DriveNoise(bend_rad=1e-4, curl_rad=c, scale=0.0)) for k, c in enumerate(curls)]
    packed[3] = turned(packed[3], np.radians(2.5), ROAD)
    found, true = fused([sights_of(each, None) for each in packed]), middle_of(ROAD)
    own, now = (
        np.array([aside(way, true) for way in ways])
        for ways in zip(*((d.sights.way, d.moved(d.sights.way)) for d in found.drives), strict=True)
    )
    assert not found.distrusted and np.abs(own).max() > 0.4 and np.abs(now - now.mean(axis=0)).max() < 0.5
    np.testing.assert_allclose(now.mean(axis=0), own.mean(axis=0), atol=0.03)


def aside(way, true):
    """How far a way lies to the left of the true one after one motion in the plane [m]."""
    step = np.gradient(true, axis=0)
    left = np.stack([-step[:, 1], step[:, 0]], axis=1) / np.linalg.norm(step, axis=1, keepdims=True)
    return ((umeyama(true, way).apply(way) - true) * left).sum(axis=1)
