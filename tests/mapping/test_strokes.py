"""Strokes of paint: what is read across one is what an independent interpolation reads."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from semloc_jax.mapping.strokes import _across


@pytest.mark.parametrize("angle_deg", [0.0, 37.0, 90.0, 161.0])
def test_paint_across_a_place_is_that_of_scipy(angle_deg):
    rng = np.random.default_rng(3)
    share = cv2.GaussianBlur(rng.random((90, 120)).astype(np.float32), (0, 0), 2.0)
    place, ahead = np.array([60.3, 44.7]), np.array([np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))])
    left, reach = np.array([-ahead[1], ahead[0]]), 12.0
    offsets, along = np.arange(-reach, reach + 0.25, 0.5), np.arange(-2.0, 2.5)
    x, y = np.moveaxis(place + offsets[:, None, None] * left + along[None, :, None] * ahead, -1, 0)
    expected = map_coordinates(share, [y, x], order=1).mean(axis=1)
    np.testing.assert_allclose(_across(share, place, ahead, reach), expected, atol=1e-3)
