"""The plan in the corner of a film: where the reference stands in it, and how far levels reach."""

import numpy as np

from semloc_jax.viz.insets import FrameErrors, with_inset
from semloc_jax.viz.style import rgb

IMAGE = np.full((300, 900, 3), 90, np.uint8)
SIZE, EDGE = 126, 5
SCALE = 0.5 * SIZE / (1.6 * 0.29)
MIDDLE = np.array([EDGE + 0.5 * SIZE, 900 - EDGE - 0.5 * SIZE])
"""Row and column of the estimate."""


def of_colour(picture: np.ndarray, colour: str) -> np.ndarray:
    return np.argwhere((np.abs(picture.astype(int) - rgb(colour)) < 12).all(axis=-1))


def picture(error_m=(0.1, -0.2), level_m=(0.15, 0.25)) -> np.ndarray:
    return with_inset(IMAGE, FrameErrors(error_m, (0.01, 0.02), level_m, (0.29, 0.29)))


def test_an_estimate_to_the_left_and_behind_has_its_reference_to_the_right_and_ahead():
    found = of_colour(picture(), "#66bb6a").mean(axis=0)
    np.testing.assert_allclose(found, MIDDLE + SCALE * np.array([-0.2, 0.1]), atol=1.5)


def test_levels_are_drawn_to_scale_and_end_at_the_border():
    box = of_colour(picture((np.nan, np.nan)), "#90caf9")
    np.testing.assert_allclose(np.ptp(box, axis=0), 2 * SCALE * np.array([0.25, 0.15]), atol=3)
    wide = of_colour(picture(level_m=(np.inf, 9.0)), "#90caf9")
    assert (wide.min(axis=0) >= MIDDLE - 0.5 * SIZE).all() and (np.ptp(wide, axis=0) > 0.9 * SIZE).all()


def test_nothing_else_of_the_picture_changes():
    changed = (picture() != IMAGE).any(axis=-1)
    assert not changed[:, : 900 - EDGE - SIZE].any() and not changed[EDGE + SIZE :].any()
