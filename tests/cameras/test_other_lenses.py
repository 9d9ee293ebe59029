"""Rigs with other lenses: what they do to pixels."""

import numpy as np
import pytest

from semloc_jax.cameras import BrownConradyCamera, PinholeCamera, Rig
from semloc_jax.cameras.other_lenses import longer, wider, with_distortion

POINT = np.array([0.6, 0.35, 1.0])
CENTRE = np.array([320.0, 200.0])
STRAIGHT = Rig([PinholeCamera(500.0, 510.0, *CENTRE, 640, 400)], np.eye(4)[None], ["front"])
BENT = Rig([BrownConradyCamera(500.0, 510.0, *CENTRE, 640, 400, -0.3, 0.1)], np.eye(4)[None], ["front"])


def pixel(rig: Rig) -> np.ndarray:
    return np.asarray(rig.cameras[0].project(POINT)[0])


@pytest.mark.parametrize("rig", [STRAIGHT, BENT])
def test_longer_lenses_scale_the_image_about_its_centre(rig):
    seen = pixel(rig) - CENTRE
    np.testing.assert_allclose(pixel(longer(rig, 0.1)) - CENTRE, 1.1 * seen, rtol=1e-5)
    np.testing.assert_allclose(pixel(wider(rig, 0.1)) - CENTRE, [1.1, 1.0] * seen, rtol=1e-5)


def test_the_other_sign_bends_a_lens_the_other_way_by_as_much():
    away = pixel(BENT) - pixel(STRAIGHT)
    assert np.linalg.norm(away) > 20.0
    np.testing.assert_allclose(pixel(with_distortion(BENT, -1.0)) - pixel(STRAIGHT), -away, atol=1e-3)
    np.testing.assert_allclose(pixel(with_distortion(BENT, 0.0)), pixel(STRAIGHT), atol=1e-3)
    assert with_distortion(STRAIGHT, -1.0) is None
