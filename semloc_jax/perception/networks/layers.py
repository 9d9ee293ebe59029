"""Layers with their parameters (room: perception; pure JAX).

In: features [h w c], the operations to use. Out: features. No layer normalises: statistics of a crop are not those of
the picture that it was cut from; residual blocks that begin as the identity train without.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from semloc_jax.perception.networks.operations import JAX, Features, Operations


class Convolution(eqx.Module):
    """Convolution over all channels; of size 1 it mixes the channels of each cell."""

    kernel: Float[Array, "k k c d"]
    bias: Float[Array, " d"]

    @classmethod
    def create(cls, key: PRNGKeyArray, size: int, num_in: int, num_out: int, gain: float = 2.0) -> "Convolution":
        """Normal weights of variance gain / inputs (He 2015: 2 before a ReLU)."""
        scale = (gain / (size * size * num_in)) ** 0.5
        return cls(scale * jax.random.normal(key, (size, size, num_in, num_out)), jnp.zeros(num_out))

    def __call__(self, x: Features, ops: Operations = JAX) -> Features:
        return ops.dense(x, self.kernel, self.bias)


class Separable(eqx.Module):
    """3x3 of each channel by itself, then a mix of the channels of each cell."""

    around: Float[Array, "3 3 c"]
    around_bias: Float[Array, " c"]
    mix: Convolution

    @classmethod
    def create(cls, key: PRNGKeyArray, num: int, gain: float = 2.0) -> "Separable":
        """As many channels come out as go in."""
        one, two = jax.random.split(key)
        around = (1.0 / 9.0) ** 0.5 * jax.random.normal(one, (3, 3, num))
        return cls(around, jnp.zeros(num), Convolution.create(two, 1, num, num, gain))

    def __call__(self, x: Features, ops: Operations = JAX) -> Features:
        return self.mix(ops.depthwise(x, self.around, self.around_bias), ops)


class Residual(eqx.Module):
    """x + second(relu(first(x))), and a ReLU; it begins as the identity."""

    first: Convolution | Separable
    second: Convolution | Separable

    @classmethod
    def create(cls, key: PRNGKeyArray, num: int, is_dense: bool) -> "Residual":
        """Dense layers see more and cost more: for few channels."""
        one, two = jax.random.split(key)
        if is_dense:
            return cls(Convolution.create(one, 3, num, num), Convolution.create(two, 3, num, num, gain=0.0))
        return cls(Separable.create(one, num), Separable.create(two, num, gain=0.0))

    def __call__(self, x: Features, ops: Operations = JAX) -> Features:
        return ops.relu(ops.add(x, self.second(ops.relu(self.first(x, ops)), ops)))
