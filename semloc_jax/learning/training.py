"""A network is trained: seeded, in steps that can be gone on with (room: learning; JAX and host).

In: a network, its loss, what gives the batch of a step. Out: the trained network; a checkpoint.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from semloc_jax.errors import SemlocError
from semloc_jax.learning.adam import AdamState, adam_step, falling_rate
from semloc_jax.perception.networks.weights import load_weights, read_card, save_weights

T = TypeVar("T")


@dataclass(frozen=True)
class TrainingConfig:
    """How a network is trained."""

    num_steps: int = 1000
    rate: float = 2e-3
    """Of Adam at its begin; it falls to zero over all steps."""
    level_share: float = 0.0
    """Of the steps, before it begins to fall."""
    mean_share: float = 0.2
    """Of the steps, the last ones: the mean of the weights after each of them is what comes out, as every batch throws
    them about a little. 0: those after the last step."""
    most_gradient: float = 1.0
    """Longest gradient of a batch: one bad label shall not throw the network."""
    seed: int = 0
    """Of the batches: that of step k is drawn by (seed, k) alone, so that a run that goes on draws the same."""
    save_every: int = 100
    """Steps between checkpoints."""

    def __post_init__(self) -> None:
        if min(self.num_steps, self.save_every) < 1 or min(self.rate, self.most_gradient) <= 0.0:
            raise SemlocError(f"training: {self}; expected steps of at least 1, rate and longest gradient above 0")
        if not 0.0 <= self.level_share < 1.0:
            raise SemlocError(f"training: level_share {self.level_share:g}; expected 0 <= level_share < 1")
        if not 0.0 <= self.mean_share <= 1.0:
            raise SemlocError(f"training: mean_share {self.mean_share:g}; expected 0 <= mean_share <= 1")

    @property
    def mean_from(self) -> int:
        """The first step of those whose weights are averaged; the last of all where only that one counts."""
        return min(self.num_steps - round(self.mean_share * self.num_steps) + 1, self.num_steps)


def train(
    network: T,
    loss: Callable[[T, Any], jax.Array],
    batch_of: Callable[[np.random.Generator], Any],
    config: TrainingConfig,
    checkpoint: Path | None = None,
    on_step: Callable[[int, float], None] | None = None,
) -> T:
    """The network after Adam's steps down the loss of batches, a scalar of a network and a batch; see `descend`."""
    slope = eqx.filter_jit(eqx.filter_value_and_grad(loss))
    return descend(network, slope, batch_of, config, checkpoint, on_step)


def descend(
    network: T,
    slope: Callable[[T, Any], tuple[jax.Array, T]],
    batch_of: Callable[[np.random.Generator], Any],
    config: TrainingConfig,
    checkpoint: Path | None = None,
    on_step: Callable[[int, float], None] | None = None,
) -> T:
    """The network after Adam's steps down a loss whose gradient is given: the mean of those of the last steps.

    Args:
        network: To begin with.
        slope: Loss of a network and a batch, and its gradient by the arrays of the network; steps whose gradient is not
            finite are left out.
        batch_of: Draws a batch, always of the same shapes.
        config: Steps, rate, seed.
        checkpoint: File to go on from where it is there, and to write now and then; it is left there at the end.
        on_step: Called with the number of the step and its loss.

    Raises:
        SemlocError: the checkpoint is of another network or of other settings.
    """
    parameters, rest = eqx.partition(network, eqx.is_inexact_array)

    @jax.jit
    def advance(parameters: Any, gradient: Any, adam: AdamState, rate: jax.Array) -> tuple[Any, AdamState]:
        size = jnp.sqrt(sum(jnp.sum(g * g) for g in jax.tree.leaves(gradient)))
        scale = jnp.where(jnp.isfinite(size), jnp.minimum(1.0, config.most_gradient / jnp.maximum(size, 1e-12)), 0.0)
        gradient = jax.tree.map(lambda g: jnp.where(scale > 0, scale * g, 0.0), gradient)
        return adam_step(parameters, gradient, adam, rate)

    @jax.jit
    def averaged(mean: Any, parameters: Any, weight: jax.Array) -> Any:
        return jax.tree.map(lambda m, p: (1.0 - weight) * m + weight * p, mean, parameters)

    run = _Run(0, parameters, AdamState.begin(parameters), parameters)
    done, parameters, adam, mean = _resumed(checkpoint, run, config)
    batch = batch_of(np.random.default_rng((config.seed, done + 1))) if done < config.num_steps else None
    for step in range(done + 1, config.num_steps + 1):
        adam = adam._replace(step=jnp.asarray(step - 1, jnp.float32))
        now = falling_rate(config.rate, step, config.num_steps, config.level_share)
        rate = jnp.asarray(now, jnp.float32)
        value, gradient = slope(eqx.combine(parameters, rest), batch)
        parameters, adam = advance(parameters, gradient, adam, rate)
        # Until the last steps begin, the mean is that of one.
        weight = jnp.asarray(1.0 / max(step - config.mean_from + 1, 1), jnp.float32)
        mean = averaged(mean, parameters, weight)
        if step < config.num_steps:  # drawn while JAX still computes
            batch = batch_of(np.random.default_rng((config.seed, step + 1)))
        if on_step is not None:
            on_step(step, float(value))
        if checkpoint is not None and (step % config.save_every == 0 or step == config.num_steps):
            run = _Run(step, parameters, adam, mean)
            save_weights(checkpoint, run.arrays, _settings(config) | {"step": step})
    return eqx.combine(mean, rest)


class _Run(NamedTuple):
    """Where a run is."""

    step: int
    parameters: Any
    adam: AdamState
    mean: Any

    @property
    def arrays(self) -> tuple:
        """What a checkpoint holds."""
        return self.parameters, self.adam.first, self.adam.second, self.mean


def _settings(config: TrainingConfig) -> dict[str, int | float]:
    """What must be the same for a run to go on."""
    level = {"level_share": config.level_share} if config.level_share else {}
    stated = {"num_steps": config.num_steps, "rate": config.rate, "seed": config.seed}
    return stated | {"mean_share": config.mean_share} | level


def _resumed(checkpoint: Path | None, run: _Run, config: TrainingConfig) -> _Run:
    """Where a run stopped: that of the checkpoint, else the begin that is given."""
    if checkpoint is None or not checkpoint.is_file():
        return run
    card = read_card(checkpoint)
    if {key: card.get(key) for key in _settings(config)} != _settings(config):
        raise SemlocError(f"checkpoint {checkpoint}: made with other settings than {_settings(config)}; delete it")
    parameters, first, second, mean = load_weights(checkpoint, run.arrays)
    return _Run(int(card["step"]), parameters, run.adam._replace(first=first, second=second), mean)
