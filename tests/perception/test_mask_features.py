"""Contours of a mask as features: closing, size, class, confidence, what hides the road."""

import numpy as np
import pytest

from semloc_jax.perception import load_class_table
from semloc_jax.perception.mask_features import FeatureConfig, mask_features
from semloc_jax.structs import ElementClass

TABLE = load_class_table("drive")
IDS = {name: number for number, name in TABLE.id_names.items()}


def picture():
    return np.full((80, 120), IDS["road"], np.uint8)


def test_a_gap_of_two_pixels_is_closed_and_costs_confidence():
    mask = picture()
    mask[20:50, 30:40] = IDS["lane_solid"]
    (whole,) = mask_features(mask, TABLE)
    assert whole.confidence == 1.0
    assert TABLE.channels[whole.channel].name == "lane_marking"
    np.testing.assert_array_equal([whole.uv.min(axis=0), whole.uv.max(axis=0)], [[30, 20], [39, 49]])
    mask[34:36] = IDS["road"]
    (closed,) = mask_features(mask, TABLE)
    assert closed.confidence == pytest.approx(28 / 30)
    assert len(mask_features(mask, TABLE, FeatureConfig(close_px=1))) == 2


def test_specks_and_what_stands_upright_are_no_features():
    mask = picture()
    mask[10:17, 10:17] = IDS["arrow"]  # encloses 36 px
    mask[40:60, 20:24] = IDS["pole"]
    assert mask_features(mask, TABLE) == []
    mask[10:20, 10:20] = IDS["arrow"]
    (arrow,) = mask_features(mask, TABLE)
    assert ElementClass.ROAD_MARK in TABLE.channels[arrow.channel].classes


def test_a_slot_line_around_a_slot_has_an_inner_border_too():
    mask = picture()
    mask[20:60, 20:80] = IDS["slot_line"]
    mask[26:54, 26:74] = IDS["road"]
    found = mask_features(mask, TABLE)
    assert len(found) == 2
    inner = min(found, key=lambda feature: np.ptp(feature.uv[:, 0]))
    assert inner.confidence == 1.0
    assert np.ptp(inner.uv[:, 0]) == pytest.approx(49, abs=1)


def test_where_a_car_cuts_paint_off_there_is_no_border():
    mask = picture()
    mask[30:40, 10:60] = IDS["lane_solid"]
    mask[20:60, 50:90] = IDS["vehicle"]
    (line,) = mask_features(mask, TABLE)
    assert line.uv[:, 0].max() == 47
