"""Eyes that are taught through the solver: they tell what the localizer solves, derivatives are those of solving again,
a border that is told aside comes back, one frame that is lost does not outweigh others."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

from semloc_jax.learning import Parameters
from semloc_jax.learning.eyes.loss import Batch
from semloc_jax.learning.eyes.through import (
    PoseSight,
    ThroughBatch,
    ThroughConfig,
    bounded,
    counted_px,
    planes_score,
    planes_told,
    through_slope,
)
from semloc_jax.learning.fit import loss_and_gradient
from semloc_jax.learning.scenes import TrainingFrame
from semloc_jax.learning.training import TrainingConfig, descend
from semloc_jax.perception.border_mask import SeenBorders
from semloc_jax.perception.networks.eyes import CELL_PX, REACH_PX, Said
from tests.alignment.random_scenes import random_trial
from tests.learning.test_learning import CONFIG

UNIT_PX = 8.0
FREE = 1e9
DOF = 4.0


class Drawn(eqx.Module):
    """Eyes that tell the distances of one scene, each class shifted, with one sigma."""

    planes: Callable[[], np.ndarray] = eqx.field(static=True)
    """Signed distances [h w k]; they are not learned."""
    shift_px: Array
    log_sigma: Array

    def __call__(self, picture):
        told = (jnp.asarray(self.planes()) + self.shift_px - 0.5 * REACH_PX) / UNIT_PX
        sigma = jnp.broadcast_to(self.log_sigma - np.log(UNIT_PX), told.shape)
        return jnp.concatenate([told, sigma, jnp.zeros_like(told)], axis=-1)


def scene_of(seed):
    """A random scene as a sight, and eyes that tell it exactly."""
    trial = random_trial(seed)
    place = jnp.arange(2, dtype=jnp.int32)
    frame = TrainingFrame(trial.scene, place, trial.prior, trial.T_true, trial.T_true)
    planes = np.moveaxis(np.asarray(trial.scene.maps.distance_px)[0], 0, -1)
    picture = jnp.zeros((1, 4, 4, 3))
    sight = PoseSight(picture, frame, jnp.zeros((3, 3)), CELL_PX, planes.shape[:2])
    assert trial.scene.maps.stride == CELL_PX  # the network's image is the image
    return sight, Drawn(lambda: planes, jnp.zeros(2), jnp.log(0.5))


@pytest.fixture(scope="module")
def known():
    return scene_of(3)


def test_distances_count_as_they_do_in_the_localizer():
    """The share by sigma, distances beyond reach, and the scale of the network's image."""
    rng = np.random.default_rng(0)
    said = Said(*(rng.uniform(low, high, (5, 6, 2)) for low, high in ((-50.0, 50.0), (-2.0, 3.5), (-1.0, 1.0))))
    scale = 2.0
    signed = np.clip(np.moveaxis(said.signed_px, -1, 0), -REACH_PX, REACH_PX) / scale
    sigma = np.exp(np.moveaxis(said.log_sigma, -1, 0)) / scale
    seen = SeenBorders(signed, sigma, 1.0, ("a", "b"), REACH_PX / scale)
    found = np.asarray(counted_px(said, scale))
    for k, name in enumerate(seen.names):
        np.testing.assert_allclose(found[..., k], seen.counted_px(name), rtol=1e-6)


@eqx.filter_jit
def solved(eyes, sight):
    return planes_score(planes_told(eyes, sight), sight)


def slope_of(eyes, sight):
    """Loss of a sight and its derivative by the eyes, no labels beside it."""
    planes = jnp.zeros((1, *eyes.planes().shape))
    nothing = Batch(jnp.zeros((1, 4, 4, 3)), planes, planes + 1.0, planes[..., 0], planes)
    return through_slope(eyes, ThroughBatch((sight,), nothing), ThroughConfig(labels_share=0.0, most_pull=FREE), DOF)


def shifted(eyes, *shift_px):
    return eqx.tree_at(lambda e: e.shift_px, eyes, jnp.array(shift_px))


@pytest.mark.slow
def test_what_is_solved_is_the_scene_that_is_told(known):
    sight, eyes = known
    zero = Parameters.defaults(2)
    expected = loss_and_gradient(zero, sight.frame, CONFIG)[0][1]
    model = zero.model(sight.frame.place, CONFIG)
    told = eqx.tree_at(lambda s: (s.frame.scene.model, s.frame.scene.nats_per_px), sight, model)
    found = solved(eyes, told)
    assert bool(found.used)
    np.testing.assert_allclose(found.error, expected.error, atol=1e-7)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-5)


@pytest.mark.slow
def test_derivatives_by_the_eyes_are_those_of_solving_again(known):
    sight, eyes = known
    at, step = np.array([0.4, -0.3]), 1e-3
    slope = slope_of(shifted(eyes, *at), sight)[1].shift_px
    sides = [[slope_of(shifted(eyes, *(at + d * e)), sight)[0] for d in (step, -step)] for e in np.eye(2)]
    again = [float(high - low) / (2 * step) for high, low in sides]
    np.testing.assert_allclose(slope, again, rtol=2e-3, atol=1e-4)


@pytest.mark.slow
def test_a_doubtful_pose_pulls_less(known):
    """A pose that is known to ten metres says nothing of a pixel."""
    sight, eyes = known
    doubtful = eqx.tree_at(lambda s: s.doubt, sight, 100.0 * jnp.eye(3))
    slopes = (slope_of(shifted(eyes, 1.0, 1.0), s)[1].shift_px for s in (sight, doubtful))
    sure, unsure = (float(jnp.linalg.norm(slope)) for slope in slopes)
    assert unsure < 0.01 * sure


def test_no_frame_pulls_with_more_than_its_share():
    slope = jnp.array([6.0, 8.0, 0.0])
    np.testing.assert_allclose(bounded(slope, 1.0), [0.6, 0.8, 0.0], rtol=1e-12)
    np.testing.assert_array_equal(bounded(slope, 100.0), slope)
    np.testing.assert_array_equal(bounded(slope.at[1].set(jnp.nan), 1.0), 0.0)


@pytest.mark.slow
def test_a_border_that_is_told_aside_comes_back(known):
    """Poses alone, no labels: classes told 1.5 px too far in opposite directions."""
    sight, eyes = known
    off = shifted(eyes, 1.5, -1.5)
    taught = descend(off, slope_of, lambda rng: sight, TrainingConfig(num_steps=60, rate=0.1))
    before, after = solved(off, sight), solved(taught, sight)
    assert float(after.nll) < float(before.nll) - 0.5
    assert float(jnp.hypot(*after.error[:2])) < 0.5 * float(jnp.hypot(*before.error[:2]))
