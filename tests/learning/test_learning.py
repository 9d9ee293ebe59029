"""Learning through the solve: the loss, its gradient, and weights that come back from drives with a known fault."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from scipy.stats import multivariate_normal, multivariate_t

from semloc_jax.alignment.frame_localizer import LocalizeConfig
from semloc_jax.datasets import open_drive
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.learning import (
    LearningConfig,
    Parameters,
    TrainingFrame,
    accuracy,
    calibrate,
    fit,
    learned_config,
    learned_values,
    pose_nll,
)
from semloc_jax.learning.accuracy import Accuracy, localizer_accuracy
from semloc_jax.learning.calibrate import _where_zero
from semloc_jax.learning.fit import loss_and_gradient
from semloc_jax.learning.loss import FrameScore, heavy_tailed_nll
from semloc_jax.learning.parameters import Learned
from semloc_jax.maps import read_map
from semloc_jax.perception import CostMapConfig, load_class_table
from semloc_jax.structs import ElementClass
from tests.alignment.random_scenes import RAMP_PX, random_trial

CONFIG = LearningConfig(
    stored_ramp_px=RAMP_PX, scene=LocalizeConfig(cost_maps=CostMapConfig(ramp_px=(7.0,), stride=(2,)))
)


def frames(seeds, spoiled_px=0.0):
    """Random scenes of two channels; the second one sits beside its place, elsewhere in each of them."""
    found = []
    for seed in seeds:
        trial = random_trial(seed)
        off = spoiled_px * np.random.default_rng([seed, 7]).normal()
        moved = jnp.clip(trial.scene.maps.distance_px.at[:, 1].add(off), -RAMP_PX, RAMP_PX)
        scene = eqx.tree_at(lambda s: s.maps.distance_px, trial.scene, moved)
        found.append(TrainingFrame(scene, jnp.arange(2, dtype=jnp.int32), trial.prior, trial.T_true, trial.T_true))
    return found


def judged(parameters, given):
    """Mean distance to the truth [m], NEES and negative log-likelihood of the frames."""
    scores = [loss_and_gradient(parameters, frame, CONFIG)[0][1] for frame in given]
    distance = [float(jnp.hypot(*score.error[:2])) for score in scores]
    return np.mean(distance), np.mean([float(s.nees) for s in scores]), np.mean([float(s.nll) for s in scores])


def test_the_likelihood_is_that_of_a_normal_distribution():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(4, 3, 3))
    S, e = A @ A.transpose(0, 2, 1) + 0.1 * np.eye(3), rng.normal(size=(4, 3))
    nll, nees = pose_nll(jnp.asarray(e), jnp.asarray(S))
    expected = [
        -multivariate_normal(np.zeros(3), cov).logpdf(x) - 1.5 * np.log(2 * np.pi) for x, cov in zip(e, S, strict=True)
    ]
    np.testing.assert_allclose(nll, expected, rtol=1e-10)
    np.testing.assert_allclose(nees, [x @ np.linalg.inv(cov) @ x / 3 for x, cov in zip(e, S, strict=True)], rtol=1e-10)


def test_the_heavy_tailed_likelihood_is_that_of_students_distribution():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(3, 3))
    S, e = A @ A.T + 0.1 * np.eye(3), rng.normal(size=(2, 3))
    pairs = [(e[0], S), (e[1], S), (e[0], 9 * S)]
    found = []
    for x, cov in pairs:
        error, covariance = jnp.asarray(x), jnp.asarray(cov)
        score = FrameScore(error, covariance, *pose_nll(error, covariance), jnp.asarray(True))
        found.append(float(heavy_tailed_nll(score, 4.0)))
    expected = [-multivariate_t(np.zeros(3), cov, df=4.0).logpdf(x) for x, cov in pairs]
    np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=1e-10)


def test_what_is_learned_becomes_a_configuration():
    table = load_class_table("drive")
    pole = table.channel_of(ElementClass.POLE)
    zero, config = Parameters.defaults(len(table.channels)), LearningConfig()
    nothing = learned_values(zero, table, config)
    assert nothing == ((1.0,) * len(ElementClass), 3.0, 0.5, 60.0)
    changed = Parameters(zero.weight.at[pole].set(np.log(2.0)), jnp.log(1.5), jnp.log(0.4), jnp.log(0.5))
    learned = learned_values(changed, table, config)
    weights = np.ones(len(ElementClass))
    weights[ElementClass.POLE] = 2.0
    assert learned == (tuple(weights), 4.5, 0.2, 30.0)
    found = learned_config(learned, LocalizeConfig())
    assert found.cost_maps.ramp_px == (40.0, 14.0, 8.0, 4.5)
    assert found.road.roll_pitch_deg == 0.2
    assert found.frame.search_align.noise.correlation_px == found.frame.polish_align.noise.correlation_px == 30.0
    assert found.frame.search_view.class_weight == found.frame.polish_view.class_weight == tuple(weights)


def test_the_width_of_the_covariance_is_found_by_secants():
    """NEES that goes with the length to the power -1.3: right after the second trial, near it after the first."""
    x = np.log(60.0)
    tried = [(x, np.log(0.4))]
    near = _where_zero(tried)
    exact = x + np.log(0.4) / 1.3
    assert abs(near - exact) < 0.15
    tried.append((near, -1.3 * (near - exact)))
    assert abs(_where_zero(tried) - exact) < 1e-9


@pytest.mark.slow
def test_the_gradient_through_the_solve_is_that_of_finite_differences():
    """Of the loss by both weights, ramp, tilt and correlation length, within 0.1 % in three scenes."""
    flat, back = ravel_pytree(Parameters(jnp.asarray([0.2, -0.3]), *map(jnp.asarray, (0.1, -0.4, -0.2))))
    for frame in frames(range(3), 0.5):

        def loss(x, frame=frame):
            return float(loss_and_gradient(back(x), frame, CONFIG)[0][0])

        (_, score), gradient = loss_and_gradient(back(flat), frame, CONFIG)
        assert bool(score.used)
        numeric = [(loss(flat + step) - loss(flat - step)) / 2e-5 for step in 1e-5 * np.eye(len(flat))]
        np.testing.assert_allclose(ravel_pytree(gradient)[0], numeric, atol=1e-3 * np.abs(numeric).max())


@pytest.mark.slow
def test_a_class_that_lies_is_found_and_unseen_scenes_get_better():
    """Masks of one class lie 3 px off, elsewhere in each scene: its weight falls, and with it error and NEES."""
    # Every scene is another place with another fault: each of them counts in full against the priors.
    found = fit(frames(range(24), 3.0), 2, replace(CONFIG, independent_share=1.0))
    assert found.num_used > 18
    assert found.history[-1] < found.history[0] - 0.5
    honest, lying = np.exp(np.asarray(found.parameters.weight))
    assert lying < 0.6 * honest
    unseen = frames(range(100, 124), 3.0)
    before, after = judged(Parameters.defaults(2), unseen), judged(found.parameters, unseen)
    assert after[0] < 0.95 * before[0]
    assert abs(np.log(after[1])) < abs(np.log(before[1]))
    assert after[2] < before[2] - 0.3


@pytest.fixture
def opened(simulated_road):
    """A drive with its map and masks."""
    drive = open_drive(simulated_road)
    return drive, read_map(drive.map_path), mask_source("sem", drive)


def test_frames_that_are_all_better_than_stated_do_not_ask_for_ever_shorter_borders(monkeypatch, opened):
    """Three frames of exact masks: their NEES is nothing at any length, and a search with 0.1 px finds no pose."""
    near = Accuracy(np.full((3, 3), 1e-6), np.tile(np.eye(3), (3, 1, 1)), 0.3)
    monkeypatch.setattr(calibrate, "localizer_accuracy", lambda *_: near)
    learned = Learned((1.0,) * len(ElementClass), 3.0, 0.5, 60.0)
    assert calibrate.calibrated(learned, [opened], LearningConfig()).correlation_px >= 10.0


def test_a_drive_in_which_no_frame_is_near_the_truth_is_one_clear_error(monkeypatch, opened):
    monkeypatch.setattr(accuracy, "localized_frames", lambda *_: iter(()))
    with pytest.raises(SemlocError, match=r"0 were localized and none within 0.3 m of the truth.*--num-frames"):
        localizer_accuracy(*opened, LocalizeConfig(), LearningConfig())
