"""Distances to mask borders, against shapes whose distance is known."""

import numpy as np
import pytest

from semloc_jax.perception import load_class_table
from semloc_jax.perception.border_distance import border_distances, pixel_unit


def test_distance_to_a_bar_is_that_of_its_edges():
    table = load_class_table("lane_paint")
    mask = np.zeros((96, 128), np.uint8)
    mask[:, 40:60] = table.channels[0].mask_ids[0]
    found = border_distances([mask], table, reach_px=30.0)
    u = 2.0 * (np.arange(64) + 0.5) - 0.5
    # Inside of the bar the nearest edge, outside the one that is faced; its edges lie between two pixels.
    expected = np.clip(np.maximum(39.5 - u, u - 59.5), -30.0, 30.0)
    off_px = np.abs(found.signed_px[0, 0, 24] - expected)
    assert off_px.max() < 1.0
    assert off_px[np.abs(expected) < 2.0].max() < 0.4


def test_a_class_that_is_nowhere_is_far_everywhere():
    table = load_class_table("lane_paint")
    found = border_distances([np.zeros((64, 64), np.uint8)], table, reach_px=25.0)
    assert (found.signed_px == 25.0).all()


def test_cameras_of_other_sizes_are_filled_up():
    table = load_class_table("lane_paint")
    masks = [np.zeros((64, 96), np.uint8), np.zeros((48, 64), np.uint8)]
    assert border_distances(masks, table, reach_px=25.0).signed_px.shape == (2, len(table.channels), 32, 48)


@pytest.mark.parametrize(
    ("shape", "unit"), [((1200, 1920), 1.0), ((600, 960), 1.0), ((120, 400), 0.4), ((480, 640), 1.0), ((40, 60), 0.3)]
)
def test_small_images_have_small_pixels(shape, unit):
    assert pixel_unit([shape]) == pytest.approx(unit, abs=0.01)


def test_what_is_left_out_around_a_small_shape_is_beyond_reach():
    """A shape amid a large mask: the same distances as where a second shape makes all of the mask count."""
    table = load_class_table("lane_paint")
    alone = np.zeros((256, 384), np.uint8)
    alone[100:110, 200:230] = table.channels[0].mask_ids[0]
    both = alone.copy()
    both[:4, :4] = both[-4:, -4:] = table.channels[0].mask_ids[0]
    found, whole = (border_distances([mask], table, reach_px=30.0).signed_px[0, 0] for mask in (alone, both))
    middle = slice(20, 108), slice(60, 150)
    assert np.array_equal(found[middle], whole[middle])
    assert (found[:18, :18] == 30.0).all() and (found[-18:, -18:] == 30.0).all()
    assert found.min() < -2.0
