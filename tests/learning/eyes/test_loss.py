"""The loss of eyes: where it is least, what it leaves alone; batches; which round is kept."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.learning.eyes.batches import CropConfig, ImagePool, LabelledImage, draw_batch
from semloc_jax.learning.eyes.judge import RoundScore
from semloc_jax.learning.eyes.loss import (
    Batch,
    beyond_nll,
    border_loss,
    change,
    distance_loss,
    eyes_loss,
    inside_loss,
)
from semloc_jax.learning.eyes.teach import Round, best_round
from semloc_jax.perception.networks.dense_net import DenseNet
from semloc_jax.perception.networks.eyes import REACH_PX, Said, network_config


def one_cell(signed_px, sigma_px=1e-3):
    cell = jnp.ones((1, 1, 1, 1))
    return Batch(jnp.zeros((1, 2, 2, 3)), signed_px * cell, sigma_px * cell, jnp.ones((1, 1, 1)), 0.0 * cell)


def said(signed_px, log_sigma=0.0, logit=0.0):
    cell = jnp.ones((1, 1, 1, 1))
    return Said(signed_px * cell, log_sigma * cell, logit * cell)


def slope(told, sigma_px, label_px):
    """Of the loss of a distance, by the distance."""
    return float(jax.grad(lambda d: border_loss(said(d, np.log(sigma_px)), one_cell(label_px)).sum())(told))


def test_the_median_of_what_is_seen_is_learned():
    """A dash that is there in 6 of 10 images: the distance to it, not something between."""
    seen = [2.0] * 6 + [30.0] * 4
    mean = [np.mean([slope(d, 1.0, x) for x in seen]) for d in (1.9, 2.1, 13.2, 29.9, 30.1)]
    assert mean[0] < 0.0 < min(mean[1:])


def test_what_is_unsure_and_what_is_missed_is_still_learned():
    """An error of 30 px pulls as one of 1 px does, and at 16 times the sigma a quarter as much: neither is given up."""
    pull = [slope(1.0 + error_px, sigma_px, 1.0) for error_px, sigma_px in ((1.0, 1.0), (30.0, 1.0), (30.0, 16.0))]
    np.testing.assert_allclose(pull, np.array([1.0, 1.0, 0.25]), rtol=1e-5)


@pytest.mark.parametrize("label_sigma_px", [1e-3, 1.0])
def test_the_sigma_that_is_told_holds_two_thirds_of_the_errors(label_sigma_px):
    """Standard deviation 1.5 px, and one error in ten is of 20 to 40 px: the 68 % that are least are within 1.9 px,
    what the label does not know with it. Laplace's own scale, of their mean, would be 6 px."""
    rng = np.random.default_rng(0)
    errors = np.r_[rng.normal(0.0, 1.5, 1800), rng.uniform(20.0, 40.0, 200)]
    labels = one_cell(jnp.asarray(errors).reshape(1, 1, -1, 1), label_sigma_px)
    sigmas = np.exp(np.linspace(-1, 3, 401))
    slopes = jax.vmap(jax.grad(lambda s: border_loss(said(0.0 * labels.signed_px, s), labels).sum()))(np.log(sigmas))
    told = sigmas[int(np.argmin(np.abs(np.asarray(slopes))))]
    expected = np.quantile(np.abs(errors), 0.683)
    assert np.hypot(told, label_sigma_px) == pytest.approx(expected, rel=0.02) and expected < 2.0
    assert np.sqrt(2.0) * np.abs(errors).mean() > 5.5


def test_what_the_label_does_not_know_is_not_learned():
    """The slope by the distance falls with the label's sigma; the network need not be unsure where the label is."""
    slopes = [
        float(jax.grad(lambda d, s=s: border_loss(said(d), one_cell(0.0, s)).sum())(3.0)) for s in (0.1, 1.0, 10.0)
    ]
    assert slopes[0] > slopes[1] > slopes[2] > 0.0
    inside = [float(inside_loss(said(0.0, 0.0, logit), one_cell(-5.0, 1.0)).sum()) for logit in (-3.0, 3.0)]
    assert inside[0] > 10 * inside[1]


