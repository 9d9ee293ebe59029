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
from semloc_jax.learning.config import LearningConfig
from semloc_jax.learning.loss import FrameScore, frame_loss
from semloc_jax.learning.parameters import Parameters
from semloc_jax.learning.scenes import TrainingFrame


@dataclass(frozen=True)
class Fit:
    """What was learned.

    Attributes:
        parameters: The best.
        history: Mean negative log-likelihood after each iteration, that of the defaults first.
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
    on_step: Callable[[float], None] | None = None,
) -> Fit:
    """Parameters that minimise the mean negative log-likelihood of the true poses, held by their priors.

    Which frames count is decided once, by the defaults.

    Args:
        frames: Of all drives.
        num_channels: Of their common class table.
        config: Priors, iterations.
        on_step: Called with the loss of each evaluation.

    Raises:
        SemlocError: no frame ends near the truth.
    """
    from scipy.optimize import minimize

    first, back = ravel_pytree(Parameters.defaults(num_channels))
    scores = [loss_and_gradient(back(first), frame, config)[0][1] for frame in frames]
    is_used = [_is_near(frame, config) and bool(score.used) for frame, score in zip(frames, scores, strict=True)]
    used = [frame for frame, is_kept in zip(frames, is_used, strict=True) if is_kept]
    if not used:
        raise SemlocError(
            f"learning: none of {len(frames)} frames ends within {config.max_error_m} m of the truth; check masks, map "
            "and truth"
        )
    start = float(np.mean([float(score.nll) for score, is_kept in zip(scores, is_used, strict=True) if is_kept]))
    penalty = jax.jit(jax.value_and_grad(lambda x: 0.5 * jnp.sum(back(x).deviation(config) ** 2)))

    def objective(x: np.ndarray) -> tuple[float, np.ndarray]:
        parameters = back(jnp.asarray(x, first.dtype))
        value, gradient = (np.asarray(part, np.float64) for part in penalty(jnp.asarray(x, first.dtype)))
        for frame in used:
            (loss, _), slope = loss_and_gradient(parameters, frame, config)
            value, gradient = value + float(loss), gradient + np.asarray(ravel_pytree(slope)[0], np.float64)
        value, gradient = value / len(used), gradient / len(used)
        if on_step is not None:
            on_step(float(value))
        return float(value), gradient

    history = [start]
    found = minimize(
        objective,
        np.asarray(first, np.float64),
        jac=True,
        method="L-BFGS-B",
        callback=lambda intermediate_result: history.append(float(intermediate_result.fun)),
        options={"maxiter": config.max_iterations, "ftol": 1e-5},  # float32 tells no finer
    )
    return Fit(back(jnp.asarray(found.x, first.dtype)), tuple(history), len(used), len(frames))


def _is_near(frame: TrainingFrame, config: LearningConfig) -> bool:
    """Whether the fast solve ended near the truth."""
    off = np.asarray(frame.T_start - frame.T_true)[:2, 3]
    return bool(np.hypot(*off) < config.max_error_m)
