"""Distances that a network tells reach the solver where they are, as sure as they are."""

import numpy as np
import pytest

from semloc_jax.cameras import PinholeCamera, Rig
from semloc_jax.datasets import Frame
from semloc_jax.inputs.mask_view import MaskSource
from semloc_jax.perception import load_class_table
from semloc_jax.perception.border_distance import border_distances
from semloc_jax.perception.border_mask import SURE_PX, BorderMask, SeenBorders, borders_of
from semloc_jax.perception.cost_maps import CostMapConfig, cost_maps

TABLE = load_class_table("lane_paint")
NAME = TABLE.channels[0].name
SIZE = (96, 64)


def mask_with_border(border_px, stride, sigma_px=1.0, reach_px=40.0):
    """What is left of a border at a place between pixels is inside; cells of a stride."""
    shape = (round(SIZE[1] / stride), round(SIZE[0] / stride))
    centres = (np.arange(shape[1]) + 0.5) * stride - 0.5
    signed = np.broadcast_to(np.clip(centres - border_px, -reach_px, reach_px), (1, *shape)).astype(np.float32)
    borders = SeenBorders(signed, np.full_like(signed, sigma_px), stride, (NAME,), reach_px)
    ids = np.broadcast_to(np.arange(SIZE[0]) < border_px, SIZE[::-1]).astype(np.uint8)
    return BorderMask.of(ids, borders)


def zero_of(row, stride):
    """Pixel of the image at which a row of cells crosses zero."""
    k = int(np.flatnonzero(np.diff(np.sign(row)))[0])
    return (k + 0.5 - row[k] / (row[k + 1] - row[k])) * stride - 0.5


@pytest.mark.parametrize("stride", [0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("border_px", [41.3, 44.0, 47.6])
def test_a_border_lies_where_it_was_told_on_every_level(border_px, stride):
    """To 0.05 px, from cells of half a pixel (small images are enlarged) up to four; half a pixel would be 0.03 deg."""
    mask = mask_with_border(border_px, stride)
    maps = cost_maps([mask], TABLE)
    for ramp, level in zip(maps.ramps, maps.stride, strict=True):
        assert zero_of(np.asarray(ramp)[0, 0, 8 // level], level) == pytest.approx(border_px, abs=0.05)
    seen = border_distances([mask], TABLE, 60.0)
    assert zero_of(seen.signed_px[0, 0, 4], seen.stride) == pytest.approx(border_px, abs=0.05)


def test_bytes_are_the_floats():
    mask = mask_with_border(44.3, 2.0)
    exact, coarse = (cost_maps([mask], TABLE, quantised=quantised) for quantised in (False, True))
    for a, b in zip(exact.ramps, coarse.ramps, strict=True):
        np.testing.assert_allclose(np.asarray(b) / 127.0 - 1.0, a, atol=0.5 / 127 + 1e-6)


def test_an_unsure_border_is_as_far_as_in_its_own_sigmas():
    """Four pixels beside a border of 4 px of sigma are one sigma: as two pixels where 2 px are assumed."""
    config = CostMapConfig()
    sure, unsure = (cost_maps([mask_with_border(40.5, 1.0, sigma)], TABLE, config) for sigma in (1.0, 4.0))
    ramp_px = config.ramp_px[1]
    column = 44 // config.stride[1]
    at = [float(np.asarray(maps.ramps[1])[0, 0, 4, column]) * ramp_px for maps in (sure, unsure)]
    assert at[1] == pytest.approx(at[0] * SURE_PX / 4.0, abs=0.02)
    far = [np.asarray(maps.ramps[0])[0, 0, 4, -1] for maps in (sure, unsure)]
    assert far[0] == far[1] == 1.0, "what is far from any border is not nearer for being unsure"


def test_a_class_that_the_network_does_not_know_is_nowhere():
    table = load_class_table("classical")
    mask = mask_with_border(44.0, 2.0)
    maps = cost_maps([mask], table)
    post = table.channel_index("post")
    assert np.all(np.asarray(maps.ramps[0])[0, post] == 1.0) and np.asarray(maps.ramps[0])[0, 0].min() < -0.5


def test_what_is_hidden_keeps_the_borders_and_parts_do_not():
    mask = mask_with_border(44.0, 2.0)
    hidden = np.zeros(SIZE[::-1], bool)
    hidden[:8] = True
    rig = Rig([PinholeCamera(80.0, 80.0, 47.5, 31.5, *SIZE)], np.eye(4)[None], ["front"])
    frame = Frame(0, "0", 0.0, "", rig, {}, draw_dynamic=lambda camera: hidden)
    source = MaskSource("eyes", TABLE, ("front",), lambda frame, camera: mask)
    (seen,) = source.masks(frame)
    assert borders_of(seen) is mask.borders and np.all(seen[:8] == 255) and np.all(mask[:8] != 255)
    assert borders_of(mask[4:]) is None and borders_of(np.asarray(mask)) is None
    maps = cost_maps([seen], TABLE)
    assert not np.asarray(maps.usable)[0, :4].any() and np.asarray(maps.usable)[0, 8:].all()