def test_a_border_out_of_reach_is_told_far_and_not_exactly():
    """Beyond the reach all is one: how far, and how sure, costs nothing more; nearer costs in sigmas, as a distance."""
    label = one_cell(REACH_PX)
    sure = [float(beyond_nll(said(REACH_PX + 6.0, np.log(s)), label).sum()) for s in (0.2, 1.0, 5.0)]
    assert sure[0] < 1e-6 and sure[0] < sure[1] < sure[2] < np.log(2.0)
    for sigma_px in (0.5, 4.0):
        scale = sigma_px / np.sqrt(2.0)
        nearer = [float(beyond_nll(said(d, np.log(sigma_px)), label).sum()) for d in (REACH_PX, 30.0, 5.0)]
        np.testing.assert_allclose(nearer, np.log(2.0) + np.array([0.0, 10.0, 35.0]) / scale, rtol=1e-4)
    inside = [float(beyond_nll(said(d), one_cell(-REACH_PX)).sum()) for d in (-REACH_PX - 9.0, 0.0)]
    assert inside[0] < 1e-5 and inside[1] > 40.0


@pytest.mark.parametrize("far_cells", [100, 10_000])
def test_what_is_rare_weighs_as_much_as_all_that_is_far(far_cells):
    """Many cells far from every border, or few: the slope by those at one is the same, and that by the far ones too."""
    signed = jnp.concatenate([jnp.zeros(400), jnp.full(far_cells, REACH_PX)]).reshape(1, 1, -1, 1)
    sigma, kept = jnp.full_like(signed, 1e-3), jnp.zeros_like(signed)
    batch = Batch(jnp.zeros((1, 2, 2, 3)), signed, sigma, jnp.ones(signed.shape[:3]), kept)

    def loss(told):
        return distance_loss(Said(told, jnp.zeros_like(told), jnp.zeros_like(told)), batch).sum()

    slope = jax.grad(loss)(jnp.full_like(signed, 20.0)).ravel()
    assert float(slope[:400].sum()) == pytest.approx(400 / 600, rel=1e-3)
    assert float(slope[400:].sum()) == pytest.approx(-np.sqrt(2.0), rel=1e-3)


def test_what_is_kept_costs_nothing_as_it_was():
    """Its own distance and sigma are the least of the loss; taken for a label, no sigma at all would be."""
    kept = one_cell(3.0, 2.0)._replace(kept=jnp.ones((1, 1, 1, 1)))
    assert float(change(said(3.0, np.log(2.0)), kept).sum()) == pytest.approx(0.0, abs=1e-6)
    moved = [float(change(said(3.0 + d, np.log(s)), kept).sum()) for d, s in ((0.5, 2), (-0.5, 2), (0, 1.5), (0, 2.5))]
    assert min(moved) > 0.01
    shrinks = jax.grad(lambda log_sigma: border_loss(said(3.0, log_sigma), one_cell(3.0, 2.0)).sum())(np.log(2.0))
    assert float(shrinks) > 0.1
    inside = [float(inside_loss(said(3.0, 0.0, logit), kept).sum()) for logit in (-3.0, 3.0)]
    assert inside == [0.0, 0.0]


def test_the_slope_of_the_distances_is_that_of_their_loss():
    """Finite differences, about borders, beyond the reach on both sides of it, and inside; but where a border is
    learned: there the slopes are of two parts, each by itself."""
    rng = np.random.default_rng(3)
    signed = jnp.asarray(np.r_[rng.uniform(-12, 38, 20), [REACH_PX] * 12, [-REACH_PX] * 8]).reshape(1, 5, 8, 1)
    kept = jnp.asarray(rng.random(signed.shape) < 0.4, signed.dtype)
    batch = Batch(jnp.zeros((1, 2, 2, 3)), signed, jnp.full_like(signed, 0.3), jnp.ones((1, 5, 8)), kept)
    told = signed + jnp.asarray(rng.normal(0.0, 6.0, signed.shape))
    log_sigma = jnp.asarray(rng.uniform(-1.0, 3.0, signed.shape))

    def loss(told, log_sigma):
        return distance_loss(Said(told, log_sigma, jnp.zeros_like(told)), batch).sum()

    by_told, by_sigma = jax.grad(loss, (0, 1))(told, log_sigma)
    step = 1e-5
    is_own = (jnp.abs(signed) < REACH_PX) & (kept == 0.0)
    for _ in range(3):
        any_way = jnp.asarray(rng.normal(size=signed.shape))
        way = jnp.where(is_own, 0.0, any_way)
        for k, slope in enumerate((by_told, by_sigma)):
            ends = [loss(told + (k == 0) * s * way, log_sigma + (k == 1) * s * way) for s in (step, -step)]
            assert float(jnp.sum(slope * way)) == pytest.approx(float(ends[0] - ends[1]) / (2 * step), rel=1e-5)


