"""Training: Adam's own formula, a line that is learned, a run that goes on as if it had not stopped."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.learning.adam import AdamState, adam_step, falling_rate
from semloc_jax.learning.training import TrainingConfig, train

pytestmark = pytest.mark.usefixtures("single_precision")


class Line(eqx.Module):
    slope: jnp.ndarray
    offset: jnp.ndarray


def loss(line, batch):
    x, y = batch
    return jnp.mean((line.slope * x + line.offset - y) ** 2)


def batch_of(rng):
    x = rng.standard_normal(8).astype(np.float32)
    return x, 3.0 * x - 1.0


def begin():
    return Line(jnp.zeros(()), jnp.zeros(()))


def test_the_first_step_of_adam_is_the_rate_against_the_sign():
    x, state = adam_step(np.array([1.0, 2.0]), np.array([5.0, -0.01]), AdamState.begin(np.zeros(2)), 0.1)
    np.testing.assert_allclose(x, [0.9, 2.1], atol=1e-6)
    assert state.step == 1
    assert falling_rate(0.1, 1, 10) == pytest.approx(0.1) and falling_rate(0.1, 6, 10) == pytest.approx(0.05)


def test_a_rate_that_is_level_at_first_tells_nothing_of_the_end():
    """So that a lesson may be made longer as long as its rate has not begun to fall."""
    assert [falling_rate(0.1, step, 20, 0.5) for step in (1, 5, 11)] == [0.1] * 3
    assert falling_rate(0.1, 16, 20, 0.5) == pytest.approx(0.05)
    with pytest.raises(SemlocError, match="level_share"):
        TrainingConfig(level_share=1.0)


def test_a_line_is_learned():
    line = train(begin(), loss, batch_of, TrainingConfig(num_steps=300, rate=0.1))
    assert (float(line.slope), float(line.offset)) == pytest.approx((3.0, -1.0), abs=0.02)


def test_what_comes_out_is_the_mean_of_the_last_steps():
    """Of 10 steps with a share of 0.3 those after 8, 9 and 10; a share of 0 gives the last. Weights of each step are
    those of a run of ours with Adam's formula and the falling rate."""
    after, (x, adam) = [], (np.zeros(2, np.float32), AdamState.begin(np.zeros(2, np.float32)))
    for step in range(1, 11):
        a, y = batch_of(np.random.default_rng((0, step)))
        off = x[0] * a + x[1] - y
        slope = 2.0 * np.array([np.mean(off * a), np.mean(off)])
        slope *= min(1.0, 1.0 / np.linalg.norm(slope))
        x, adam = adam_step(x, slope, adam, falling_rate(0.1, step, 10))
        after.append(x)
    for share, expected in ((0.3, np.mean(after[7:], axis=0)), (0.0, after[9]), (1.0, np.mean(after, axis=0))):
        line = train(begin(), loss, batch_of, TrainingConfig(num_steps=10, rate=0.1, mean_share=share))
        np.testing.assert_allclose((line.slope, line.offset), expected, atol=2e-6)
    with pytest.raises(SemlocError, match="mean_share"):
        TrainingConfig(mean_share=1.1)


def test_a_run_that_stopped_goes_on_to_the_same_bits(tmp_path):
    config = TrainingConfig(num_steps=30, rate=0.1, save_every=10, mean_share=0.5)  # the mean has begun
    whole = train(begin(), loss, batch_of, config)

    def stop(step, value):
        if step == 25:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(begin(), loss, batch_of, config, tmp_path / "c", stop)
    steps = []
    again = train(begin(), loss, batch_of, config, tmp_path / "c", lambda step, value: steps.append(step))
    assert steps == list(range(21, 31))
    assert float(again.slope) == float(whole.slope) and float(again.offset) == float(whole.offset)
    with pytest.raises(SemlocError, match="made with other settings"):
        train(begin(), loss, batch_of, TrainingConfig(num_steps=31), tmp_path / "c")


def test_a_batch_without_a_finite_gradient_moves_nothing():
    def broken(line, batch):
        return line.slope * jnp.nan

    line = train(begin(), broken, batch_of, TrainingConfig(num_steps=3))
    assert float(line.slope) == 0.0
