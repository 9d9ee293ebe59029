"""Evidence with a null, against the same likelihood written out piece by piece."""

import numpy as np
import pytest
from scipy.stats import norm

from semloc_jax.alignment.evidence_null import EvidenceNull, NullConfig, best_rates
from semloc_jax.alignment.map_pieces import Rates
from semloc_jax.alignment.observed import CELL_COLUMNS, Observed
from semloc_jax.alignment.seen_samples import SeenSamples

CELL_PX = 48.0
SIZE = (480, 288)


def scene(num_poses, num_samples, seed, scale_px=None, channels=1):
    """Samples on elements of 8 samples each; distances are normal, or uniform for a wrong pose."""
    random = np.random.default_rng(seed)
    shape = (num_poses, 1, num_samples)
    element = np.arange(num_samples) // 8
    channel = element % channels
    cell = (element % 6) * CELL_COLUMNS + element % 10
    if scale_px is None:
        signed = random.uniform(-60.0, 60.0, shape)
    else:
        signed = scale_px * random.normal(size=shape)
    seen = Observed(
        signed,
        random.uniform(2.0, 6.0, shape),
        np.broadcast_to(cell, shape).copy(),
        np.full(shape, 12.0),
    )
    return seen, channel, element


def null_of(channels=1, unit_px=1.0):
    wrong, channel, element = scene(40, 160, 0, channels=channels)
    return EvidenceNull(SeenSamples.of(wrong), channel, element, unit_px, NullConfig())


def by_hand(null, seen, channel, element, rates):
    """The evidence of the first pose in loops: mixture of each piece, mean over its samples, sum over pieces."""
    config = null.config
    seen_of, total = null.seen(rates.scale_px), 0.0
    for piece in sorted({(e, c) for e, c in zip(element, seen.cell[0, 0], strict=True)}):
        rows = [i for i in range(len(element)) if (element[i], seen.cell[0, 0, i]) == piece]
        nats, weight = 0.0, 0.0
        for i in rows:
            own = int(np.searchsorted(null.edges_px, abs(seen.signed_px[0, 0, i]), side="right"))
            ratio = np.log(seen_of[channel[i], own] / null.null[channel[i], own])
            length = seen.length_px[0, 0, i]
            nats += length * np.clip(ratio, -config.most_nats, config.most_nats)
            weight += length
        detection = rates.detection[channel[rows[0]], 0]
        counted = min(max(weight / config.observation_px, config.least_observation), 1.0)
        total += counted * np.log(1.0 - detection + detection * np.exp(nats / weight))
    return total


@pytest.mark.parametrize("channels", [1, 2])
def test_evidence_is_the_sum_over_pieces(channels):
    null = null_of(channels)
    seen, channel, element = scene(3, 160, 1, scale_px=2.0, channels=channels)
    rates = Rates(np.array([2.0, 3.0])[:channels], np.array([[0.7] * 4, [0.4] * 4])[:channels], np.ones(channels))
    found = null.evidence(null.pieces(SeenSamples.of(seen), SIZE, CELL_PX), rates)
    assert found.nats[0] == pytest.approx(by_hand(null, seen, channel, element, rates), abs=1e-9)
    assert found.block_nats.sum(axis=1) == pytest.approx(found.nats, abs=1e-9)


def test_pieces_do_not_depend_on_the_order_of_the_samples():
    null = null_of()
    seen, _, _ = scene(2, 160, 3, scale_px=2.0)
    shuffled = np.random.default_rng(5).permutation(160)
    other = EvidenceNull(*_permuted(scene(40, 160, 0), shuffled), 1.0, NullConfig())
    moved = Observed(*(leaf[:, :, shuffled] for leaf in seen))
    rates = null.start_rates()
    first = null.evidence(null.pieces(SeenSamples.of(seen), SIZE, CELL_PX), rates).nats
    assert other.evidence(other.pieces(SeenSamples.of(moved), SIZE, CELL_PX), rates).nats == pytest.approx(
        first, abs=1e-9
    )


def _permuted(parts, order):
    seen, channel, element = parts
    moved = Observed(*(leaf[:, :, order] for leaf in seen))
    return SeenSamples.of(moved), channel[order], element[order]


def test_a_pose_that_is_right_has_evidence_and_a_wrong_one_has_none():
    null = null_of()
    right, wrong = scene(1, 160, 7, scale_px=2.0)[0], scene(1, 160, 8)[0]
    rates = null.start_rates()
    assert null.evidence(null.pieces(SeenSamples.of(right), SIZE, CELL_PX), rates).nats[0] > 10.0
    assert null.evidence(null.pieces(SeenSamples.of(wrong), SIZE, CELL_PX), rates).nats[0] < 0.0


def test_map_that_is_not_seen_costs_at_most_the_miss_of_each_piece():
    """However far off a piece lies, it costs log(1 - P) of an observation."""
    null = null_of()
    wrong = scene(1, 160, 9)[0]._replace(signed_px=np.full((1, 1, 160), 59.0))
    rates = null.start_rates()
    pieces = null.pieces(SeenSamples.of(wrong), SIZE, CELL_PX)
    found = null.evidence(pieces, rates)
    assert found.nats[0] >= np.log(1.0 - null.config.rate) * found.observations[0] - 1e-9
    assert found.explained[0] == 0.0


