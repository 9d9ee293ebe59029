"""What is learned, as unconstrained numbers, and as a configuration (room: learning; JAX and host).

In: class weights, ramp, tilt and correlation length. Out: the model of the smooth cost; configurations.
"""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from semloc_jax.alignment.frame_localizer import LocalizeConfig
from semloc_jax.alignment.pose import Prior
from semloc_jax.learning.config import LearningConfig
from semloc_jax.perception import ClassTable
from semloc_jax.residuals.smooth import ChannelModel
from semloc_jax.structs import ElementClass


class Parameters(eqx.Module):
    """Logarithms of ratios to the defaults: zero is the default."""

    weight: Float[Array, " channel"]
    """Of each channel of the class table."""
    ramp: Float[Array, ""]
    """Of the finest ramp, where the robust loss saturates."""
    tilt: Float[Array, ""]
    """Of the standard deviation of roll and pitch against the road: a tilt that the solver makes up moves the place
    along the road."""
    correlation: Float[Array, ""]
    """Of the length of contour that is one independent observation."""

    @classmethod
    def defaults(cls, num_channels: int) -> "Parameters":
        """Nothing learned yet."""
        return cls(jnp.zeros(num_channels), jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))

    def deviation(self, config: LearningConfig) -> Float[Array, " n"]:
        """Deviations from the defaults in units of their standard deviations."""
        rest = [
            self.ramp / config.ramp_sigma,
            self.tilt / config.tilt_sigma,
            self.correlation / config.correlation_sigma,
        ]
        return jnp.concatenate([self.weight / config.weight_sigma, jnp.stack(rest)])

    def model(self, place: Int[Array, " channel"], config: LearningConfig) -> tuple[ChannelModel, Float[Array, ""]]:
        """Model of the channels of a scene, and nats for each pixel of contour.

        Args:
            place: Place of each of its channels in the class table.
            config: Defaults.
        """
        align, maps = config.scene.frame.polish_align, config.scene.cost_maps
        weight = jnp.exp(self.weight[place])
        ones = jnp.ones_like(weight)
        ramp_px = jnp.minimum(maps.ramp_px[-1] * jnp.exp(self.ramp), 0.95 * config.stored_ramp_px)
        model = ChannelModel(weight, ramp_px * ones, ones, align.noise.noise_px * ones)
        return model, jnp.exp(-self.correlation) * align.noise.observations_per_px

    def road(self, prior: Prior) -> Prior:
        """The prior of a frame with what was learned of roll and pitch."""
        return eqx.tree_at(lambda p: p.sigma, prior, prior.sigma.at[3:5].multiply(jnp.exp(self.tilt)))


class Learned(NamedTuple):
    """What was learned, as a configuration holds it."""

    class_weight: tuple[float, ...]
    ramp_px: float
    roll_pitch_deg: float
    correlation_px: float


def learned_values(parameters: Parameters, table: ClassTable, config: LearningConfig) -> Learned:
    """The learned values; a class that the masks do not show has weight 1."""
    factor = np.ones(len(ElementClass))
    for label in ElementClass:
        channel = table.channel_of(label)
        if channel >= 0:
            factor[label] = np.exp(float(parameters.weight[channel]))
    ramp_px = config.scene.cost_maps.ramp_px[-1] * float(np.exp(parameters.ramp))
    correlation_px = config.scene.noise.correlation_px * float(np.exp(parameters.correlation))
    weights = tuple(round(float(value), 3) for value in factor)
    ramp_px = round(min(ramp_px, 0.95 * config.stored_ramp_px), 3)
    roll_pitch_deg = config.scene.road.roll_pitch_deg * float(np.exp(parameters.tilt))
    return Learned(weights, ramp_px, round(roll_pitch_deg, 3), round(correlation_px, 2))


def learned_config(learned: Learned, old: LocalizeConfig) -> LocalizeConfig:
    """The configuration with what was learned; its scene serves every verb."""
    return replace(
        old,
        road=replace(old.road, roll_pitch_deg=learned.roll_pitch_deg),
        cost_maps=replace(old.cost_maps, ramp_px=(*old.cost_maps.ramp_px[:-1], learned.ramp_px)),
        view=replace(old.view, class_weight=learned.class_weight),
        noise=replace(old.noise, correlation_px=learned.correlation_px),
    )