def test_cells_of_which_nothing_is_known_move_nothing():
    network = DenseNet.create(jax.random.key(0), network_config(1))
    rng = np.random.default_rng(0)
    picture = jnp.asarray(rng.random((1, 32, 32, 3)))
    labels = jnp.asarray(rng.uniform(-9, 9, (1, 16, 16, 1)))
    batch = Batch(picture, labels, jnp.ones_like(labels), jnp.zeros((1, 16, 16)), 0.0 * labels)
    slope = jax.jit(jax.grad(lambda n: eyes_loss(n, batch)))(network)
    assert max(float(jnp.abs(leaf).max()) for leaf in jax.tree.leaves(slope)) == 0.0


def test_crops_keep_their_labels():
    """A bright square and its distance: mirrored or moved, the label is where the square is."""
    picture = np.zeros((96, 128, 3), np.uint8)
    picture[40:60, 50:80] = 255
    v, u = np.mgrid[:48, :64] * 2.0 + 0.5
    signed = np.maximum(np.maximum(49.5 - u, u - 79.5), np.maximum(39.5 - v, v - 59.5)).clip(-REACH_PX, REACH_PX)
    planes = signed[None].astype(np.float16), np.ones((1, 48, 64), np.float16)
    image = LabelledImage(picture, *planes, np.ones((48, 64), bool), np.zeros((1, 48, 64), bool))
    config = CropConfig(size=8, crop_px=(64, 64))
    pool = ImagePool([image])
    batch = draw_batch(pool, config, 32, np.random.default_rng(0))
    assert batch.picture.shape == (8, 64, 64, 3) and batch.signed_px.shape == (8, 32, 32, 1)
    cells = batch.picture.reshape(8, 32, 2, 32, 2, 3).mean((2, 4, 5))
    shown = 0
    for cell, distance, weight in zip(cells, batch.signed_px[..., 0], batch.weight, strict=True):
        inside, outside = (distance < -2.0) & (weight > 0), (distance > 2.0) & (weight > 0)
        if inside.sum() > 10 and outside.sum() > 10:
            shown += 1
            assert cell[inside].mean() > cell[outside].mean() + 0.2
    assert shown >= 4
    again = draw_batch(pool, config, 32, np.random.default_rng(0))
    assert np.array_equal(again.picture, batch.picture)


def test_what_is_rare_is_drawn_more_often():
    """One image in 25 shows the second class: a sixth of the crops about borders are of it, and about its place."""
    far = np.full((2, 64, 64), REACH_PX, np.float16)
    usual, rare = far.copy(), far.copy()
    usual[0, 10], rare[1, 40, 40] = -1.0, -1.0
    rest = np.ones_like(far), np.ones((64, 64), bool), np.zeros(far.shape, bool)
    picture = np.zeros((128, 128, 3), np.uint8)
    pool = ImagePool([LabelledImage(picture, plane, *rest) for plane in (*[usual] * 25, rare)])
    rng = np.random.default_rng(0)
    drawn = [pool.drawn(1.0, rng) for _ in range(600)]
    places = np.array([place for image, *place in drawn if image is pool.images[25]])
    assert len(places) / 600 == pytest.approx(1.0 / 6.0, abs=0.05)
    assert np.abs(places - 40).max() <= 40


def score(accepted, false, along):
    return Round(None, RoundScore(20, 20, accepted, false, (0.02, along, 0.1), (0.1, 0.3, 0.3), (0.7, 0.9, 1.0)), 0, 0)


@pytest.mark.parametrize(
    ("rounds", "kept"),
    [
        ([(10, 0, 0.2), (12, 0, 0.1), (14, 0, 0.05)], 2),
        ([(10, 0, 0.2), (14, 1, 0.05)], 0),  # a false pose
        ([(10, 0, 0.2), (9, 0, 0.05)], 0),  # fewer accepted
        ([(10, 0, 0.2), (12, 0, 0.1), (12, 0, 0.15), (12, 0, 0.08)], 3),
    ],
)
def test_the_last_round_that_was_better_in_recall_and_median_is_kept(rounds, kept):
    assert best_round([score(*one) for one in rounds]) == kept
