"""Borders that the map leaves over: lengths against figures drawn by hand, nats against the formula."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from semloc_jax.alignment.border_cells import BorderCells
from semloc_jax.alignment.candidates import coarse_gain
from semloc_jax.alignment.evidence_null import EvidenceNull, NullConfig
from semloc_jax.alignment.map_pieces import Rates
from semloc_jax.alignment.observed import CELL_COLUMNS, Observed
from semloc_jax.alignment.seen_samples import SeenSamples
from semloc_jax.perception.border_distance import BorderDistances

STRIDE, CELL_PX, SIZE = 2, 48.0, (480, 288)


def distances(*boxes):
    """Signed distances to boxes (left, top, right, bottom) [px of the full mask], one channel each."""
    fields = []
    for left, top, right, bottom in boxes:
        inside = np.zeros((SIZE[1] // STRIDE, SIZE[0] // STRIDE), bool)
        inside[top // STRIDE : bottom // STRIDE, left // STRIDE : right // STRIDE] = True
        away = distance_transform_edt(~inside) - distance_transform_edt(inside)
        fields.append(STRIDE * np.clip(away - 0.5 * np.sign(away), -22, 22))
    return BorderDistances(np.array([fields], np.float32), STRIDE, 45.0)


def cells_of(*boxes, channels=(0, 1), usable=None):
    usable = np.ones((1, SIZE[1] // STRIDE, SIZE[0] // STRIDE), bool) if usable is None else usable
    return BorderCells.of(distances(*boxes), np.array(channels), usable, float(STRIDE), CELL_PX, SIZE)


def test_length_of_borders_is_that_of_the_outline():
    """A staircase is pi / 4 of its steps on the mean over directions, and that of a box along the axes."""
    cells = cells_of((100, 40, 300, 200), (20, 20, 60, 40))
    by_channel = np.bincount(cells.channel, cells.length_px)
    assert by_channel == pytest.approx(np.pi / 4 * np.array([2 * (200 + 160), 2 * (40 + 20)]), rel=0.02)
    cell = cells.key % CELL_COLUMNS**2
    column, row = cell % CELL_COLUMNS, cell // CELL_COLUMNS
    own = cells.channel == 0
    assert (column[own].min(), column[own].max()) == (100 // 48, 300 // 48)
    assert (row[own].min(), row[own].max()) == (40 // 48, 200 // 48)


def test_what_is_hidden_and_what_the_map_does_not_hold_is_no_border():
    usable = np.ones((1, SIZE[1] // STRIDE, SIZE[0] // STRIDE), bool)
    usable[:, :, 100:] = False
    half = cells_of((100, 40, 300, 200), (20, 20, 60, 40), usable=usable)
    assert half.length_px[half.channel == 0].sum() == pytest.approx(np.pi / 4 * (160 + 2 * 100), rel=0.03)
    assert set(cells_of((100, 40, 300, 200), (20, 20, 60, 40), channels=(1,)).channel) == {1}


def test_a_contour_on_half_of_a_border_leaves_the_other_half():
    cells = cells_of((0, 48, 480, 96))
    whose = np.repeat([0, 1], len(cells.key))
    row = np.tile(np.arange(len(cells.key)), 2)
    left = cells.left_over(whose, row, np.tile(cells.length_px, 2) * np.repeat([0.5, 3.0], len(cells.key)), 3)
    assert left == pytest.approx(np.repeat([[0.5], [0.0], [1.0]], len(cells.key), axis=1))
    outside = cells.rows(np.zeros(2, int), np.array([0, 1]), np.array([9 * CELL_COLUMNS, 0]))
    assert outside.tolist() == [-1, -1]


def seen(signed_px, cell, num_poses=1):
    """Samples of 10 px length, each on an element of its own."""
    shape = (num_poses, 1, len(cell))
    signed_px = np.broadcast_to(signed_px, shape).copy()
    cells = np.broadcast_to(cell, shape).copy()
    return SeenSamples.of(Observed(signed_px, np.full(shape, 10.0), cells, np.full(shape, 12.0)))


def test_two_poses_that_see_the_same_differ_by_the_borders_they_leave():
    """Both have all their contours on borders; one covers two cells with three contours each, the other one twice."""
    cells = cells_of((0, 48, 480, 200))
    cell = (cells.key % CELL_COLUMNS**2)[:2]
    both, one = np.repeat(cell, 3), np.repeat(cell[:1], 6)
    random = np.random.default_rng(0)
    wrong = seen(random.uniform(-44, 44, (40, 1, 6)), both, 40)
    null = EvidenceNull(wrong, np.zeros(6, int), np.arange(6), 1.0, NullConfig(), cells=cells)
    poses = seen(0.5, both).joined(seen(0.5, one))
    rates = Rates(np.array([2.0]), np.full((1, 4), 0.7), np.array([0.5]))
    pieces = null.pieces(poses, SIZE, CELL_PX)
    found = null.evidence(pieces, rates)
    share = 1.0 - np.array([[30.0, 30.0], [60.0, 0.0]]).clip(max=cells.length_px[:2]) / cells.length_px[:2]
    weight = np.where(cells.length_px < 6.0, 0.0, np.clip(cells.length_px / 30.0, 0.2, 1.0))
    left = np.ones((2, len(weight)))
    left[:, :2] = share
    at_random = null.left_over_at_random[0]
    by_hand = ((left - at_random) * weight).sum(axis=1) * np.log(0.5 / at_random)
    assert found.block_nats.sum(axis=1) - found.nats == pytest.approx(by_hand, abs=1e-9)
    assert found.left_over == pytest.approx((left * weight).sum(axis=1) / weight.sum())
    assert by_hand[0] > by_hand[1]


def test_the_share_left_over_is_learned_of_the_pose_and_never_above_chance():
    cells = cells_of((0, 48, 480, 200))
    cell = cells.key % CELL_COLUMNS**2
    every = np.repeat(cell, 8)
    random = np.random.default_rng(0)
    channel, element = np.zeros(len(every), int), np.arange(len(every))
    wrong = seen(random.uniform(-44, 44, (40, 1, len(every))), every, 40)
    null = EvidenceNull(wrong, channel, element, 1.0, NullConfig(), cells=cells)
    right = null.fit(null.pieces(seen(0.5, every), SIZE, CELL_PX))
    astray = null.fit(null.pieces(seen(40.0, every), SIZE, CELL_PX))
    assert right.left_over[0] < 0.35 * null.left_over_at_random[0]
    assert astray.left_over[0] == pytest.approx(null.left_over_at_random[0])


def test_at_a_first_look_random_poses_gain_nothing():
    """Where all that see some map lose, those that look away from it would be the best."""
    random = np.random.default_rng(3)
    cell = np.zeros(400, int)
    wrong = seen(random.uniform(-44, 44, (40, 1, 400)), cell, 40)
    null = EvidenceNull(wrong, np.zeros(400, int), np.zeros(400, int), 1.0, NullConfig())
    field = random.uniform(-44, 44, (1, 1, 400, 400)).astype(np.float32)
    gain = coarse_gain(null, BorderDistances(field, STRIDE, 45.0), np.ones((1, 400, 400), bool), 6.0)
    assert abs(gain.mean()) < 0.05
    assert gain.max() > 0.5
