"""Parameters that foretell the true poses of some drives best (room: learning; host).

In: TrainingFrames. Out: Fit.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from semloc_jax.errors import SemlocError
from semloc_jax.learning.adam import AdamState, adam_step, falling_rate
from semloc_jax.learning.config import LearningConfig
from semloc_jax.learning.loss import FrameScore, frame_loss
from semloc_jax.learning.parameters import Parameters
from semloc_jax.learning.scenes import TrainingFrame


@dataclass(frozen=True)
class Fit:
    """What was learned.

    Attributes:
        parameters: The best.
        history: Mean loss of the frames for validation each time they were asked, that of the defaults first.
        num_used: Frames that were learned from.
        num_frames: Frames that were given.
    """

    parameters: Parameters
    history: tuple[float, ...]
    num_used: int
    num_frames: int


@eqx.filter_jit
def loss_and_gradient(
    parameters: Parameters, frame: TrainingFrame, config: LearningConfig
) -> tuple[tuple[jax.Array, FrameScore], Parameters]:
    """Loss and score of one frame, and the derivative of the loss through the solve."""
    return jax.value_and_grad(lambda p: frame_loss(p, frame, config), has_aux=True)(parameters)


def fit(
    frames: Sequence[TrainingFrame],
    num_channels: int,
    config: LearningConfig,
    validation: Sequence[TrainingFrame] = (),
    on_step: Callable[[float], None] | None = None,
) -> Fit:
    """Parameters that make the true poses likely, held by their priors; Adam on batches, stopped by other frames.

    Which frames count is decided once, by what the search found with the defaults.

    Args:
        frames: Of all drives to learn from.
        num_channels: Of their common class table.
        config: Priors, steps.
        validation: Frames that tell which step was the best; none for those that are learned from.
        on_step: Called with the loss of each batch.

    Raises:
        SemlocError: no frame ends near the truth.
    """
    used = [frame for frame in frames if _is_near(frame, config)]
    if not used:
        raise SemlocError(
            f"learning: none of {len(frames)} frames ends within {config.max_error_m} m of the truth; check masks, map "
            "and truth"
        )
    judges = [frame for frame in validation if _is_near(frame, config)] or used
    x, back = ravel_pytree(Parameters.defaults(num_channels))
    dtype, x = x.dtype, np.asarray(x, np.float64)
    num_independent = max(config.independent_share * len(used), 1.0)
    pull = jax.jit(jax.grad(lambda x: 0.5 * jnp.sum(back(x).deviation(config) ** 2) / num_independent))

    def losses(x: np.ndarray, batch: Sequence[TrainingFrame]) -> tuple[float, np.ndarray]:
        return _mean_loss(back(jnp.asarray(x, dtype)), batch, config)

    rng = np.random.default_rng(config.seed)
    history, best = [losses(x, judges)[0]], x
    adam = AdamState.begin(x)
    for step in range(1, config.num_steps + 1):
        drawn = rng.choice(len(used), min(config.batch, len(used)), replace=False)
        value, gradient = losses(x, [used[k] for k in drawn])
        gradient = gradient + np.asarray(pull(jnp.asarray(x, dtype)), np.float64)
        x, adam = adam_step(x, gradient, adam, falling_rate(config.rate, step, config.num_steps))
        if on_step is not None:
            on_step(value)
        if step % config.judge_every == 0 or step == config.num_steps:
            history.append(losses(x, judges)[0])
            best = x if history[-1] == min(history) else best
    return Fit(back(jnp.asarray(best, dtype)), tuple(history), len(used), len(frames))


def _mean_loss(
    parameters: Parameters, frames: Sequence[TrainingFrame], config: LearningConfig
) -> tuple[float, np.ndarray]:
    """Mean loss of the frames, and the mean of their clipped gradients."""
    values, slopes = [], []
    for frame in frames:
        (loss, _), slope = loss_and_gradient(parameters, frame, config)
        slope = np.asarray(ravel_pytree(slope)[0], np.float64)
        size = np.linalg.norm(slope)
        slope = slope * min(1.0, config.max_gradient / max(size, 1e-9)) if np.isfinite(size) else np.zeros_like(slope)
        values.append(float(loss))
        slopes.append(slope)
    return float(np.mean(values)), np.mean(slopes, axis=0)


def _is_near(frame: TrainingFrame, config: LearningConfig) -> bool:
    """Whether the search ended near the truth."""
    off = np.asarray(frame.T_start - frame.T_true)[:2, 3]
    return bool(np.hypot(*off) < config.max_error_m)