def test_rates_come_back_from_masks_drawn_with_them():
    null = null_of()
    seen, _, element = scene(1, 800, 11, scale_px=3.0)
    missed = np.isin(element, np.random.default_rng(2).permutation(100)[:30])
    signed = np.where(missed, np.random.default_rng(3).uniform(-60.0, 60.0, seen.signed_px.shape), seen.signed_px)
    wrong, channel, elements = scene(40, 800, 0)
    null = EvidenceNull(SeenSamples.of(wrong), channel, elements, 1.0, NullConfig())
    rates = null.fit(null.pieces(SeenSamples.of(seen._replace(signed_px=signed)), SIZE, CELL_PX))
    # The scale of the narrow part of the mixture under which samples of that standard deviation are likeliest.
    samples, scales = seen.signed_px[0, 0, ~missed], np.linspace(1.0, 5.0, 81)
    density = [0.75 * norm.pdf(samples, scale=s) + 0.25 * norm.pdf(samples, scale=2.5 * s) for s in scales]
    expected_px = scales[np.argmax(np.log(density).sum(axis=1))]
    assert rates.scale_px[0] == pytest.approx(expected_px, rel=0.1)
    assert rates.detection[0, 0] == pytest.approx(0.7, abs=0.06)


def test_rates_are_those_of_the_candidate_that_explains_most():
    null = null_of()
    right, wrong = scene(1, 160, 7, scale_px=1.5)[0], scene(1, 160, 8)[0]
    both = Observed(*(np.concatenate(pair) for pair in zip(wrong, right, strict=True)))
    pieces = null.pieces(SeenSamples.of(both), SIZE, CELL_PX)
    chosen = best_rates(null, pieces, np.zeros(2), np.array([0, 1]))
    assert chosen.detection[0, 0] == null.fit(pieces.of_pose(1)).detection[0, 0]
    assert chosen.detection[0, 0] > null.fit(pieces.of_pose(0)).detection[0, 0]


def test_masks_thinner_than_the_map_show_in_the_offset_alone():
    null = null_of()
    seen = scene(1, 160, 7, scale_px=1.0)[0]
    thin = seen._replace(signed_px=seen.signed_px + 3.0)
    for observed, expected in ((seen, 0.0), (thin, 3.0)):
        pieces = null.pieces(SeenSamples.of(observed), SIZE, CELL_PX)
        assert null.border_offset_px(pieces, null.fit(pieces)) == pytest.approx(expected, abs=0.4)


def test_a_pose_that_sees_nothing_has_no_evidence():
    null = null_of()
    seen = scene(2, 160, 7, scale_px=2.0)[0]
    blind = seen._replace(length_px=np.where(np.arange(2)[:, None, None] == 1, 0.0, seen.length_px))
    found = null.evidence(null.pieces(SeenSamples.of(blind), SIZE, CELL_PX), null.start_rates())
    assert found.nats[1] == 0.0 and found.observations[1] == 0.0 and np.isfinite(found.explained).all()


def test_poses_fitted_together_have_the_rates_that_each_has_alone():
    null = null_of(2)
    poses = Observed(
        *(
            np.concatenate(pair)
            for pair in zip(scene(1, 160, 8, channels=2)[0], scene(2, 160, 7, 1.5, 2)[0], strict=True)
        )
    )
    pieces = null.pieces(SeenSamples.of(poses), SIZE, CELL_PX)
    for pose, together in zip((2, 0, 1), null.fit_each(pieces.of_poses([2, 0, 1])), strict=True):
        alone = null.fit(pieces.of_pose(pose))
        np.testing.assert_array_equal(together.scale_px, alone.scale_px)
        np.testing.assert_array_equal(together.detection, alone.detection)
        np.testing.assert_array_equal(together.left_over, alone.left_over)


def test_the_total_is_the_sum_over_the_parts_of_the_image():
    null = null_of()
    pieces = null.pieces(SeenSamples.of(scene(3, 160, 7, scale_px=2.0)[0]), SIZE, CELL_PX)
    rates = null.start_rates()
    assert null.total_nats(pieces, rates) == pytest.approx(
        null.evidence(pieces, rates).block_nats.sum(axis=1), abs=1e-9
    )


def test_poses_that_see_nothing_at_all_have_no_pieces():
    null = null_of()
    blind = SeenSamples.of(scene(2, 160, 7)[0]._replace(length_px=np.zeros((2, 1, 160))))
    pieces = null.pieces(blind, SIZE, CELL_PX)
    rates = best_rates(null, pieces, np.zeros(2), np.array([0, 1]))
    found = null.evidence(pieces, rates)
    assert len(pieces.pose) == 0 and found.nats.tolist() == found.observations.tolist() == [0.0, 0.0]
    assert null.total_nats(pieces, rates).tolist() == [0.0, 0.0]


def test_pieces_of_poses_one_after_another_are_those_of_all_at_once():
    null = null_of()
    seen = [SeenSamples.of(scene(num, 160, seed)[0]) for num, seed in ((3, 8), (2, 9))]
    one, other = (null.pieces(part, SIZE, CELL_PX) for part in seen)
    both = null.pieces(seen[0].joined(seen[1]), SIZE, CELL_PX)
    for name in ("num_poses", "pose", "channel", "block", "observations", "bin_share", "sample_piece", "sample_px"):
        np.testing.assert_array_equal(getattr(one.joined(other), name), getattr(both, name), err_msg=name)
    assert both.num_poses == 5 and both.sample_piece.max() == len(both.pose) - 1
